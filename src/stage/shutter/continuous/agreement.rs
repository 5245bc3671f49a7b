//! Whether the pictures agree that the rows moved as the path says: the part of the rows' motion that is to be undone.
//!
//! A homography explains whatever the whole picture does between two frames; what it leaves over of the tracks is the rows' own
//! motion, or something that the model does not know: parallax, a lens, a readout time that was guessed wrong, a camera that stabilizes
//! by itself. So both the tracks' motion r and the part of it that the model puts down to the rows, p, are cleared of all that a
//! homography can do (its eight derivatives at the identity), and compared:
//!
//! ```text
//! beta = sum r.p / sum p.p
//! ```
//!
//! is the share of p that is really there. Rendered rolling shutter gives 0.98 to 1; footage in which something else wobbles gives 0.2 to
//! 0.5, and undoing p there does more harm than good. Where p is small its own errors pull beta down (errors in variables) and it
//! matters little: it is then taken for 1.

use nalgebra::{SMatrix, SVector};

/// What a homography can do.
const BASIS: usize = 8;
/// Seconds for which the pictures' word is remembered.
const MEMORY_S: f64 = 1.5;
/// Motion that is believed without a word from the pictures, pixels.
const UNHEARD_PX: f64 = 0.06;
/// Agreement below which nothing is undone, and from which everything is.
const RAMP: [f64; 2] = [0.25, 0.9];

/// A track as it is compared.
#[derive(Clone, Copy, Debug)]
pub struct Compared {
    /// Half-way place, from the centre, in half widths.
    pub place: [f64; 2],
    /// How it moved, pixels.
    pub moved: [f64; 2],
    /// What of that the model puts down to the rows, pixels.
    pub by_rows: [f64; 2],
    /// How much it counts.
    pub weight: f64,
}

impl Compared {
    /// What moves the place along x, then along y.
    #[inline]
    fn basis(&self) -> [[f64; BASIS]; 2] {
        let [x, y] = self.place;
        [[1.0, x, y, 0.0, 0.0, 0.0, x * x, x * y], [0.0, 0.0, 0.0, 1.0, x, y, x * y, y * y]]
    }
}

/// The pictures' word so far.
#[derive(Clone, Copy, Debug, Default)]
pub struct Agreement {
    /// Faded means over the tracks of r.p and p.p (pixels^2), and of 1.
    sums: [f64; 3],
}

impl Agreement {
    /// Takes in what a pair of frames, `interval_s` apart, showed.
    pub fn take(&mut self, tracks: impl Iterator<Item = Compared> + Clone, interval_s: f64) {
        let mut matrix = [[0.0; BASIS]; BASIS];
        let (mut seen, mut said) = ([0.0; BASIS], [0.0; BASIS]);
        let mut sum = 0.0;
        for track in tracks.clone() {
            let [x, y] = track.basis();
            for i in 0..BASIS {
                let scaled = [track.weight * x[i], track.weight * y[i]];
                for j in 0..=i {
                    matrix[i][j] += scaled[0] * x[j] + scaled[1] * y[j];
                }
                seen[i] += scaled[0] * track.moved[0] + scaled[1] * track.moved[1];
                said[i] += scaled[0] * track.by_rows[0] + scaled[1] * track.by_rows[1];
            }
            sum += track.weight;
        }
        // the factor is made of the lower triangle alone
        let entry = |i: usize, j: usize| matrix[i][j] + if i == j { 1e-9 } else { 0.0 };
        let matrix = SMatrix::<f64, BASIS, BASIS>::from_fn(|i, j| if j <= i { entry(i, j) } else { 0.0 });
        let Some(factor) = matrix.cholesky() else { return };
        let [seen, said] = [seen, said].map(|right| factor.solve(&SVector::<f64, BASIS>::from(right)));
        let (mut across, mut square) = (0.0, 0.0);
        for track in tracks {
            for (i, row) in track.basis().iter().enumerate() {
                let dot = |solved: &SVector<f64, BASIS>| (0..BASIS).map(|k| row[k] * solved[k]).sum::<f64>();
                let (r, p) = (track.moved[i] - dot(&seen), track.by_rows[i] - dot(&said));
                across += track.weight * r * p;
                square += track.weight * p * p;
            }
        }
        if sum > 0.0 && across.is_finite() && square.is_finite() {
            let keep = (-interval_s / MEMORY_S).exp();
            for (sum, news) in self.sums.iter_mut().zip([across / sum, square / sum, 1.0]) {
                *sum = keep * *sum + (1.0 - keep) * news;
            }
        }
    }

    /// The share of the rows' motion that is there.
    fn share(&self) -> f64 {
        let unheard = UNHEARD_PX * UNHEARD_PX;
        (self.sums[0] + unheard) / (self.sums[1] + unheard)
    }

    /// The part of the rows' motion that is to be undone.
    pub fn part(&self) -> f64 {
        ((self.share() - RAMP[0]) / (RAMP[1] - RAMP[0])).clamp(0.0, 1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Tracks that move by a homography's worth plus `part` of what the rows are said to do.
    fn tracks(part: f64, size: f64) -> Vec<Compared> {
        let grid = (0..12).flat_map(|i| (0..9).map(move |j| [f64::from(i) / 6.0 - 1.0, f64::from(j) / 6.0 - 0.7]));
        grid.map(|[x, y]| {
            let by_rows = [size * (9.0 * y).sin() + 3.0 * y, size * (7.0 * y).cos()];
            let moved = [2.0 + x - y + 0.1 * x * y + part * by_rows[0], -1.0 + 0.3 * x + part * by_rows[1]];
            Compared { place: [x, y], moved, by_rows, weight: 1.0 }
        })
        .collect()
    }

    #[test]
    fn the_share_that_is_there_is_found() {
        for part in [1.0, 0.5, 0.0, -1.0] {
            let mut agreement = Agreement::default();
            assert_eq!(agreement.part(), 1.0);
            for _ in 0..200 {
                agreement.take(tracks(part, 1.0).into_iter(), 1.0 / 30.0);
            }
            assert!((agreement.share() - part).abs() < 0.02, "{part}: {}", agreement.share());
        }
    }

    #[test]
    fn what_is_small_is_believed() {
        let mut agreement = Agreement::default();
        for _ in 0..200 {
            agreement.take(tracks(0.0, 0.01).into_iter(), 1.0 / 30.0);
        }
        assert_eq!(agreement.part(), 1.0);
        agreement.take(std::iter::empty(), 1.0);
        assert_eq!(agreement.part(), 1.0);
    }
}
