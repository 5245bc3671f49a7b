//! The virtual camera's next steps: as little acceleration as the crop window allows, given where the camera is expected.
//!
//! Unknown are the virtual camera's places now (x_0) and at the next ticks. Minimised is
//!
//! ```text
//! sum a_i^2 + wj sum j_i^2 + wv sum v_i^2 + sum rho_i E[excess_i^2]
//! ```
//!
//! with a, j, v the second, third and first differences, and excess_i how far the correction x_i - c_i is outside of the window at the
//! next ticks; c_i is normal, with the forecast's mean and deviation. What the window leaves now is up to the caller. E has a closed
//! form, and is smooth, so that a few Newton steps on a banded matrix suffice. An excess is what a hard push by the window's edge would
//! cost later; how much of it counts falls with the time that is left until it is known better. Only x_0 is used: with the next frame all is
//! planned again.

use super::Tuning;
use super::forecast::AHEAD;

/// Deviation of where the camera is known to be: a corner that is rounded off, half windows.
pub const KNOWN: f64 = 0.01;
/// Newton steps at most.
const ROUNDS: usize = 6;
/// A step that changes nothing more, half windows.
const SETTLED: f64 = 3e-4;
/// Off-diagonals of the equations, and the diagonal.
pub const BAND: usize = 4;

/// How the virtual camera moves.
#[derive(Clone, Copy, Debug, Default)]
pub struct Motion {
    /// Half windows.
    pub place: f64,
    /// Half windows to a tick.
    pub speed: f64,
    /// Half windows to a tick^2.
    pub acceleration: f64,
    /// Length of the step before, ticks.
    pub ticks: f64,
}

/// What the plan is made against.
#[derive(Clone, Copy, Debug, Default)]
pub struct Ahead {
    /// Where the camera is, and will be at 1, 2 .. ticks.
    pub camera: [f64; AHEAD],
    /// Standard deviations of that.
    pub deviation: [f64; AHEAD],
    /// Least and most correction later, as far as the camera's places are known, and from there on.
    pub known: [f64; 2],
    /// See `known`.
    pub later: [f64; 2],
    /// Length of a tick, seconds.
    pub tick_s: f64,
    /// Rate at which speed is worth as much as acceleration, Hz.
    pub drag_hz: f64,
    /// Seconds from now on for which the camera's places are known, not expected.
    pub known_s: f64,
}

/// A linear form in x_(i-3) .. x_i, and a constant.
type Form = [f64; 5];

/// The form of the step before, seen from this one.
fn before(form: Form) -> Form {
    [form[1], form[2], form[3], 0.0, form[4]]
}

fn minus(a: Form, b: Form, over: f64) -> Form {
    std::array::from_fn(|i| (a[i] - b[i]) / over)
}

/// Where to be now, `ticks` after `motion`.
pub fn next(tuning: &Tuning, motion: &Motion, ticks: f64, ahead: &Ahead) -> f64 {
    let (equations, right) = smoothness(tuning, motion, ticks, ahead);
    let mut x: [f64; AHEAD] = std::array::from_fn(|i| motion.place + motion.speed * (ticks + i as f64));
    for _ in 0..ROUNDS {
        let (mut matrix, mut vector) = (equations, right);
        for i in 1..AHEAD {
            let left_s = i as f64 * ahead.tick_s - ahead.known_s;
            let (edges, weight) = if left_s <= 0.0 {
                (ahead.known, tuning.rho_known)
            } else {
                (ahead.later, tuning.rho * (-left_s / tuning.option_s).exp())
            };
            let off = x[i] - ahead.camera[i];
            let (mut slope, mut curve) = (0.0, 1e-9);
            for (sign, edge) in [(-1.0, -edges[0]), (1.0, edges[1])] {
                let (first, second) = excess(sign * off - edge, ahead.deviation[i]);
                slope += sign * first;
                curve += second;
            }
            matrix[i][0] += weight * curve;
            vector[i] += weight * (curve * x[i] - slope);
        }
        solve(&mut matrix, &mut vector);
        let change = x.iter().zip(&vector).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        x = vector;
        if change < SETTLED {
            break;
        }
    }
    x[0]
}

/// Half the slope and half the curvature of E[max(0, e + deviation z)^2], z standard normal.
pub fn excess(e: f64, deviation: f64) -> (f64, f64) {
    let z = e / deviation;
    if z < -4.0 {
        return (0.0, 0.0);
    }
    if z > 4.0 {
        return (e, 1.0);
    }
    let share = normal(z);
    (e * share + deviation * (-0.5 * z * z).exp() * 0.398_942_280_401_432_7, share)
}

/// The standard normal distribution function, to 1e-7 (Abramowitz and Stegun 26.2.17).
fn normal(z: f64) -> f64 {
    let t = 1.0 / (1.0 + 0.231_641_9 * z.abs());
    let series = t * (0.319_381_530 + t * (-0.356_563_782 + t * (1.781_477_937 + t * (-1.821_255_978 + t * 1.330_274_429))));
    let tail = 0.398_942_280_401_432_7 * (-0.5 * z * z).exp() * series;
    if z < 0.0 { tail } else { 1.0 - tail }
}

/// Everything but the window: banded equations (diagonal first, then what is before it) and their right-hand side.
pub fn smoothness(tuning: &Tuning, motion: &Motion, ticks: f64, ahead: &Ahead) -> ([[f64; BAND]; AHEAD], [f64; AHEAD]) {
    let (mut matrix, mut right) = ([[0.0; BAND]; AHEAD], [0.0; AHEAD]);
    let pace = ahead.drag_hz * std::f64::consts::TAU * ahead.tick_s;
    let mut speed: Form = [0.0, 0.0, 0.0, 0.0, motion.speed];
    let mut acceleration: Form = [0.0, 0.0, 0.0, 0.0, motion.acceleration];
    let mut step_before = motion.ticks.max(1e-3);
    for i in 0..AHEAD {
        let step = if i == 0 { ticks } else { 1.0 };
        let middle = 0.5 * (step + step_before);
        let mut place: Form = [0.0, 0.0, -1.0, 1.0, 0.0];
        if i == 0 {
            place = [0.0, 0.0, 0.0, 1.0, -motion.place];
        }
        let v: Form = place.map(|value| value / step);
        let a = minus(v, before(speed), middle);
        let j = minus(a, before(acceleration), middle);
        for (form, weight) in [(a, middle), (j, tuning.jerk * middle), (v, pace * pace * step)] {
            for p in 0..BAND {
                if form[p] == 0.0 || i + p < BAND - 1 {
                    continue;
                }
                let row = i + p + 1 - BAND;
                right[row] -= weight * form[p] * form[4];
                for q in 0..=p {
                    if i + q + 1 >= BAND {
                        matrix[row][p - q] += weight * form[p] * form[q];
                    }
                }
            }
        }
        (speed, acceleration, step_before) = (v, a, step);
    }
    (matrix, right)
}

/// Solves banded symmetric positive definite equations; the solution takes the right-hand side's place.
pub fn solve<const B: usize, const N: usize>(matrix: &mut [[f64; B]; N], x: &mut [f64; N]) {
    for i in 0..N {
        for d in (1..B.min(i + 1)).rev() {
            let j = i - d;
            let mut sum = matrix[i][d];
            for e in d + 1..B.min(i + 1) {
                sum -= matrix[i][e] * matrix[j][e - d];
            }
            matrix[i][d] = sum / matrix[j][0];
        }
        let mut sum = matrix[i][0];
        for d in 1..B.min(i + 1) {
            sum -= matrix[i][d] * matrix[i][d];
        }
        matrix[i][0] = sum.max(1e-12).sqrt();
        let mut value = x[i];
        for d in 1..B.min(i + 1) {
            value -= matrix[i][d] * x[i - d];
        }
        x[i] = value / matrix[i][0];
    }
    for i in (0..N).rev() {
        x[i] /= matrix[i][0];
        for d in 1..B.min(i + 1) {
            x[i - d] -= matrix[i][d] * x[i];
        }
    }
}

#[cfg(test)]
mod tests;
