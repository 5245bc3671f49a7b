//! How far the camera's motion goes on from one frame to the next: what is expected of a frame in which nothing is seen.
//!
//! Each channel is a first-order autoregressive process, `m(k) = a m(k - 1) + noise`, with `a` the mean of `m(k) m(k - 1)` over that of
//! `m(k - 1)^2` in the last seconds: near 1 for a walk or a pan, near 0 where errors of the tracks are all that moves.

use crate::geometry::{PerChannel, Pose};

/// Seconds in which both means follow.
const LEARN_S: f64 = 1.5;
/// The factor `a` before anything is known, and the mean square of the motion (radians^2, or log zoom^2) at which it weighs as much as what
/// was measured. Chosen by trial on recordings of phones whose pictures blur.
const EXPECTED: f64 = 0.7;
const EXPECTED_WEIGHT: f64 = 1e-6;
/// The most: a pan whose pictures go dark comes to rest after some six frames' motion.
const MAX: f64 = 0.85;

/// The means so far.
#[derive(Clone, Copy, Debug, Default)]
pub struct Persistence {
    products: PerChannel,
    squares: PerChannel,
    before: Option<Pose>,
}

impl Persistence {
    /// Takes in the motion of a frame that was measured `interval_s` seconds after the one before.
    pub fn learn(&mut self, motion: Pose, interval_s: f64) {
        if let Some(before) = self.before.replace(motion) {
            let news = 1.0 - (-interval_s / LEARN_S).exp();
            for c in 0..4 {
                self.products[c] += news * (motion[c] * before[c] - self.products[c]);
                self.squares[c] += news * (before[c] * before[c] - self.squares[c]);
            }
        }
    }

    /// A frame's motion is unknown: the next one has none before it.
    pub fn skip(&mut self) {
        self.before = None;
    }

    /// The motion that is expected after `motion`.
    pub fn next(&self, motion: Pose) -> Pose {
        Pose::from_fn(|c| {
            let product = self.products[c] + EXPECTED * EXPECTED_WEIGHT;
            let square = self.squares[c] + EXPECTED_WEIGHT;
            motion[c] * (product / square).clamp(0.0, MAX)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn after(motion: impl Fn(f64) -> f64) -> f64 {
        let mut persistence = Persistence::default();
        (0..90).for_each(|k| persistence.learn(Pose([motion(f64::from(k)); 4]), 1.0 / 30.0));
        persistence.next(Pose([1.0; 4]))[0]
    }

    #[test]
    fn a_pan_goes_on_and_errors_do_not() {
        assert_eq!(after(|_| 0.02), MAX);
        assert_eq!(after(|k| 0.003 * if k % 2.0 == 0.0 { 1.0 } else { -1.0 }), 0.0);
        // of a swing of eight frames' period, cos(2 pi / 8) = .71 goes on
        let swing = after(|k| 0.02 * (std::f64::consts::FRAC_PI_4 * k).sin());
        assert!((swing - 0.71).abs() < 0.05, "{swing}");
        assert!((after(|_| 0.0) - EXPECTED).abs() < 1e-12);
    }

    #[test]
    fn a_gap_is_no_step() {
        let mut persistence = Persistence::default();
        for k in 0..60 {
            persistence.learn(Pose([0.01 * f64::from(k % 2); 4]), 1.0 / 30.0);
            persistence.skip();
        }
        assert!((persistence.next(Pose([1.0; 4]))[0] - EXPECTED).abs() < 1e-12);
    }
}
