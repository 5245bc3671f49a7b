//! Points, matrices and paths as values. Conventions: pixel coordinates as in [`crate::image`]; angles in radians; times in
//! seconds.

mod camera;
mod homography;
mod length;
mod map;

pub use camera::{Calibration, Estimate, PITCH, Pinhole, Pose, ROLL, YAW, ZOOM};
pub use homography::Homography;
pub use length::hypot;
pub use map::{OutputMap, RowMotion, RowPoses};
