//! The plan of yaw, pitch and roll together, for a window that is full.
//!
//! Minimised is what [`super::plan`] minimises, summed over the channels, with one window for all:
//!
//! ```text
//! sum_c (sum a_ci^2 + wj sum j_ci^2 + wv_c sum v_ci^2) + sum rho_i sum_k E[excess_ik^2],   excess_ik = max(0, n_k . e_i - m_k)
//! ```
//!
//! with e_i = x_i - c_i the correction at tick i and n_k . e <= m_k the half-spaces of the crop window that bind first. Room that roll
//! takes at the corners is missing for yaw and pitch: where these need it, roll gives it back, and a weak pull moves it slowly towards the
//! middle of the path that the camera is expected to take. Zoom takes its room first and is planned alone: if it could make room for the
//! others, the picture would zoom in and out.
//!
//! Lengths are in units of the window's least margin, for all channels; times in ticks.

use std::f64::consts::TAU;

use super::Tuning;
use super::forecast::AHEAD;
use super::plan::{self, Ahead, BAND, Motion};
use crate::geometry::{PITCH, PerChannel, Pose, ROLL, YAW, ZOOM, hypot};
use crate::stage::crop::{Bounds, CORNERS, Corner};

/// Channels that are planned: yaw, pitch and roll.
pub const C: usize = 3;
/// Unknowns: tick by tick, the channels of each.
const UNKNOWNS: usize = AHEAD * C;
/// Off-diagonals of the equations, and the diagonal.
const WIDTH: usize = (BAND - 1) * C + 1;
/// Newton steps at most.
const ROUNDS: usize = 4;
/// A step that changes nothing more, units.
const SETTLED: f64 = 1e-3;
/// Weight of an excess that is left out.
const MIN_WEIGHT: f64 = 1e-3;

/// Places at each tick.
type Places = [[f64; C]; AHEAD];

/// Plans yaw, pitch and roll.
#[derive(Clone, Debug, Default)]
pub struct Planner {
    /// The plan of the step before, in the path's units; none where there was none.
    plan: Option<Places>,
}

/// What a step is made in.
#[derive(Clone, Copy, Debug)]
pub struct JointInput<'a> {
    /// The camera's place.
    pub camera: Pose,
    /// What each channel expects, in units of its `limit`.
    pub ahead: &'a [Ahead; C],
    /// How each channel moved, in the path's units and ticks.
    pub motion: &'a [Motion; C],
    /// The largest correction of each channel; 0 for one that is not corrected.
    pub limit: [f64; C],
    /// Ticks since the step before.
    pub ticks: f64,
    /// The crop window ..
    pub bounds: &'a Bounds,
    /// .. and the part of it that may be used.
    pub part: f64,
    /// The zoom's correction.
    pub zoom: f64,
}

/// A correction of yaw, pitch and roll, in the path's units.
#[derive(Clone, Copy, Debug)]
pub struct Planned {
    /// As the plan wants it, ..
    pub wanted: [f64; C],
    /// .. and as the window allows it.
    pub inside: [f64; C],
}

/// A half-space of the window: `normal . correction <= margin`, in units.
#[derive(Clone, Copy, Debug, Default)]
struct HalfSpace {
    normal: [f64; C],
    /// As far as the camera's places are known.
    known: f64,
    /// From there on.
    later: f64,
}

/// The window in units, and the units.
struct Window {
    half_spaces: [HalfSpace; CORNERS],
    /// Pixels by which a channel moves the corners, to a unit of the path.
    scale: [f64; C],
    /// A unit of the plan, in the path's.
    unit: [f64; C],
}

/// The equations: banded, diagonal first, then what is before it.
struct Equations {
    matrix: [[f64; WIDTH]; UNKNOWNS],
    right: [f64; UNKNOWNS],
}

impl Planner {
    /// There is no plan before the next one.
    pub fn forget(&mut self) {
        self.plan = None;
    }

    /// The correction now. None where there is no window.
    pub fn step(&mut self, tuning: &Tuning, at: &JointInput<'_>) -> Option<Planned> {
        let window = Window::new(tuning, at)?;
        let unit = window.unit;
        let mut equations = Equations { matrix: [[0.0; WIDTH]; UNKNOWNS], right: [0.0; UNKNOWNS] };
        for c in 0..C {
            let Motion { place, speed, acceleration, ticks } = at.motion[c];
            let place = (place - at.camera[c]) / unit[c];
            let motion = Motion { place, speed: speed / unit[c], acceleration: acceleration / unit[c], ticks };
            equations.add(c, plan::smoothness(tuning, &motion, at.ticks, &at.ahead[c]));
        }
        equations.give_back(ROLL, tuning.roll_return_hz, at, unit[ROLL]);
        let mut places = self.before(at).map(|place| std::array::from_fn(|c| (place[c] - at.camera[c]) / unit[c]));
        for _ in 0..ROUNDS {
            if equations.improve(tuning, at, &window, &mut places) < SETTLED {
                break;
            }
        }
        self.plan = Some(places.map(|place| std::array::from_fn(|c| at.camera[c] + place[c] * unit[c])));
        let wanted: [f64; C] = std::array::from_fn(|c| places[0][c] * unit[c]);
        let ([yaw, pitch, roll], most) = (wanted, at.limit[ROLL]);
        let near = at.bounds.nearest(Pose([yaw, pitch, roll.clamp(-most, most), at.zoom]), at.part, &window.pixels());
        Some(Planned { wanted, inside: [near[YAW], near[PITCH], near[ROLL]] })
    }

    /// Where the search begins: the plan of the step before, a step later; at first, on at the same speed.
    fn before(&self, at: &JointInput<'_>) -> Places {
        std::array::from_fn(|i| match &self.plan {
            Some(plan) => {
                let place = (i as f64 + at.ticks).min((AHEAD - 1) as f64);
                let j = (place as usize).min(AHEAD - 2);
                std::array::from_fn(|c| plan[j][c] + (place - j as f64) * (plan[j + 1][c] - plan[j][c]))
            }
            None => std::array::from_fn(|c| at.motion[c].place + at.motion[c].speed * (at.ticks + i as f64)),
        })
    }
}

impl Window {
    fn new(tuning: &Tuning, at: &JointInput<'_>) -> Option<Self> {
        let corners = at.bounds.corners();
        let (left_right, up_down) = corners.split_at(CORNERS / 2);
        let scale: [f64; C] = std::array::from_fn(|c| {
            let most = |corners: &[Corner]| corners.iter().map(|corner| corner.normal[c].abs()).fold(0.0, f64::max);
            let scale = hypot(most(left_right), most(up_down));
            if scale > 0.0 { scale } else { 1.0 }
        });
        let least = corners.iter().map(|corner| corner.slack).filter(|slack| *slack > 0.0).fold(f64::INFINITY, f64::min);
        let margin_px = at.part * least;
        if !margin_px.is_finite() {
            return None;
        }
        let mut half_spaces = [HalfSpace::default(); CORNERS];
        for (half_space, Corner { normal, slack }) in half_spaces.iter_mut().zip(&corners) {
            // a margin of nothing is beside a picture of another shape, or there is no plane: it does not bound
            if *slack > 0.0 {
                let side = if normal[PITCH].abs() * at.limit[PITCH] > normal[YAW].abs() * at.limit[YAW] { PITCH } else { YAW };
                let margin = (at.part * slack - normal[ZOOM] * at.zoom).max(0.0) / margin_px;
                let slope = |c: usize| if at.limit[c] > 0.0 { normal[c] / scale[c] } else { 0.0 };
                let (known, later) = (tuning.known * margin, at.ahead[side].later[1] * margin);
                *half_space = HalfSpace { normal: std::array::from_fn(slope), known, later };
            }
        }
        Some(Self { half_spaces, scale, unit: scale.map(|scale| margin_px / scale) })
    }

    /// Pixels to a unit of the path, for distances between corrections; the zoom does not move.
    fn pixels(&self) -> PerChannel {
        let [yaw, pitch, roll] = self.scale;
        [yaw, pitch, roll, f64::INFINITY]
    }
}

impl Equations {
    /// Adds what channel `c` is to be but for the window.
    fn add(&mut self, c: usize, (matrix, right): ([[f64; BAND]; AHEAD], [f64; AHEAD])) {
        for (i, (row, value)) in matrix.iter().zip(right).enumerate() {
            for (d, entry) in row.iter().enumerate() {
                self.matrix[i * C + c][d * C] = *entry;
            }
            // no channel is without any equation
            self.matrix[i * C + c][0] += 1e-9;
            self.right[i * C + c] = value;
        }
    }

    /// Adds a weak pull of channel `c` towards the middle of the path that the camera is expected to take.
    fn give_back(&mut self, c: usize, hz: f64, at: &JointInput<'_>, unit: f64) {
        if at.limit[c] > 0.0 {
            let Ahead { tick_s, camera, .. } = at.ahead[c];
            let weight = (hz * TAU * tick_s).powi(4);
            let middle = camera.iter().sum::<f64>() / AHEAD as f64 * at.limit[c] / unit;
            for row in (c..UNKNOWNS).step_by(C) {
                self.matrix[row][0] += weight;
                self.right[row] += weight * middle;
            }
        }
    }

    /// A Newton step; gives how far it moved the farthest place.
    fn improve(&self, tuning: &Tuning, at: &JointInput<'_>, window: &Window, places: &mut Places) -> f64 {
        let (mut matrix, mut vector) = (self.matrix, self.right);
        let Ahead { tick_s, known_s, .. } = at.ahead[YAW];
        for (i, place) in places.iter().enumerate().skip(1) {
            let left_s = i as f64 * tick_s - known_s;
            let known = left_s <= 0.0;
            let weight = if known { tuning.rho_known } else { tuning.rho * (-left_s / tuning.option_s).exp() };
            if weight < MIN_WEIGHT {
                break;
            }
            let part = |c: usize| at.limit[c] / window.unit[c];
            let camera: [f64; C] = std::array::from_fn(|c| at.ahead[c].camera[i] * part(c));
            let deviation: [f64; C] = std::array::from_fn(|c| at.ahead[c].deviation[i] * part(c));
            for half_space in &window.half_spaces {
                let normal = &half_space.normal;
                let (mut over, mut variance, mut along) =
                    (-if known { half_space.known } else { half_space.later }, 1e-12, 0.0);
                for c in 0..C {
                    over += normal[c] * (place[c] - camera[c]);
                    variance += (normal[c] * deviation[c]).powi(2);
                    along += normal[c] * place[c];
                }
                let (slope, curve) = plan::excess(over, variance.sqrt());
                if curve == 0.0 {
                    continue;
                }
                for p in 0..C {
                    vector[i * C + p] += weight * normal[p] * (curve * along - slope);
                    for q in 0..=p {
                        matrix[i * C + p][p - q] += weight * normal[p] * normal[q] * curve;
                    }
                }
            }
        }
        plan::solve(&mut matrix, &mut vector);
        let mut change = 0.0f64;
        for (place, better) in places.as_flattened_mut().iter_mut().zip(&vector) {
            change = change.max((*place - better).abs());
            *place = *better;
        }
        change
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_solution_solves_the_equations() {
        let mut matrix = [[0.0; WIDTH]; UNKNOWNS];
        for (i, row) in matrix.iter_mut().enumerate() {
            for (d, entry) in row.iter_mut().enumerate().take(i + 1) {
                *entry = if d == 0 { 8.0 } else { ((i * 7 + d * 3) % 11) as f64 / 11.0 - 0.5 };
            }
        }
        let truth: [f64; UNKNOWNS] = std::array::from_fn(|i| (i as f64).sin());
        let mut x = [0.0; UNKNOWNS];
        for i in 0..UNKNOWNS {
            for d in 0..WIDTH.min(i + 1) {
                x[i] += matrix[i][d] * truth[i - d];
                if d > 0 {
                    x[i - d] += matrix[i][d] * truth[i];
                }
            }
        }
        plan::solve(&mut matrix, &mut x);
        for (a, b) in x.iter().zip(truth) {
            assert!((a - b).abs() < 1e-12, "{a} {b}");
        }
    }
}
