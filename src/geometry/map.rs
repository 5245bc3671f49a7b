//! Where output pixels come from: the one thing that every shutter model gives to the warp.

use super::{Homography, Zoom};

/// Motion of a frame's rows against the frame's reference time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RowMotion {
    /// The paper's: one zoom and translation for the whole frame interval, at constant speed.
    Uniform {
        /// Motion in one frame interval.
        motion: Zoom,
        /// Rows that are read in one frame interval: the picture's rows / the part of the interval that the readout takes;
        /// negative where the sensor reads from bottom to top.
        rows: f64,
    },
}

impl Default for RowMotion {
    fn default() -> Self {
        Self::Uniform { motion: Zoom::IDENTITY, rows: 1e9 }
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
