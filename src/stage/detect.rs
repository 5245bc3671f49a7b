//! Corners, spread over a grid: each cell that lost its points gets new ones.

/// Settings of the detector.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Params {
    /// Points to follow at a time, spread over the picture (count, 50 to 2000).
    pub points: u32,
    /// Least contrast of a corner: smaller eigenvalue of the gradient matrix, as root mean square slope (grey levels a pixel,
    /// 0.5 to 50).
    pub min_contrast: f64,
}

impl Default for Params {
    fn default() -> Self {
        Self { points: 400, min_contrast: 2.0 }
    }
}
