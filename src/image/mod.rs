//! Pixels in memory: planes, pictures and the names of raw formats. Where a pixel lies, never what it means.
//!
//! Coordinates everywhere in gimbald: pixel centres lie at whole numbers, (0, 0) is the centre of the top-left pixel, x goes
//! right, y goes down.

mod format;
mod picture;
mod plane;
mod raw;

pub use format::{Colour, MOST_COMPRESSED_PIXELS, PixelFormat, Range, Siting};
pub use picture::{BLACK, Picture, PictureMut, PictureRef, Sampling};
pub use plane::{Plane, PlaneMut, PlaneRef};
pub use raw::RawLayout;
