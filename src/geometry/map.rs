//! Where output pixels come from: the one thing that every shutter model gives to the warp.

use super::Homography;

/// Motion of a frame's rows against the frame's reference time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RowMotion {
    /// The paper's: the homography D takes a pixel of the undistorted frame to the captured one (eq. 3).
    Projective(Homography),
}

impl Default for RowMotion {
    fn default() -> Self {
        Self::Projective(Homography::IDENTITY)
    }
}

/// Takes output pixels to input pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum OutputMap {
    /// One homography for the whole frame.
    Projective(Homography),
}

impl Default for OutputMap {
    fn default() -> Self {
        Self::Projective(Homography::IDENTITY)
    }
}

impl OutputMap {
    /// The input pixel (x, y) that the output pixel shows.
    #[inline]
    pub fn apply(&self, pixel: [f64; 2]) -> [f64; 2] {
        match self {
            Self::Projective(h) => h.apply(pixel),
        }
    }
}
