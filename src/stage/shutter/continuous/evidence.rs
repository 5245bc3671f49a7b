//! The calibration as the tracks indicate it, followed slowly.
//!
//! Each pair of frames adds a little to the marginal information on readout time, focal length and the lens's k1 (what is left of the normal
//! equations once the path is eliminated). Taken at its word it is far too sure of itself: a thousand tracks of one frame
//! share the lens's distortion, parallax and the timestamps' jitter, which the model does not have. So only the part
//! 1 / [`CAUTION`] of it counts, against what was expected of the camera before, and old evidence fades.

use nalgebra::{Cholesky, Const, SMatrix, SVector};

use super::normal::{G, Marginal};

/// How many times too sure the tracks' statistics are. On rendered clips, where nothing but noise is wrong, the estimate is off by
/// some five of its own standard deviations; on hand-held phones it is by some thirty.
const CAUTION: f64 = 1000.0;
/// Part of the evidence that outlives a pair of frames: a minute's counts at 30 frames/s.
const MEMORY: f64 = 0.9995;
/// Information of what is known for certain.
const CERTAIN: f64 = 1e18;

/// How far the times between frames are to be believed, from what their stamps say otherwise.
///
/// A speed is a difference of poses by a time; where the time is off by a part of itself, so is what the speed says of the readout time.
/// The errors of different pairs are independent, so that they average out.
#[derive(Clone, Copy, Debug, Default)]
pub struct IntervalError {
    /// Faded sums over the pairs: of their shares, and of the squares of these times the relative error of their time.
    shares: f64,
    squares: f64,
}

impl IntervalError {
    /// Adds a pair of frames whose time may be off by the part `off` of itself, and of which the part `share` counts.
    pub fn add(&mut self, share: f64, off: f64) {
        self.shares = MEMORY * self.shares + share;
        self.squares = MEMORY * MEMORY * self.squares + share * share * off * off;
    }

    /// Standard deviation of the mean speed, a part of it.
    pub fn deviation(&self) -> f64 {
        if self.shares > 0.0 { self.squares.sqrt() / self.shares } else { 0.0 }
    }
}

/// The evidence so far; the parameters' origin is where they are believed to be.
#[derive(Debug, Default)]
pub struct Evidence {
    /// Information of the prior.
    expected: [f64; G],
    /// How far the origin has come from the prior's mean.
    offset: [f64; G],
    /// Of the tracks, faded.
    sum: Marginal,
    /// The filter's marginal after the last pair.
    last: Marginal,
}

impl Evidence {
    /// None yet: a prior at the origin with standard deviations of `deviations`; 0 is for certain.
    pub fn new(deviations: [f64; G]) -> Self {
        let expected = deviations.map(|deviation| if deviation == 0.0 { CERTAIN } else { 1.0 / (deviation * deviation) });
        Self { expected, ..Self::default() }
    }

    /// Adds what is new in the filter's marginal after a pair, and says how far the origin is to be moved. The filter must then do so.
    pub fn add(&mut self, marginal: &Marginal) -> [f64; G] {
        for g in 0..G {
            for h in 0..G {
                let news = (marginal.matrix[g][h] - self.last.matrix[g][h]) / CAUTION;
                self.sum.matrix[g][h] = MEMORY * self.sum.matrix[g][h] + news;
            }
            let news = (marginal.right[g] - self.last.right[g]) / CAUTION;
            self.sum.right[g] = MEMORY * self.sum.right[g] + news;
        }
        let right = std::array::from_fn(|g| self.sum.right[g] - self.expected[g] * self.offset[g]);
        self.information().map_or([0.0; G], |factor| factor.solve(&SVector::<f64, G>::from(right)).into())
    }

    /// The origin was moved by `shift`, after the filter said `marginal`.
    pub fn move_origin(&mut self, shift: [f64; G], marginal: &Marginal) {
        self.last = *marginal;
        self.last.move_origin(shift);
        self.sum.move_origin(shift);
        for (offset, shift) in self.offset.iter_mut().zip(shift) {
            *offset += shift;
        }
    }

    /// Standard deviations of the parameters.
    pub fn deviations(&self) -> [f64; G] {
        self.information().map_or(self.expected.map(|information| (1.0 / information).sqrt()), |factor| {
            let inverse = factor.inverse();
            std::array::from_fn(|g| inverse[(g, g)].max(0.0).sqrt())
        })
    }

    /// All information, as its factor; `None` where rounding left it no longer positive.
    fn information(&self) -> Option<Cholesky<f64, Const<G>>> {
        let entry = |g: usize, h: usize| match g == h {
            true => self.sum.matrix[g][g].max(0.0) + self.expected[g],
            false => self.sum.matrix[g][h],
        };
        SMatrix::<f64, G, G>::from_fn(entry).cholesky()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_of_times_average_out() {
        let mut times = IntervalError::default();
        assert_eq!(times.deviation(), 0.0);
        (0..100).for_each(|_| times.add(1.0, 0.3));
        assert!((times.deviation() - 0.03).abs() < 0.001, "{}", times.deviation());
        (0..100).for_each(|_| times.add(1.0, 0.0));
        assert!((times.deviation() - 0.015).abs() < 0.001, "{}", times.deviation());
        (0..100).for_each(|_| times.add(0.0, 9.0));
        assert!((times.deviation() - 0.015).abs() < 0.001, "what says nothing changes nothing: {}", times.deviation());
    }

    /// A marginal that says parameter g to be `value[g]`, with information `information[g]` once caution is applied.
    fn marginal(information: [f64; G], value: [f64; G]) -> Marginal {
        let mut marginal = Marginal::default();
        for g in 0..G {
            marginal.matrix[g][g] = CAUTION * information[g];
            marginal.right[g] = CAUTION * information[g] * value[g];
        }
        marginal
    }

    #[test]
    fn evidence_and_prior_are_weighed_and_what_is_certain_stays() {
        let mut evidence = Evidence::new([1.0, 0.5, 0.0]);
        assert_eq!(evidence.deviations(), [1.0, 0.5, 1e-9]);
        let seen = marginal([3.0, 4.0, 100.0], [1.0, -1.0, 5.0]);
        let shift = evidence.add(&seen);
        for (shift, wanted) in shift.into_iter().zip([0.75, -0.5, 0.0]) {
            assert!((shift - wanted).abs() < 1e-9, "{shift:?}");
        }
        let [a, b, c] = evidence.deviations();
        assert!((a - 0.5).abs() < 1e-9 && (b - 8f64.sqrt().recip()).abs() < 1e-9 && c < 1e-8, "{a} {b} {c}");
    }

    #[test]
    fn what_was_followed_asks_for_no_more() {
        let mut evidence = Evidence::new([1.0, 0.5, 0.0]);
        let mut seen = marginal([3.0, 4.0, 0.0], [1.0, -1.0, 0.0]);
        let shift = evidence.add(&seen);
        evidence.move_origin(shift, &seen);
        seen.move_origin(shift);
        // nothing new was measured; the evidence fades a little, towards the prior
        let again = evidence.add(&seen);
        assert!(again.iter().all(|shift| shift.abs() < 1e-3) && again[0] < 0.0 && again[1] > 0.0, "{again:?}");
    }
}
