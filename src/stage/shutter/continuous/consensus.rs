//! Consensus: how the camera moved between two frames, roughly, and which tracks are the background's: hypotheses judged over the whole
//! picture (MSAC; P. Torr, A. Zisserman, "MLESAC", CVIU 78, 2000, with a prediction and no motion as the first hypotheses).
//!
//! A hypothesis is a turn that may change from row to row: yaw and pitch as parabolas over the rows (a knock changes them within a
//! frame), roll and zoom as constants. Tried are the motion that was predicted, none, and what random tracks suggest. The one
//! with the least truncated cost wins. What counts is area, not number: the tracks of a richly textured person weigh little
//! more than the wall beside; and tracks that were background before weigh more.

use nalgebra::{SMatrix, SVector};

use crate::frame::Track;
use crate::geometry::{PITCH, PerChannel, Pose, ROLL, YAW, ZOOM};

/// Unknowns: yaw and pitch (three each), roll, log zoom.
const UNKNOWNS: usize = 8;
/// Hypotheses from random tracks: where half of them are background, one in 16 samples of four is, and 96 miss it once in 500 times.
const DRAWS: usize = 96;
/// Tracks to a hypothesis.
const SAMPLE: usize = 4;
/// Cells of the picture over which weight is spread (columns, rows).
const CELLS: [usize; 2] = [8, 6];
/// Squared distance from which a track is an outlier of a hypothesis, pixels^2: 2.5 px, since the hypotheses know no acceleration within the frame
/// and tracks on motion blur are off by a pixel.
pub const LIMIT_SQUARE: f64 = 2.5 * 2.5;
/// Truncated cost, as a share of the greatest there can be, below which a hypothesis is good enough to look no further.
const GOOD: f64 = 0.2;
/// Power of the number of tracks in a cell by which they share its weight: 1 would be evenly. One lone track speaks less surely for its
/// cell than many. Chosen by trial.
const SHARING: f64 = 0.75;
/// A track of less prior weight is drawn once more.
const DRAWN_AGAIN: f64 = 0.5;
/// Weight below which a track is left out of the least squares.
const MIN_WEIGHT: f64 = 1e-3;
/// Standard deviation of a track's place in the least squares, pixels.
const TRACK_SIGMA_PX: f64 = 0.5;
/// Standard deviations of the unknowns, against what few tracks cannot tell: yaw and its change and bend over the rows, pitch likewise,
/// roll, log zoom. Chosen by trial; a turn is hardly held, its bend
/// within a frame and the zoom are.
const EXPECTED: [f64; UNKNOWNS] = [1.0, 0.02, 0.01, 1.0, 0.02, 0.01, 0.02, 0.005];

/// Unknowns of a hypothesis.
pub type Turn = SVector<f64, UNKNOWNS>;

/// A track as the hypotheses see it.
#[derive(Clone, Copy, Debug, Default)]
pub struct Sight {
    /// Motion less the flow that is expected, pixels: what the turn has to explain.
    pub turned: [f64; 2],
    /// Derivative of a pixel by the pose, half-way.
    pub derivative: [PerChannel; 2],
    /// Row, -0.5 (top) to 0.5.
    pub row: f64,
    /// Prior weight: the share of the picture that it speaks for, times how surely it is background; 1 on average.
    pub weight: f64,
}

/// Gives each track its prior weight: cells share weight nearly evenly, and `background` says how surely each track was background before.
pub fn distribute_weights(tracks: &[Track], size: [usize; 2], background: impl Fn(usize) -> f64, sights: &mut [Sight]) {
    let mut counts = [0u32; CELLS[0] * CELLS[1]];
    let cell = |track: &Track| {
        let part = |i: usize| ((track.to[i] / size[i] as f64 * CELLS[i] as f64).max(0.0) as usize).min(CELLS[i] - 1);
        part(1) * CELLS[0] + part(0)
    };
    tracks.iter().for_each(|track| counts[cell(track)] += 1);
    let mut total = 0.0;
    for (i, (track, sight)) in tracks.iter().zip(sights.iter_mut()).enumerate() {
        sight.weight = background(i) / f64::from(counts[cell(track)]).powf(SHARING);
        total += sight.weight;
    }
    let mean = (total / tracks.len().max(1) as f64).max(1e-12);
    sights.iter_mut().for_each(|sight| sight.weight /= mean);
}

/// The hypothesis that the pose changes by `turn`, in all rows alike.
pub fn rigid(turn: Pose) -> Turn {
    Turn::from([turn[YAW], 0.0, 0.0, turn[PITCH], 0.0, 0.0, turn[ROLL], turn[ZOOM]])
}

impl Sight {
    /// Rows x and y of the linear equations in the unknowns.
    #[inline]
    fn rows(&self) -> [[f64; UNKNOWNS]; 2] {
        let bend = self.row * self.row - 1.0 / 12.0;
        self.derivative.map(|d| [d[0], d[0] * self.row, d[0] * bend, d[1], d[1] * self.row, d[1] * bend, d[2], d[3]])
    }

    /// Squared distance between what `turn` says and what was seen, pixels^2.
    #[inline]
    pub fn misfit(&self, turn: &Turn) -> f64 {
        let bend = self.row * self.row - 1.0 / 12.0;
        let yaw = turn[0] + turn[1] * self.row + turn[2] * bend;
        let pitch = turn[3] + turn[4] * self.row + turn[5] * bend;
        misfit(&self.derivative, self.turned, &Pose([yaw, pitch, turn[6], turn[7]]))
    }
}

/// Squared distance between how a point `moved` and what a change of the pose says of it, pixels^2.
#[inline]
pub fn misfit(derivative: &[PerChannel; 2], moved: [f64; 2], change: &Pose) -> f64 {
    let mut square = 0.0;
    for (row, moved) in derivative.iter().zip(moved) {
        let error = moved - change.dot(row);
        square += error * error;
    }
    square
}

/// The best hypothesis. `random` gives a number below its argument.
pub fn best(sights: &[Sight], predicted: Pose, random: impl FnMut(usize) -> usize) -> Turn {
    let mut best = search(sights, predicted, random);
    // refined with all that agree
    for scale in [LIMIT_SQUARE, 0.5 * LIMIT_SQUARE] {
        let weigh = |sight: &Sight| sight.weight * super::geman_mcclure(sight.misfit(&best), scale);
        if let Some(better) = solve(sights.iter().map(|sight| (sight, weigh(sight)))) {
            best = better;
        }
    }
    best
}

/// The hypothesis of the least truncated cost.
fn search(sights: &[Sight], predicted: Pose, mut random: impl FnMut(usize) -> usize) -> Turn {
    let mut best = rigid(predicted);
    let mut least = cost(sights, &best, f64::INFINITY);
    let good = GOOD * sights.len() as f64;
    if least <= good {
        return best;
    }
    let still = rigid(Pose::default());
    let still_cost = cost(sights, &still, least);
    if still_cost < least {
        (best, least) = (still, still_cost);
    }
    for _ in 0..DRAWS {
        if least <= good {
            break;
        }
        let sample = draw(sights, &mut random);
        let Some(turn) = solve(sample.iter().map(|&i| (&sights[i], 1.0))) else { continue };
        let turn_cost = cost(sights, &turn, least);
        if turn_cost < least {
            (best, least) = (turn, turn_cost);
        }
    }
    best
}

/// The truncated cost of a hypothesis, or some number above `give_up`.
fn cost(sights: &[Sight], turn: &Turn, give_up: f64) -> f64 {
    let mut sum = 0.0;
    for sight in sights {
        sum += sight.weight * (sight.misfit(turn) * (1.0 / LIMIT_SQUARE)).min(1.0);
        if sum >= give_up {
            break;
        }
    }
    sum
}

/// Random tracks; those that were background before more often.
fn draw(sights: &[Sight], random: &mut impl FnMut(usize) -> usize) -> [usize; SAMPLE] {
    let mut sample = [0; SAMPLE];
    for index in &mut sample {
        *index = random(sights.len());
        if sights[*index].weight < DRAWN_AGAIN {
            *index = random(sights.len());
        }
    }
    sample
}

/// Least squares over weighted tracks, with a prior of [`EXPECTED`].
fn solve<'a>(sights: impl Iterator<Item = (&'a Sight, f64)>) -> Option<Turn> {
    let (mut matrix, mut right) = ([[0.0; UNKNOWNS]; UNKNOWNS], [0.0; UNKNOWNS]);
    for (sight, weight) in sights {
        if weight < MIN_WEIGHT {
            continue;
        }
        let [x, y] = sight.rows();
        for i in 0..UNKNOWNS {
            let scaled = [weight * x[i], weight * y[i]];
            for j in 0..=i {
                matrix[i][j] += scaled[0] * x[j] + scaled[1] * y[j];
            }
            right[i] += scaled[0] * sight.turned[0] + scaled[1] * sight.turned[1];
        }
    }
    for i in 0..UNKNOWNS {
        matrix[i][i] += TRACK_SIGMA_PX * TRACK_SIGMA_PX / (EXPECTED[i] * EXPECTED[i]);
    }
    // the factor is made of the lower triangle alone
    let matrix = SMatrix::<f64, UNKNOWNS, UNKNOWNS>::from_fn(|i, j| if j <= i { matrix[i][j] } else { 0.0 });
    matrix.cholesky().map(|factor| factor.solve(&Turn::from(right)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pinhole;
    use crate::random::Congruential;

    const SIZE: [usize; 2] = [640, 480];

    /// Tracks on a grid whose motion is `turn`'s, but for those that `is_person` tells by their place: these move by `own`, pixels.
    fn scene(turn: &Turn, is_person: impl Fn([f64; 2]) -> bool, own: [f64; 2]) -> (Vec<Track>, Vec<Sight>) {
        let camera = Pinhole::new(SIZE, 60.0);
        let grid = (0..24).flat_map(|i| (0..18).map(move |j| [f64::from(i) * 26.0 + 20.0, f64::from(j) * 26.0 + 20.0]));
        let track = |from: [f64; 2]| {
            let sight =
                Sight { derivative: camera.derivative(from), row: from[1] / 480.0 - 0.5, weight: 1.0, ..Sight::default() };
            let moved = match is_person(from) {
                true => own,
                false => sight.rows().map(|row| (0..UNKNOWNS).map(|k| row[k] * turn[k]).sum()),
            };
            let to = [from[0] + moved[0], from[1] + moved[1]];
            (Track { from, to, background: 1.0, ..Track::default() }, Sight { turned: moved, ..sight })
        };
        grid.map(track).unzip()
    }

    fn random() -> impl FnMut(usize) -> usize {
        let mut generator = Congruential::new(7);
        move |limit| generator.below(limit)
    }

    /// Half the tracks are a person's who covers a third of the picture; the background moves as nothing predicted.
    #[test]
    fn the_background_wins_over_a_person() {
        let turn = Turn::from([0.03, 0.004, 0.0, -0.02, 0.002, 0.0, 0.005, 0.0]);
        let is_person = |[x, y]: [f64; 2]| (200.0..440.0).contains(&x) && y > 100.0;
        let (mut tracks, mut sights) = scene(&turn, is_person, [9.0, -4.0]);
        // the person's texture is finer: three tracks where the wall has one
        let more: Vec<usize> = (0..tracks.len()).filter(|&i| is_person(tracks[i].from)).collect();
        for i in more.iter().chain(&more) {
            tracks.push(tracks[*i]);
            sights.push(sights[*i]);
        }
        distribute_weights(&tracks, SIZE, |_| 1.0, &mut sights);
        let mean = sights.iter().map(|sight| sight.weight).sum::<f64>() / sights.len() as f64;
        assert!((mean - 1.0).abs() < 1e-9, "{mean}");
        let found = best(&sights, Pose::default(), random());
        for (sight, track) in sights.iter().zip(&tracks) {
            let misfit = sight.misfit(&found);
            assert_eq!(misfit < LIMIT_SQUARE, !is_person(track.from), "{track:?}: {misfit} px^2 from {found}");
        }
    }

    #[test]
    fn a_prediction_that_fits_is_taken_without_a_draw() {
        let predicted = Pose([0.02, 0.01, 0.003, 0.0]);
        let (_, sights) = scene(&rigid(predicted), |_| false, [0.0; 2]);
        let found = best(&sights, predicted, |_| panic!("a sample was drawn"));
        assert!((found - rigid(predicted)).norm() < 1e-4, "{found}");
    }

    #[test]
    fn one_that_moved_by_itself_before_weighs_less() {
        let (tracks, mut sights) = scene(&rigid(Pose::default()), |_| false, [0.0; 2]);
        distribute_weights(&tracks, SIZE, |i| if i == 0 { 0.05 } else { 1.0 }, &mut sights);
        assert!((sights[0].weight / sights[1].weight - 0.05).abs() < 1e-9);
    }
}
