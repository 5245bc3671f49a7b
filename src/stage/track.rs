//! Pyramidal Lucas-Kanade with a forward-backward check.

/// Settings of the tracker.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Params {
    /// Side of the square window that is compared (pixels, odd, 9 to 31).
    pub window: u32,
    /// Largest distance between a point and where it lands when followed forth and back (pixels, 0.05 to 5).
    pub max_round_trip_px: f64,
}

impl Default for Params {
    fn default() -> Self {
        Self { window: 15, max_round_trip_px: 0.5 }
    }
}
