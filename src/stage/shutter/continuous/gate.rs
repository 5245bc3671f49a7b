//! The gate: the confidence in a pair's motion.
//!
//! The numbers were chosen by trial on rendered clips: darkness, a hand before the camera, a person in front of the background, cuts.

/// Standard deviations of the motion between two frames up to which it is believed, and from which not at all (pixels).
const DOUBTFUL_PX: [f64; 2] = [0.5, 2.0];
/// Weighted share of the tracks that agree up to which a motion is not believed, and from which it is.
const AGREEING: [f64; 2] = [0.15, 0.4];
/// Inliers up to which a motion is not believed, and from which it is.
const MIN_INLIERS: [f64; 2] = [6.0, 30.0];
/// The same after frames of which nothing was believed, as parts of the usual number, and seconds for which more are asked. A few points
/// that agree, right after a time in which nothing was seen, agree on anything (test
/// `after_silence_the_path_rests_and_a_few_points_are_not_believed_at_once`).
const WARY_SHARES: [f64; 2] = [0.1, 0.3];
const WARY_S: f64 = 0.3;
/// How fast the usual number of inliers is followed, frame by frame: over about a second.
const USUAL_NEWS: f64 = 0.05;

/// What the gate remembers.
#[derive(Clone, Copy, Debug, Default)]
pub struct Gate {
    /// How recently nothing was believed, 1 (the frame before) to 0.
    wary: f64,
    /// The usual number of inliers.
    usual: f64,
}

/// What speaks for a motion.
#[derive(Clone, Copy, Debug)]
pub struct Support {
    /// Sum of the tracks' weights.
    pub inliers: f64,
    /// Share of the tracks that agree, each by its prior weight.
    pub share: f64,
    /// Standard deviation of the motion, pixels; a few dark or blurred points leave it wide.
    pub sigma_px: f64,
}

impl Gate {
    /// Confidence in a motion, 0 (unknown) to 1.
    pub fn confidence(&mut self, support: &Support) -> f64 {
        let &Support { inliers, share, sigma_px } = support;
        let asked = [0, 1].map(|i| MIN_INLIERS[i].max(WARY_SHARES[i] * self.wary * self.usual));
        self.usual += USUAL_NEWS * (inliers - self.usual);
        ramp(inliers, asked) * ramp(share, AGREEING) * ramp(sigma_px, [DOUBTFUL_PX[1], DOUBTFUL_PX[0]])
    }

    /// The last pair's motion was believed, at least in part; `interval_s` seconds passed.
    pub fn passed(&mut self, interval_s: f64) {
        self.wary *= (-interval_s / WARY_S).exp();
    }

    /// The last pair's motion is unknown.
    pub fn failed(&mut self) {
        self.wary = 1.0;
    }
}

/// 0 at `from`, 1 at `to`, linear between.
fn ramp(x: f64, [from, to]: [f64; 2]) -> f64 {
    ((x - from) / (to - from)).clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    const CLEAR: Support = Support { inliers: 200.0, share: 0.9, sigma_px: 0.1 };

    #[test]
    fn each_condition_alone_closes_the_gate() {
        assert_eq!(Gate::default().confidence(&CLEAR), 1.0);
        for closed in [Support { inliers: 6.0, ..CLEAR }, Support { share: 0.15, ..CLEAR }, Support { sigma_px: 2.0, ..CLEAR }]
        {
            assert_eq!(Gate::default().confidence(&closed), 0.0, "{closed:?}");
        }
        assert_eq!(Gate::default().confidence(&Support { inliers: 18.0, ..CLEAR }), 0.5);
        assert_eq!(Gate::default().confidence(&Support { sigma_px: 1.25, ..CLEAR }), 0.5);
    }

    #[test]
    fn after_a_failure_more_inliers_are_asked_for_a_while() {
        let mut gate = Gate::default();
        (0..200).for_each(|_| assert_eq!(gate.confidence(&CLEAR), 1.0));
        let few = Support { inliers: 30.0, ..CLEAR };
        let mut calm = gate;
        assert_eq!(calm.confidence(&few), 1.0);
        gate.failed();
        let wary = gate.confidence(&few);
        assert!((0.2..0.3).contains(&wary), "30 of the usual 200: {wary}");
        gate.passed(1.0);
        assert_eq!(gate.confidence(&few), 1.0);
    }
}
