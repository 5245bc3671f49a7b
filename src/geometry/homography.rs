//! A plane projective transformation.

use nalgebra::Matrix3;

/// A 3x3 matrix that takes homogeneous pixels to homogeneous pixels, `h9` scaled to 1 where it can be. Rows are
/// `h1 h2 h3 / h4 h5 h6 / h7 h8 1`, as in eq. (9) of the paper.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Homography(pub Matrix3<f64>);

impl Default for Homography {
    fn default() -> Self {
        Self::IDENTITY
    }
}

impl Homography {
    /// Leaves every pixel where it is.
    pub const IDENTITY: Self = Self(Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0));

    /// Takes a pixel (x, y) to its image. Not finite where the pixel's image lies at infinity.
    #[inline]
    pub fn apply(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let m = &self.0;
        let w = m[(2, 0)] * x + m[(2, 1)] * y + m[(2, 2)];
        [(m[(0, 0)] * x + m[(0, 1)] * y + m[(0, 2)]) / w, (m[(1, 0)] * x + m[(1, 1)] * y + m[(1, 2)]) / w]
    }

    /// The transformation back; `None` where there is none.
    pub fn inverse(&self) -> Option<Self> {
        self.0.try_inverse().map(Self).map(Self::scaled)
    }

    /// The same transformation with `h9` = 1, where `h9` is not 0.
    pub fn scaled(self) -> Self {
        let scale = self.0[(2, 2)];
        if scale == 0.0 { self } else { Self(self.0 / scale) }
    }

    /// Whether every entry is a finite number.
    pub fn is_finite(&self) -> bool {
        self.0.iter().all(|entry| entry.is_finite())
    }
}
