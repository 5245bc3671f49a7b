//! A first idea of how the camera moved between two frames, for the background's sake: hypotheses judged over the whole picture.
//!
//! One turn (yaw, pitch, roll, log zoom) is supposed for the whole frame: the motion that was predicted, none, and those that
//! random pairs of tracks suggest. The one with the least truncated cost wins. What counts is area, not number: the tracks of a
//! richly textured person weigh no more than the wall beside; and tracks that were background before weigh more.

use nalgebra::{Matrix4, Vector4};

use crate::frame::Track;
use crate::geometry::{Pinhole, Pose};

/// Hypotheses from pairs of tracks.
const DRAWS: usize = 48;
/// Cells of the picture over which weight is spread (columns, rows).
const CELLS: [usize; 2] = [8, 6];

/// A track as the estimator sees it.
#[derive(Clone, Copy, Debug, Default)]
pub struct Sight {
    /// Motion, pixels.
    pub moved: [f64; 2],
    /// Derivative of a pixel by the pose, half-way.
    pub derivative: [Pose; 2],
    /// Share of the picture that it speaks for, times how surely it is background; 1 on average.
    pub say: f64,
}

/// Gives each track its say: cells share weight evenly (by the square root of their number, a compromise between area and
/// number), and `background` says how surely each was background before.
pub fn share_out(tracks: &[Track], size: [usize; 2], background: impl Fn(usize) -> f64, sights: &mut [Sight]) {
    let mut counts = [0u32; CELLS[0] * CELLS[1]];
    let cell = |track: &Track| {
        let part = |i: usize| ((track.to[i] / size[i] as f64 * CELLS[i] as f64).max(0.0) as usize).min(CELLS[i] - 1);
        part(1) * CELLS[0] + part(0)
    };
    tracks.iter().for_each(|track| counts[cell(track)] += 1);
    let mut total = 0.0;
    for (i, (track, sight)) in tracks.iter().zip(sights.iter_mut()).enumerate() {
        let count = f64::from(counts[cell(track)]);
        sight.say = background(i) / count.powf(0.75);
        total += sight.say;
    }
    let mean = (total / tracks.len().max(1) as f64).max(1e-12);
    sights.iter_mut().for_each(|sight| sight.say /= mean);
}

/// Squared distance between what `turn` says of a track and what was seen.
#[inline]
pub fn misfit(sight: &Sight, turn: &Pose) -> f64 {
    let along = |d: &Pose| d[0] * turn[0] + d[1] * turn[1] + d[2] * turn[2] + d[3] * turn[3];
    let (ex, ey) = (sight.moved[0] - along(&sight.derivative[0]), sight.moved[1] - along(&sight.derivative[1]));
    ex * ex + ey * ey
}

/// The best hypothesis, and the squared distance (pixels^2) at which it lets go of a track.
pub fn best(sights: &[Sight], predicted: Pose, camera: &Pinhole, mut random: impl FnMut(usize) -> usize) -> (Pose, f64) {
    // rows move differently within a frame, the more the faster the camera: one turn cannot fit them all
    let limit = |turn: &Pose| {
        let speed = camera.focal * turn[0].hypot(turn[1]);
        (1.5 + 0.2 * speed).powi(2)
    };
    let cost = |turn: &Pose, give_up: f64| {
        let limit = limit(turn);
        let mut sum = 0.0;
        for sight in sights {
            sum += sight.say * (misfit(sight, turn) / limit).min(1.0);
            if sum >= give_up {
                break;
            }
        }
        sum
    };
    let still = [0.0; 4];
    // what was expected has a start over chance
    let mut found = (predicted, 0.9 * cost(&predicted, f64::INFINITY));
    for i in 0..=DRAWS {
        let turn = if i == 0 {
            still
        } else {
            match from_pair(&sights[random(sights.len())], &sights[random(sights.len())]) {
                Some(turn) => turn,
                None => continue,
            }
        };
        let cost = cost(&turn, found.1);
        if cost < found.1 {
            found = (turn, cost);
        }
    }
    (found.0, limit(&found.0))
}

/// The turn that explains two tracks, with a little reluctance against zoom and roll that two near points cannot tell.
fn from_pair(a: &Sight, b: &Sight) -> Option<Pose> {
    let mut matrix = Matrix4::from_diagonal(&Vector4::new(1e-3, 1e-3, 2e3, 1e4));
    let mut right = Vector4::zeros();
    for sight in [a, b] {
        for (row, moved) in sight.derivative.iter().zip(sight.moved) {
            let row = Vector4::from(*row);
            matrix.ger(1.0, &row, &row, 1.0);
            right.axpy(moved, &row, 1.0);
        }
    }
    matrix.cholesky().map(|factor| factor.solve(&right).into())
}
