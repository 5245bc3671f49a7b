//! The virtual camera's path: a causal low-pass of the camera's own.

/// Settings of the path filter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Params {
    /// Motion slower than this is followed, faster is taken out (Hz, 0.05 to 10).
    pub cutoff_hz: f64,
}

impl Default for Params {
    fn default() -> Self {
        Self { cutoff_hz: 0.6 }
    }
}
