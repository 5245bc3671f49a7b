//! Where a camera that turns and zooms looks, and numbers that belong to its channels.

use std::array::from_fn;
use std::ops::{Add, AddAssign, Index, IndexMut, Mul, Neg, Sub, SubAssign};

/// Index of the yaw in a [`Pose`] and in [`PerChannel`].
pub const YAW: usize = 0;
/// Index of the pitch.
pub const PITCH: usize = 1;
/// Index of the roll.
pub const ROLL: usize = 2;
/// Index of the logarithm of the zoom.
pub const ZOOM: usize = 3;

/// A number for each channel of a pose that is no pose itself: a slope, a limit, a standard deviation, a share.
pub type PerChannel = [f64; 4];

/// A pose: yaw, pitch, roll (radians) and log zoom; or the difference of two poses, which is what a correction is.
///
/// Differences are taken channel by channel, which is exact for the small angles between neighbouring frames and between a camera
/// and its virtual camera. The poses that [`crate::stage::paper`] gives have pixels in place of yaw and pitch.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pose(pub PerChannel);

impl Pose {
    /// The pose whose channels `of` gives.
    #[inline]
    pub fn from_fn(of: impl FnMut(usize) -> f64) -> Self {
        Self(from_fn(of))
    }

    /// The sum over the channels of a slope times the pose: what a small change of the pose changes.
    #[inline]
    pub fn dot(&self, slopes: &PerChannel) -> f64 {
        let [yaw, pitch, roll, zoom] = self.0;
        slopes[YAW] * yaw + slopes[PITCH] * pitch + slopes[ROLL] * roll + slopes[ZOOM] * zoom
    }

    /// Whether no channel is infinite or NaN.
    pub fn is_finite(&self) -> bool {
        self.0.iter().all(|channel| channel.is_finite())
    }
}

impl Add for Pose {
    type Output = Self;

    #[inline]
    fn add(self, other: Self) -> Self {
        Self(from_fn(|c| self.0[c] + other.0[c]))
    }
}

impl Sub for Pose {
    type Output = Self;

    #[inline]
    fn sub(self, other: Self) -> Self {
        Self(from_fn(|c| self.0[c] - other.0[c]))
    }
}

impl Mul<f64> for Pose {
    type Output = Self;

    #[inline]
    fn mul(self, factor: f64) -> Self {
        Self(self.0.map(|channel| channel * factor))
    }
}

impl Neg for Pose {
    type Output = Self;

    #[inline]
    fn neg(self) -> Self {
        Self(self.0.map(|channel| -channel))
    }
}

impl AddAssign for Pose {
    #[inline]
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl SubAssign for Pose {
    #[inline]
    fn sub_assign(&mut self, other: Self) {
        *self = *self - other;
    }
}

impl Index<usize> for Pose {
    type Output = f64;

    #[inline]
    fn index(&self, channel: usize) -> &f64 {
        &self.0[channel]
    }
}

impl IndexMut<usize> for Pose {
    #[inline]
    fn index_mut(&mut self, channel: usize) -> &mut f64 {
        &mut self.0[channel]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn operations_are_channel_by_channel() {
        let (a, b) = (Pose([1.0, 2.0, -3.0, 0.5]), Pose([0.5, -1.0, 1.0, 0.25]));
        assert_eq!(a + b, Pose([1.5, 1.0, -2.0, 0.75]));
        assert_eq!((a - b) + b, a);
        assert_eq!(-a, a * -1.0);
        assert_eq!(a.dot(&[1.0, 10.0, 100.0, 1000.0]), 1.0 + 20.0 - 300.0 + 500.0);
        let mut moved = a;
        moved += b;
        moved -= a;
        assert_eq!(moved, b);
        moved[ROLL] = f64::NAN;
        assert!(b.is_finite() && !moved.is_finite());
    }
}
