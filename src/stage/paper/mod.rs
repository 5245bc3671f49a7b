//! The paper's model, in a room of its own: W. Cho, D. Kim, K. Hong, "CMOS Digital Image Stabilization", IEEE Trans. Consumer Electronics
//! 53 (2007). The equations' numbers are the paper's.
//!
//! | step | place |
//! |---|---|
//! | homography between two frames (eq. 9, 10) | [`homography`] |
//! | its decomposition into a zoom and a shift, the path, the distortion (eq. 2 to 12) | [`Cho2007`], [`Zoom`] |
//! | low-pass filter of the path | [`low_pass`] |
//!
//! Other stages know it by [`super::shutter::Shutter`] and [`super::smooth::Mode::Iir`] alone. The default model uses none of it; it reports
//! the homography that its inliers have.

pub mod homography;
pub(crate) mod low_pass;
mod model;
mod zoom;

pub use model::{Cho2007, compose};
pub(crate) use model::{stabilized_motion, undistortion};
pub use zoom::Zoom;
