//! The corrections that the crop margin allows, as half-spaces.
//!
//! A correction is a difference of poses: (yaw, pitch, roll, log zoom), or what the shutter model has in their place. Each point of the
//! output's outline must stay inside of the picture, left, right, above and below; near a correction that is a plane:
//! `normal . correction <= slack`, in pixels.

use crate::geometry::{PITCH, PerChannel, Pose, ROLL, YAW};

/// Half-spaces at most: two ways along each axis for each point of the outline.
pub(super) const MAX_PLANES: usize = 4 * super::PER_SIDE * 4;

/// Half-spaces that [`Bounds::corners`] gives.
pub const CORNERS: usize = 8;
/// Planes that [`Bounds::nearest`] moves a correction to, at most.
const MAX_MOVES: usize = 16;

/// A half-space that binds early, without the rows' motion.
#[derive(Clone, Copy, Debug, Default)]
pub struct Corner {
    /// Pixels to a channel's unit.
    pub normal: PerChannel,
    /// Pixels.
    pub slack: f64,
}

/// The corrections that keep the outline inside.
#[derive(Clone, Copy, Debug)]
pub struct Bounds {
    planes: [HalfSpace; MAX_PLANES],
    count: usize,
    alone: PerChannel,
}

#[derive(Clone, Copy, Debug, Default)]
struct HalfSpace {
    /// Pixels to a channel's unit.
    normal: PerChannel,
    /// Pixels: with the rows' motion as it is, and without.
    slack: [f64; 2],
}

impl HalfSpace {
    /// Pixels that a correction may take, with the rows' motion as it is.
    fn margin(&self) -> f64 {
        self.slack[Rows::Moving as usize].max(1e-9)
    }

    /// The share of them that `correction` takes.
    fn share(&self, correction: &Pose) -> f64 {
        correction.dot(&self.normal) / self.margin()
    }
}

/// Whether the rows' own motion is counted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rows {
    /// As it is.
    Moving,
    /// As if there were none.
    Still,
}

impl Default for Bounds {
    /// Everything is allowed.
    fn default() -> Self {
        Self { planes: [HalfSpace::default(); MAX_PLANES], count: 0, alone: [f64::INFINITY; 4] }
    }
}

impl Bounds {
    /// Adds a half-space. `slack` is with the rows' motion, `slack_still` without.
    pub fn add(&mut self, normal: PerChannel, slack: f64, slack_still: f64) {
        if self.count < MAX_PLANES {
            self.planes[self.count] = HalfSpace { normal, slack: [slack.max(0.0), slack_still.max(0.0)] };
            self.count += 1;
        }
        for (alone, slope) in self.alone.iter_mut().zip(normal) {
            if slope.abs() > 1e-9 {
                *alone = alone.min(slack_still.max(0.0) / slope.abs());
            }
        }
    }

    fn planes(&self) -> &[HalfSpace] {
        &self.planes[..self.count]
    }

    /// Largest correction of each channel while the others are 0 and the rows are still; infinite for a channel that moves nothing.
    pub fn alone(&self) -> PerChannel {
        self.alone
    }

    /// The least and the most that one channel of `correction` may be, the others as they are. Both 0 where they leave nothing.
    ///
    /// Yaw and pitch each have planes of their own; those of the other, which perspective tilts a little, are left out: were that channel
    /// at its bound, the little would be everything. [`Bounds::crop_use`] counts all.
    pub fn interval(&self, channel: usize, correction: &Pose, rows: Rows) -> [f64; 2] {
        let (mut low, mut high) = (f64::NEG_INFINITY, f64::INFINITY);
        for plane in self.planes() {
            if channel < ROLL && self.side_of(plane) != channel {
                continue;
            }
            let slope = plane.normal[channel];
            let left = (plane.slack[rows as usize] - correction.dot(&plane.normal) + slope * correction[channel]).max(0.0);
            if slope > 1e-9 {
                high = high.min(left / slope);
            } else if slope < -1e-9 {
                low = low.max(left / slope);
            }
        }
        [low, high]
    }

    /// Which of yaw and pitch a plane mostly bounds.
    fn side_of(&self, plane: &HalfSpace) -> usize {
        let part = |c: usize| (plane.normal[c] * self.alone[c]).abs();
        if part(PITCH) > part(YAW) { PITCH } else { YAW }
    }

    /// The half-spaces that bind first, without the rows' motion: of those that face the same way in yaw or pitch and in roll, the one
    /// that leaves both least. With roll, that is the outline's corners. The first half bounds yaw, the second pitch; where there is
    /// none, the normal is 0.
    pub fn corners(&self) -> [Corner; CORNERS] {
        let mut corners = [Corner::default(); CORNERS];
        let mut tightest = [0.0; CORNERS];
        for plane in self.planes() {
            let side = self.side_of(plane);
            let (along, roll) = (plane.normal[side], plane.normal[ROLL]);
            let class = CORNERS / 2 * side + 2 * usize::from(along < 0.0) + usize::from(roll < 0.0);
            let tight = (along.abs() + roll.abs()) / plane.slack[Rows::Still as usize].max(1e-9);
            if tight > tightest[class] {
                tightest[class] = tight;
                corners[class] = Corner { normal: plane.normal, slack: plane.slack[Rows::Still as usize] };
            }
        }
        corners
    }

    /// The correction nearest to `correction` that uses at most `part` of the margin, almost: it is moved to the plane that it is farthest
    /// beyond, and so on. Distances are in pixels, `scale` to a channel's unit; infinite for a channel that is not to move.
    pub fn nearest(&self, mut correction: Pose, part: f64, scale: &PerChannel) -> Pose {
        for _ in 0..MAX_MOVES {
            let beyond = |plane: &HalfSpace| correction.dot(&plane.normal) - part * plane.slack[Rows::Moving as usize];
            let farthest = self.planes().iter().map(|plane| (beyond(plane), plane)).max_by(|a, b| a.0.total_cmp(&b.0));
            let Some((over, HalfSpace { normal, .. })) = farthest.filter(|(over, _)| *over > 1e-9) else { break };
            let way = Pose::from_fn(|c| normal[c] / (scale[c] * scale[c]));
            let length = way.dot(normal);
            if length <= 0.0 {
                break;
            }
            for c in 0..4 {
                correction[c] -= way[c] * over / length;
            }
        }
        correction
    }

    /// The share of the margin that a correction uses, with the rows' motion as it is: 1 touches the picture's edge.
    pub fn crop_use(&self, correction: &Pose) -> f64 {
        self.planes().iter().map(|plane| plane.share(correction)).fold(0.0, f64::max)
    }

    /// What each channel of a correction takes of the margin where least of it is left; the sum is [`Bounds::crop_use`], and a channel
    /// that makes room there is negative.
    pub fn crop_shares(&self, correction: &Pose) -> PerChannel {
        let fullest = self.planes().iter().max_by(|a, b| a.share(correction).total_cmp(&b.share(correction)));
        let Some(plane) = fullest.filter(|plane| plane.share(correction) > 0.0) else { return [0.0; 4] };
        std::array::from_fn(|c| plane.normal[c] * correction[c] / plane.margin())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::ZOOM;

    /// What roll takes at the corners is not for yaw and pitch, and what a channel may be alone is less beside others.
    #[test]
    fn channels_share_the_margin() {
        let mut bounds = Bounds::default();
        for (x, y) in [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)] {
            bounds.add([x, 0.0, 0.5 * y, 0.0], 27.0, 30.0);
            bounds.add([0.0, y, 0.5 * x, 0.0], 18.0, 20.0);
        }
        assert_eq!(bounds.alone(), [30.0, 20.0, 40.0, f64::INFINITY]);
        let correction = Pose([20.0, -5.0, 8.0, 0.0]);
        assert_eq!(bounds.interval(YAW, &correction, Rows::Still), [-26.0, 26.0]);
        assert_eq!(bounds.interval(PITCH, &correction, Rows::Moving), [-14.0, 14.0]);
        assert_eq!(bounds.interval(ROLL, &correction, Rows::Still), [-20.0, 20.0]);
        assert_eq!(bounds.interval(ZOOM, &correction, Rows::Still), [f64::NEG_INFINITY, f64::INFINITY]);
        assert!((bounds.crop_use(&correction) - 24.0 / 27.0).abs() < 1e-12);
        let shares = bounds.crop_shares(&correction);
        assert!((shares[YAW] - 20.0 / 27.0).abs() < 1e-12 && (shares[ROLL] - 4.0 / 27.0).abs() < 1e-12, "{shares:?}");
        assert_eq!([shares[PITCH], shares[ZOOM]], [0.0, 0.0]);
        assert_eq!(bounds.crop_shares(&Pose::default()), [0.0; 4]);
        // yaw is at its bound where roll leaves 26 of 30; pitch is not asked
        assert_eq!(bounds.interval(YAW, &Pose([0.0, 20.0, 8.0, 0.0]), Rows::Still), [-26.0, 26.0]);
    }

    #[test]
    fn the_nearest_correction_is_inside_and_one_inside_stays() {
        let mut bounds = Bounds::default();
        for (x, y) in [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)] {
            bounds.add([x, 0.0, y, 0.0], 30.0, 30.0);
            bounds.add([0.0, y, x, 0.0], 20.0, 20.0);
        }
        let scale = [1.0, 1.0, 2.0, 1.0];
        let inside = Pose([12.0, -9.0, 8.0, 0.0]);
        assert_eq!(bounds.nearest(inside, 1.0, &scale), inside);
        for k in 0..200 {
            let t = f64::from(k);
            let far = Pose([90.0 * (0.7 * t).sin(), 70.0 * (1.1 * t).cos(), 50.0 * (0.3 * t).sin(), 0.0]);
            let near = bounds.nearest(far, 0.9, &scale);
            // what is left is for the scale that the smoother applies last
            assert!(bounds.crop_use(&near) < 0.95, "{far:?} to {near:?}: {}", bounds.crop_use(&near));
        }
        // straight beyond one plane, each channel moves in proportion to its effect
        let Pose([yaw, _, roll, _]) = bounds.nearest(Pose([35.0, 0.0, 0.0, 0.0]), 1.0, &[1.0; 4]);
        assert!((yaw - 30.0).abs() < 1e-6 && roll.abs() < 1e-6, "{yaw} {roll}");
        assert_eq!(bounds.corners().map(|corner| corner.slack), [30.0, 30.0, 30.0, 30.0, 20.0, 20.0, 20.0, 20.0]);
    }
}
