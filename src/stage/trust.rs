//! Trust in the motion: the correction fades out and in at a limited rate, so that bad tracking never makes it jump.

/// Seconds in which trust falls from 1 to 0 while nothing can be followed.
const FALL_S: f64 = 0.5;
/// Seconds in which it returns.
const RISE_S: f64 = 1.0;
/// Confidence above which a frame's motion counts as known.
const KNOWN: f64 = 0.35;
/// Seconds without known motion that change nothing: a cut, a flash, one blurred frame.
const GRACE_S: f64 = 0.15;

/// The trust that is left.
#[derive(Clone, Copy, Debug)]
pub struct Trust {
    level: f64,
    unknown_s: f64,
}

impl Default for Trust {
    fn default() -> Self {
        Self { level: 1.0, unknown_s: 0.0 }
    }
}

impl Trust {
    /// The trust (0 to 1, with no edge at either end) after `interval_s` seconds that ended in a frame whose motion is known with
    /// `confidence` (0 to 1).
    pub fn step(&mut self, confidence: f64, interval_s: f64) -> f64 {
        if confidence >= KNOWN {
            self.unknown_s = 0.0;
            self.level = (self.level + interval_s / RISE_S).min(1.0);
        } else {
            self.unknown_s += interval_s;
            if self.unknown_s > GRACE_S {
                self.level = (self.level - interval_s / FALL_S).max(0.0);
            }
        }
        self.level * self.level * (3.0 - 2.0 * self.level)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_bad_frame_changes_nothing_and_many_fade() {
        let mut trust = Trust::default();
        assert_eq!(trust.step(0.0, 1.0 / 30.0), 1.0);
        assert_eq!(trust.step(1.0, 1.0 / 30.0), 1.0);
        let mut before = 1.0;
        for _ in 0..30 {
            let now = trust.step(0.0, 1.0 / 30.0);
            assert!(now <= before && before - now < 0.12, "{before} {now}");
            before = now;
        }
        assert_eq!(before, 0.0);
        for _ in 0..40 {
            before = trust.step(1.0, 1.0 / 30.0);
        }
        assert_eq!(before, 1.0);
    }
}
