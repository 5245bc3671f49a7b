//! Pixels in memory: planes, pictures, the names of raw formats, and what samples mean.
//!
//! Coordinates everywhere in gimbald: pixel centres lie at whole numbers, (0, 0) is the centre of the top-left pixel, x goes
//! right, y goes down.

mod colour;
mod format;
mod picture;
mod plane;
mod raw;

pub use colour::{BLACK, Colour, FromRgb, Range, Siting, ToFull, ToLimited, rgb};
pub use format::{MAX_COMPRESSED_PIXELS, PixelFormat};
pub use picture::{Picture, PictureMut, PictureRef, Sampling};
pub use plane::{Plane, PlaneMut, PlaneRef};
pub use raw::RawLayout;

/// Width and height of a picture, at most, wherever it comes from.
pub const MAX_SIDE: u32 = 8192;
