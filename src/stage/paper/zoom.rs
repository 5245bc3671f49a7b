//! Zoom and translation: the paper's motion model.

use nalgebra::Matrix3;

use crate::geometry::Homography;

/// `T = [[a, 0, c], [0, a, d], [0, 0, 1]]` (eq. 2): zoom `a` about the origin (the centre of the top-left pixel), then a
/// translation of (`c`, `d`) pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Zoom {
    /// Magnification.
    pub a: f64,
    /// Translation in x, pixels.
    pub c: f64,
    /// Translation in y, pixels.
    pub d: f64,
}

impl Default for Zoom {
    fn default() -> Self {
        Self::IDENTITY
    }
}

impl Zoom {
    /// Leaves every pixel where it is.
    pub const IDENTITY: Self = Self { a: 1.0, c: 0.0, d: 0.0 };

    /// This motion after `first`: the matrix product `self * first`.
    pub fn after(self, first: Self) -> Self {
        Self { a: self.a * first.a, c: self.a * first.c + self.c, d: self.a * first.d + self.d }
    }

    /// The motion back. `a` must not be 0.
    pub fn inverse(self) -> Self {
        Self { a: 1.0 / self.a, c: -self.c / self.a, d: -self.d / self.a }
    }

    /// The part `share` (0 to 1) of this motion, entry by entry.
    pub fn part(self, share: f64) -> Self {
        Self { a: 1.0 + (self.a - 1.0) * share, c: self.c * share, d: self.d * share }
    }

    /// The same of a homography that is a zoom and a translation.
    pub fn of(homography: &Homography) -> Self {
        let m = &homography.0;
        Self { a: m[(0, 0)], c: m[(0, 2)], d: m[(1, 2)] }
    }

    /// As a homography.
    pub fn homography(self) -> Homography {
        Homography(Matrix3::new(self.a, 0.0, self.c, 0.0, self.a, self.d, 0.0, 0.0, 1.0))
    }

    /// Whether it can be a camera's: finite, and neither mirrored nor zoomed out of all proportion.
    pub fn is_sane(self) -> bool {
        self.a.is_finite() && self.c.is_finite() && self.d.is_finite() && self.a > 0.2 && self.a < 5.0
    }
}
