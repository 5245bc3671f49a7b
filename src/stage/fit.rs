//! The homography between two frames, robustly: seeded MSAC, then refinement on the inliers.

/// Which entries of the homography are free.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Form {
    /// `h4 = h7 = 0`, the form that eq. (10) has: six unknowns.
    #[default]
    Constrained,
    /// All eight.
    General,
}

/// Settings of the fit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Params {
    /// Which entries are free.
    pub form: Form,
    /// Distance at which a track stops being an inlier (pixels, 0.2 to 10).
    pub threshold_px: f64,
    /// Seed of the random choice of hypotheses; the same input gives the same bytes.
    pub seed: u64,
}

impl Default for Params {
    fn default() -> Self {
        Self { form: Form::Constrained, threshold_px: 1.5, seed: 1 }
    }
}
