//! The crop window: how much of the picture is given up to hide the border, and keeping every correction inside it.

/// Settings of the crop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Params {
    /// Magnification of the output (ratio, 1 to 2; 1.1 = a tenth larger).
    pub zoom: f64,
}

impl Default for Params {
    fn default() -> Self {
        Self { zoom: 1.1 }
    }
}
