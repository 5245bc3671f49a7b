//! Points, matrices and paths as values. Conventions: pixel coordinates as in [`crate::image`]; angles in radians; times in
//! seconds.

mod homography;
mod map;
mod zoom;

pub use homography::Homography;
pub use map::{OutputMap, RowMotion};
pub use zoom::Zoom;
