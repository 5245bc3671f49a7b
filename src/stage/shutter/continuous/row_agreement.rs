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
//! matters little: it then counts as 1.

use nalgebra::{SMatrix, SVector};

/// What a homography can do.
const BASIS: usize = 8;
/// Seconds for which agreement is remembered.
const MEMORY_S: f64 = 1.5;
/// Motion of the rows that is believed without agreement, pixels: less is not seen, and lost in the tracks' errors.
const UNCHECKED_PX: f64 = 0.06;
/// Agreement below which nothing is undone, and from which everything is: between the 0.2 of footage in which something else wobbles and
/// the 0.98 of rendered rolling shutter.
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
    /// What the eight ways in which a homography moves the picture have of a motion.
    #[inline]
    fn along(&self, [u, v]: [f64; 2]) -> [f64; BASIS] {
        let [x, y] = self.place;
        let outward = x * u + y * v;
        [u, x * u, y * u, v, x * v, y * v, x * outward, y * outward]
    }
}

/// Sums over the tracks of their weight times x^i y^j of their places, i + j up to 4.
#[derive(Clone, Copy, Debug, Default)]
struct Moments([[f64; 5]; 5]);

impl Moments {
    #[inline]
    fn add(&mut self, [x, y]: [f64; 2], weight: f64) {
        let mut by_x = weight;
        for (i, row) in self.0.iter_mut().enumerate() {
            let mut by_both = by_x;
            for sum in &mut row[..5 - i] {
                *sum += by_both;
                by_both *= y;
            }
            by_x *= x;
        }
    }

    /// The sums of products of the eight ways in which a homography moves the picture, x and y together: the lower triangle.
    fn normal(&self) -> SMatrix<f64, BASIS, BASIS> {
        let m = &self.0;
        let mut matrix = SMatrix::<f64, BASIS, BASIS>::zeros();
        let plane = [[m[0][0], 0.0, 0.0], [m[1][0], m[2][0], 0.0], [m[0][1], m[1][1], m[0][2]]];
        for (i, row) in plane.into_iter().enumerate() {
            for (j, entry) in row.into_iter().enumerate().take(i + 1) {
                matrix[(i, j)] = entry;
                matrix[(3 + i, 3 + j)] = entry;
            }
        }
        // x^2 and x y along x, x y and y^2 along y
        for (row, [i, j]) in [(6, [1, 0]), (7, [0, 1])] {
            for (column, [a, b]) in [(0, [0, 0]), (1, [1, 0]), (2, [0, 1])] {
                matrix[(row, column)] = m[1 + i + a][j + b];
                matrix[(row, 3 + column)] = m[i + a][1 + j + b];
            }
        }
        matrix[(6, 6)] = m[4][0] + m[2][2];
        matrix[(7, 6)] = m[3][1] + m[1][3];
        matrix[(7, 7)] = m[2][2] + m[0][4];
        matrix
    }
}

/// How the pictures agreed so far.
#[derive(Clone, Copy, Debug, Default)]
pub struct RowAgreement {
    /// Faded means over the tracks of r.p and p.p (pixels^2), and of 1.
    sums: [f64; 3],
}

impl RowAgreement {
    /// Adds what a pair of frames, `interval_s` apart, showed. With M the sums of products of the basis, s and t those of the basis with r
    /// and with p, what is left of `sum r.p` is `sum r.p - s' M^-1 t`.
    pub fn add(&mut self, tracks: impl Iterator<Item = Compared>, interval_s: f64) {
        let mut moments = Moments::default();
        let (mut seen, mut predicted) = ([0.0; BASIS], [0.0; BASIS]);
        // of r.p, p.p and 1; what a homography explains of the first two is taken from them below
        let (mut across, mut square, mut sum) = (0.0, 0.0, 0.0);
        for track in tracks {
            let Compared { place, moved: r, by_rows: p, weight } = track;
            moments.add(place, weight);
            for (sum, news) in seen.iter_mut().zip(track.along(r)) {
                *sum += weight * news;
            }
            for (sum, news) in predicted.iter_mut().zip(track.along(p)) {
                *sum += weight * news;
            }
            across += weight * (r[0] * p[0] + r[1] * p[1]);
            square += weight * (p[0] * p[0] + p[1] * p[1]);
            sum += weight;
        }
        // the factor is made of the lower triangle alone
        let matrix = moments.normal() + SMatrix::<f64, BASIS, BASIS>::identity() * 1e-9;
        let Some(factor) = matrix.cholesky() else { return };
        let predicted = SVector::<f64, BASIS>::from(predicted);
        let explained = factor.solve(&predicted);
        across -= SVector::<f64, BASIS>::from(seen).dot(&explained);
        square -= predicted.dot(&explained);
        if sum > 0.0 && across.is_finite() && square.is_finite() {
            let keep = (-interval_s / MEMORY_S).exp();
            for (sum, news) in self.sums.iter_mut().zip([across / sum, square / sum, 1.0]) {
                *sum = keep * *sum + (1.0 - keep) * news;
            }
        }
    }

    /// The share of the rows' motion that is there.
    fn share(&self) -> f64 {
        let unchecked = UNCHECKED_PX * UNCHECKED_PX;
        (self.sums[0] + unchecked) / (self.sums[1] + unchecked)
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
            let mut agreement = RowAgreement::default();
            assert_eq!(agreement.part(), 1.0);
            for _ in 0..200 {
                agreement.add(tracks(part, 1.0).into_iter(), 1.0 / 30.0);
            }
            assert!((agreement.share() - part).abs() < 0.02, "{part}: {}", agreement.share());
        }
    }

    #[test]
    fn what_is_small_is_believed() {
        let mut agreement = RowAgreement::default();
        for _ in 0..200 {
            agreement.add(tracks(0.0, 0.01).into_iter(), 1.0 / 30.0);
        }
        assert_eq!(agreement.part(), 1.0);
        agreement.add(std::iter::empty(), 1.0);
        assert_eq!(agreement.part(), 1.0);
    }
}
