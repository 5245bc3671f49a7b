//! How reliable a calibration that was estimated from footage is.
//!
//! The continuous model's standard deviations already distrust the tracks' statistics (its `evidence` module). Measured on eleven
//! rendered clips of known cameras (four seconds each; hands, walking, knocked desks, a vehicle, logged gyroscopes, a person in the
//! picture, darkness), from the best of several starts, the readout time was off by 0.0 to 1.2 of them, 0.1 in the median, and the
//! field of view by 0.0 to 0.4. [`FACTOR`] of them are stated, which leaves room for what is rendered nowhere: parallax,
//! lenses that bend otherwise than the model's. Field of view and lens are found together, so each alone is less sure than both. The errors of the frames' times are among them, as far as the stamps betray them (its `IntervalError`). A camera that travels is beyond that: on a clip from behind a windscreen, whose field of view is
//! 70 degrees, the model drifted to the edge of what it looks for, 45. So a field of view at that edge is not known at all. A floor
//! is added for what no length of footage averages out.

use super::continuous::{HFOV_LIMITS_DEG, LENS_LIMIT, LONGEST_READOUT};
use crate::geometry::{Calibration, hypot};

/// Standard deviations in a stated uncertainty.
pub const FACTOR: f64 = 2.0;
/// Least uncertainty of the readout time (frame intervals), of the field of view (degrees), and of the lens's k1.
const FLOOR: (f64, f64, f64) = (0.005, 0.2, 0.005);
/// Uncertainty beyond which a value is not known (frame intervals; degrees; k1).
pub const LIMIT: (f64, f64, f64) = (0.1, 5.0, 0.05);
/// Distance to the edge of what the model looks for at which a field of view counts as stuck there (degrees).
const STUCK_DEG: f64 = 0.5;
/// No readout takes longer than the frame interval (frame intervals); a little is left for error, and what the model looks for goes on
/// beyond ([`LONGEST_READOUT`]), so that what got stuck at its edge is told from a readout that fills the interval.
const MAX_READOUT: f64 = 1.05;
const _: () = assert!(MAX_READOUT < LONGEST_READOUT);
/// Where the edge begins at which the model may have got stuck (frame intervals).
const EDGE: f64 = 0.99;

/// An estimated value, and how far the truth may be from it (two standard deviations).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stated {
    /// The value.
    pub value: f64,
    /// The truth is at most this far away.
    pub uncertainty: f64,
}

/// The readout time (seconds) of a camera that gives a frame every `interval_s`, however uncertain.
pub fn readout(found: &Calibration, interval_s: f64) -> Stated {
    let uncertainty = hypot(FACTOR * found.readout_s.sigma, FLOOR.0 * interval_s);
    Stated { value: found.readout_s.value, uncertainty }
}

/// The horizontal field of view (degrees), however uncertain.
pub fn hfov(found: &Calibration) -> Stated {
    Stated { value: found.hfov_deg.value, uncertainty: hypot(FACTOR * found.hfov_deg.sigma, FLOOR.1) }
}

/// The lens's k1, however uncertain.
pub fn lens(found: &Calibration) -> Stated {
    Stated { value: found.lens_k1.value, uncertainty: hypot(FACTOR * found.lens_k1.sigma, FLOOR.2) }
}

/// The readout time, where it was estimated well enough to be used. One that fills the frame interval is believed only where the
/// field of view is known as well: where the model does not fit (a camera that travels), both go to their edges.
pub fn known_readout(found: &Calibration, interval_s: f64) -> Option<Stated> {
    let estimate = readout(found, interval_s);
    let sure = !found.readout_s.is_exact() && estimate.uncertainty <= LIMIT.0 * interval_s;
    let longest = if !found.hfov_deg.is_exact() && known_hfov(found).is_none() { EDGE } else { MAX_READOUT };
    (sure && estimate.value.abs() <= longest * interval_s).then_some(estimate)
}

/// The field of view, likewise.
pub fn known_hfov(found: &Calibration) -> Option<Stated> {
    let estimate = hfov(found);
    let [narrowest, widest] = HFOV_LIMITS_DEG;
    let inside = (narrowest + STUCK_DEG..=widest - STUCK_DEG).contains(&estimate.value);
    (inside && !found.hfov_deg.is_exact() && estimate.uncertainty <= LIMIT.1).then_some(estimate)
}

/// The lens's k1, likewise.
pub fn known_lens(found: &Calibration) -> Option<Stated> {
    let estimate = lens(found);
    let inside = estimate.value.abs() < LENS_LIMIT - estimate.uncertainty;
    (inside && !found.lens_k1.is_exact() && estimate.uncertainty <= LIMIT.2).then_some(estimate)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Estimate;

    #[test]
    fn what_was_given_or_is_vague_or_impossible_is_not_found_out() {
        let about = |value, sigma| Estimate { value, sigma };
        let found = Calibration { readout_s: about(-0.02, 5e-4), hfov_deg: about(60.0, 0.5), lens_k1: about(-0.1, 0.01) };
        let interval_s = 1.0 / 30.0;
        let known = known_readout(&found, interval_s).unwrap();
        assert_eq!(known.value, -0.02);
        assert!((1e-3..1.1e-3).contains(&known.uncertainty), "{known:?}");
        assert!((1.0..1.1).contains(&known_hfov(&found).unwrap().uncertainty));
        let [readout_s, hfov_deg, lens_k1] = [-0.02, 60.0, -0.1].map(Estimate::exact);
        let given = Calibration { readout_s, hfov_deg, lens_k1 };
        assert_eq!((known_readout(&given, interval_s), known_hfov(&given), known_lens(&given)), (None, None, None));
        assert_eq!(known_lens(&found).map(|known| known.value), Some(-0.1));
        for (value, sigma) in [(-0.35, 0.01), (0.34, 0.01), (0.1, 0.03)] {
            assert_eq!(known_lens(&Calibration { lens_k1: about(value, sigma), ..found }), None);
        }
        let vague = Calibration { readout_s: about(-0.02, 2e-3), hfov_deg: about(60.0, 2.6), ..found };
        assert_eq!((known_readout(&vague, interval_s), known_hfov(&vague)), (None, None));
        for limit in HFOV_LIMITS_DEG {
            assert_eq!(known_hfov(&Calibration { hfov_deg: about(limit, 0.5), ..found }), None);
        }
        let longest = LONGEST_READOUT * interval_s;
        for limit in [-longest, longest] {
            assert_eq!(known_readout(&Calibration { readout_s: about(limit, 5e-4), ..found }, interval_s), None);
        }
        assert_eq!(known_readout(&Calibration { readout_s: about(0.0367, 5e-4), ..found }, interval_s), None);
        let full = Calibration { readout_s: about(-interval_s, 5e-4), ..found };
        assert_eq!(known_readout(&full, interval_s).map(|known| known.value), Some(-interval_s));
        assert_eq!(known_readout(&Calibration { hfov_deg: about(HFOV_LIMITS_DEG[0], 0.5), ..full }, interval_s), None);
        assert_eq!(known_readout(&Calibration::default(), interval_s), None);
    }
}
