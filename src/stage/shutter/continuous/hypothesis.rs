//! A first idea of how the camera moved between two frames, for the background's sake: hypotheses judged over the whole picture.
//!
//! A hypothesis is a turn that may change from row to row: yaw and pitch as parabolas over the rows (a knock changes them within a
//! frame), roll and zoom as constants. Tried are the motion that was predicted, none, and what random tracks suggest. The one
//! with the least truncated cost wins. What counts is area, not number: the tracks of a richly textured person weigh little
//! more than the wall beside; and tracks that were background before weigh more.

use nalgebra::{SMatrix, SVector};

use crate::frame::Track;
use crate::geometry::Pose;

/// Unknowns: yaw and pitch (three each), roll, log zoom.
const UNKNOWNS: usize = 8;
/// Hypotheses from random tracks.
const DRAWS: usize = 96;
/// Tracks to a hypothesis.
const SAMPLE: usize = 4;
/// Cells of the picture over which weight is spread (columns, rows).
const CELLS: [usize; 2] = [8, 6];
/// Distance at which a hypothesis lets go of a track, pixels.
const LIMIT_PX: f64 = 2.5;
/// Truncated cost, as a share of the greatest there can be, below which a hypothesis is good enough to look no further.
const GOOD: f64 = 0.2;

/// Unknowns of a hypothesis.
pub type Turn = SVector<f64, UNKNOWNS>;

/// A track as the estimator sees it.
#[derive(Clone, Copy, Debug, Default)]
pub struct Sight {
    /// Motion, pixels.
    pub moved: [f64; 2],
    /// Derivative of a pixel by the pose, half-way.
    pub derivative: [Pose; 2],
    /// Row, -0.5 (top) to 0.5.
    pub row: f64,
    /// Share of the picture that it speaks for, times how surely it is background; 1 on average.
    pub say: f64,
}

/// Gives each track its say: cells share weight nearly evenly, and `background` says how surely each track was background before.
pub fn distribute_weights(tracks: &[Track], size: [usize; 2], background: impl Fn(usize) -> f64, sights: &mut [Sight]) {
    let mut counts = [0u32; CELLS[0] * CELLS[1]];
    let cell = |track: &Track| {
        let part = |i: usize| ((track.to[i] / size[i] as f64 * CELLS[i] as f64).max(0.0) as usize).min(CELLS[i] - 1);
        part(1) * CELLS[0] + part(0)
    };
    tracks.iter().for_each(|track| counts[cell(track)] += 1);
    let mut total = 0.0;
    for (i, (track, sight)) in tracks.iter().zip(sights.iter_mut()).enumerate() {
        // not quite evenly: one lone track speaks less surely for its cell than many
        sight.say = background(i) / f64::from(counts[cell(track)]).powf(0.75);
        total += sight.say;
    }
    let mean = (total / tracks.len().max(1) as f64).max(1e-12);
    sights.iter_mut().for_each(|sight| sight.say /= mean);
}

/// The hypothesis that the pose changes by `turn`, in all rows alike.
pub fn rigid(turn: Pose) -> Turn {
    Turn::from([turn[0], 0.0, 0.0, turn[1], 0.0, 0.0, turn[2], turn[3]])
}

impl Sight {
    /// Rows x and y of the linear equations in the unknowns.
    #[inline]
    fn rows(&self) -> [[f64; UNKNOWNS]; 2] {
        let bend = self.row * self.row - 1.0 / 12.0;
        self.derivative.map(|d| [d[0], d[0] * self.row, d[0] * bend, d[1], d[1] * self.row, d[1] * bend, d[2], d[3]])
    }

    /// Squared distance between what a change of the pose says and what was seen, pixels^2.
    #[inline]
    pub fn misfit_of(&self, pose: &Pose) -> f64 {
        let mut square = 0.0;
        for (d, moved) in self.derivative.iter().zip(self.moved) {
            let error = moved - (d[0] * pose[0] + d[1] * pose[1] + d[2] * pose[2] + d[3] * pose[3]);
            square += error * error;
        }
        square
    }

    /// Squared distance between what `turn` says and what was seen, pixels^2.
    #[inline]
    pub fn misfit(&self, turn: &Turn) -> f64 {
        let bend = self.row * self.row - 1.0 / 12.0;
        let yaw = turn[0] + turn[1] * self.row + turn[2] * bend;
        let pitch = turn[3] + turn[4] * self.row + turn[5] * bend;
        self.misfit_of(&[yaw, pitch, turn[6], turn[7]])
    }
}

/// The best hypothesis, and the squared distance (pixels^2) at which it lets go of a track.
pub fn best(sights: &[Sight], predicted: Pose, mut random: impl FnMut(usize) -> usize) -> (Turn, f64) {
    let limit = LIMIT_PX * LIMIT_PX;
    let cost = |turn: &Turn, give_up: f64| {
        let mut sum = 0.0;
        for sight in sights {
            sum += sight.say * (sight.misfit(turn) * (1.0 / limit)).min(1.0);
            if sum >= give_up {
                break;
            }
        }
        sum
    };
    let mut found = rigid(predicted);
    let mut least = cost(&found, f64::INFINITY);
    let good = GOOD * sights.len() as f64;
    if least > good {
        let still = rigid([0.0; 4]);
        let still_cost = cost(&still, least);
        if still_cost < least {
            (found, least) = (still, still_cost);
        }
        for _ in 0..DRAWS {
            if least <= good {
                break;
            }
            let mut sample = [0; SAMPLE];
            // those that were background before are drawn more often
            for index in &mut sample {
                *index = random(sights.len());
                if sights[*index].say < 0.5 {
                    *index = random(sights.len());
                }
            }
            let Some(turn) = solve(sample.iter().map(|&i| (&sights[i], 1.0))) else { continue };
            let turn_cost = cost(&turn, least);
            if turn_cost < least {
                (found, least) = (turn, turn_cost);
            }
        }
    }
    // polished with all that agree
    for scale in [limit, 0.5 * limit] {
        let weigh = |sight: &Sight| sight.say * super::geman_mcclure(sight.misfit(&found), scale);
        if let Some(better) = solve(sights.iter().map(|sight| (sight, weigh(sight)))) {
            found = better;
        }
    }
    (found, limit)
}

/// Least squares over weighted tracks (a track's place good to half a pixel), with reluctance against what few tracks cannot tell:
/// standard deviations of turn, its change and its bend over the rows, of roll and zoom.
fn solve<'a>(sights: impl Iterator<Item = (&'a Sight, f64)>) -> Option<Turn> {
    const EXPECTED: [f64; UNKNOWNS] = [1.0, 0.02, 0.01, 1.0, 0.02, 0.01, 0.02, 0.005];
    let (mut matrix, mut right) = ([[0.0; UNKNOWNS]; UNKNOWNS], [0.0; UNKNOWNS]);
    for (sight, weight) in sights {
        if weight < 1e-3 {
            continue;
        }
        let [x, y] = sight.rows();
        for i in 0..UNKNOWNS {
            let scaled = [weight * x[i], weight * y[i]];
            for j in 0..=i {
                matrix[i][j] += scaled[0] * x[j] + scaled[1] * y[j];
            }
            right[i] += scaled[0] * sight.moved[0] + scaled[1] * sight.moved[1];
        }
    }
    for i in 0..UNKNOWNS {
        matrix[i][i] += 0.25 / (EXPECTED[i] * EXPECTED[i]);
    }
    // the factor is made of the lower triangle alone
    let matrix = SMatrix::<f64, UNKNOWNS, UNKNOWNS>::from_fn(|i, j| if j <= i { matrix[i][j] } else { 0.0 });
    matrix.cholesky().map(|factor| factor.solve(&Turn::from(right)))
}
