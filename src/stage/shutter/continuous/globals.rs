//! What the tracks say of the camera's constants, believed slowly.
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
/// Part of the evidence that outlives a pair of frames.
const MEMORY: f64 = 0.9995;
/// Information on what is known for certain.
const CERTAIN: f64 = 1e18;

/// How far the times between frames are to be believed, from what their stamps say otherwise.
///
/// A speed is a difference of poses by a time; where the time is off by a part of itself, so is what the speed says of the readout time.
/// The errors of different pairs are independent, so that they average out.
#[derive(Clone, Copy, Debug, Default)]
pub struct Unevenness {
    /// Faded sums over the pairs: how much they said, and the squares of that times the relative error of their time.
    said: f64,
    squares: f64,
}

impl Unevenness {
    /// Takes in a pair of frames whose time may be off by the part `off` of itself, and of which the part `share` counts.
    pub fn take(&mut self, share: f64, off: f64) {
        self.said = MEMORY * self.said + share;
        self.squares = MEMORY * MEMORY * self.squares + share * share * off * off;
    }

    /// Standard deviation of the mean speed, a part of it.
    pub fn deviation(&self) -> f64 {
        if self.said > 0.0 { self.squares.sqrt() / self.said } else { 0.0 }
    }
}

/// The evidence so far; the globals' origin is where they are believed to be.
#[derive(Debug, Default)]
pub struct Globals {
    /// Information that was there before anything was measured.
    expected: [f64; G],
    /// How far the origin has come from what was expected.
    offset: [f64; G],
    evidence: Marginal,
    /// The filter's marginal after the last pair.
    last: Marginal,
}

impl Globals {
    /// Expects the globals at their origin, give or take `deviations`; 0 is for certain.
    pub fn new(deviations: [f64; G]) -> Self {
        let expected = deviations.map(|deviation| if deviation == 0.0 { CERTAIN } else { 1.0 / (deviation * deviation) });
        Self { expected, ..Self::default() }
    }

    /// Takes in the filter's marginal after a pair and says how far the origin is to be moved. The filter must then do so.
    pub fn take(&mut self, marginal: &Marginal) -> [f64; G] {
        for g in 0..G {
            for h in 0..G {
                let news = (marginal.matrix[g][h] - self.last.matrix[g][h]) / CAUTION;
                self.evidence.matrix[g][h] = MEMORY * self.evidence.matrix[g][h] + news;
            }
            let news = (marginal.right[g] - self.last.right[g]) / CAUTION;
            self.evidence.right[g] = MEMORY * self.evidence.right[g] + news;
        }
        let right = std::array::from_fn(|g| self.evidence.right[g] - self.expected[g] * self.offset[g]);
        self.information().map_or([0.0; G], |factor| factor.solve(&SVector::<f64, G>::from(right)).into())
    }

    /// The origin was moved by `shift`, after the filter said `marginal`.
    pub fn moved(&mut self, shift: [f64; G], marginal: &Marginal) {
        self.last = *marginal;
        self.last.move_origin(shift);
        self.evidence.move_origin(shift);
        for (offset, shift) in self.offset.iter_mut().zip(shift) {
            *offset += shift;
        }
    }

    /// Standard deviations of the globals.
    pub fn deviations(&self) -> [f64; G] {
        self.information().map_or(self.expected.map(|information| (1.0 / information).sqrt()), |factor| {
            let inverse = factor.inverse();
            std::array::from_fn(|g| inverse[(g, g)].max(0.0).sqrt())
        })
    }

    /// All information, as its factor; `None` where rounding left it no longer positive.
    fn information(&self) -> Option<Cholesky<f64, Const<G>>> {
        let entry = |g: usize, h: usize| match g == h {
            true => self.evidence.matrix[g][g].max(0.0) + self.expected[g],
            false => self.evidence.matrix[g][h],
        };
        SMatrix::<f64, G, G>::from_fn(entry).cholesky()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_of_times_average_out() {
        let mut times = Unevenness::default();
        assert_eq!(times.deviation(), 0.0);
        (0..100).for_each(|_| times.take(1.0, 0.3));
        assert!((times.deviation() - 0.03).abs() < 0.001, "{}", times.deviation());
        (0..100).for_each(|_| times.take(1.0, 0.0));
        assert!((times.deviation() - 0.015).abs() < 0.001, "{}", times.deviation());
        (0..100).for_each(|_| times.take(0.0, 9.0));
        assert!((times.deviation() - 0.015).abs() < 0.001, "what says nothing changes nothing: {}", times.deviation());
    }
}
