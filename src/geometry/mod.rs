//! Points, matrices and paths as values. Conventions: pixel coordinates as in [`crate::image`]; angles in radians; times in
//! seconds.

mod camera;
mod homography;
mod length;
mod map;
mod pose;

pub use camera::{Calibration, Estimate, Pinhole};
pub use homography::Homography;
pub use length::hypot;
pub use map::{OutputMap, ROW_ROUNDS, RowMotion, RowPoses, View};
pub use pose::{PITCH, PerChannel, Pose, ROLL, YAW, ZOOM};
