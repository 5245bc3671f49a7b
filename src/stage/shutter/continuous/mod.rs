//! Continuous time: the camera has one path, and every row of every frame sees its own moment of it.
//!
//! Row y of a frame taken at t is exposed at `t + readout y / H` (H rows; a negative readout reads from bottom to top). A point
//! seen at x_a in one frame and at x_b in the next measures the path P = (yaw, pitch, roll, log zoom) between both moments,
//!
//! ```text
//! x_b - x_a = B(x_mid) (P(t_b + readout y_b / H) - P(t_a + readout y_a / H))
//! ```
//!
//! with B the derivative of a pixel by the pose ([`crate::geometry::Pinhole::derivative`]); what a camera that travels adds to that is an unknown of its own
//! ([`flow`]). P is a cubic spline with about four control points to a
//! frame, so this is linear in the unknowns. Minimised is the sum of the robust misfits (Geman-McClure, pixels) and of the prior
//! (white acceleration) by an information filter ([`filter`]). There is no latency: the newest pair measures the path up to the
//! newest frame's last row, and its beginning is known from the pairs before.
//!
//! A frame's reference time is that of its middle row.
//!
//! For each pair of frames, in this order: [`observations`] makes measurements of the tracks, [`consensus`] finds the background's turn
//! roughly, [`reweight`] solves for the path, [`gate`] says how far to believe it, [`row_agreement`] asks the pictures whether the rows
//! moved as the path says, and [`calibration`] learns readout time, field of view and lens.
//!
//! Numbers whose origin is not named were chosen by trial, on rendered clips of hands, walks, desks, vehicles and darkness and on recordings
//! of phones.

mod batch;
mod calibration;
mod consensus;
mod evidence;
mod filter;
mod flow;
mod gate;
mod normal;
mod observations;
mod persistence;
mod readout_search;
mod reweight;
mod row_agreement;

use super::{Motion, Optics, Pair, RowSpan};
use crate::frame::{PathParameters, Track};
use crate::geometry::{Calibration, Homography, OutputMap, Pose, RowMotion, RowPoses, View, hypot};
use crate::kernel::Level;
use crate::random::Congruential;
use calibration::Calibrator;
pub(crate) use calibration::{HFOV_LIMITS_DEG, LENS_LIMIT, LONGEST_READOUT};
use consensus::Turn;
use filter::{Filter, MAX_POINTS, MotionPrior};
use gate::{Gate, Support};
use observations::{MAX_TRACKS, Observations};
use persistence::Persistence;
use reweight::Reweighting;
use row_agreement::RowAgreement;

/// Control points to a frame interval: the path bends within a frame.
const POINTS_PER_FRAME: f64 = 4.0;
/// Control points are no closer (seconds): hands and desks do not shake above some 30 Hz.
const MIN_SPACING_S: f64 = 0.007;
/// Spacing that is wanted, in spacings that there are, within which the path goes on: a camera that halves its rate in low light restarts
/// it, one that jitters does not.
const SPACING_WILL_DO: std::ops::Range<f64> = 0.6..1.6;
/// Control points that are left for what a pair of frames does not reach.
const SPARE_POINTS: usize = 8;
/// Before anything is measured: what a hand does, see [`MotionPrior`]; the filter learns by how much this camera does more or less. Cameras
/// turn but hardly zoom: what magnifies is mostly travel, which is the flow's.
const PRIOR: MotionPrior =
    MotionPrior { acceleration: [7.5, 7.5, 4.5, 0.03], jerk: [150.0, 150.0, 90.0, 0.54], speed: [1.5, 1.5, 1.0, 0.006] };
/// Spacing of the control points before the first pair, seconds; the first pair sets it.
const FIRST_SPACING_S: f64 = 1.0 / 120.0;
/// Tracks below which nothing is estimated: a motion within the frame has eight unknowns ([`consensus`]), and two tracks more can contradict.
const MIN_TRACKS: usize = 10;
/// Scale at which a track agrees with a model without motion of the rows, in scales of the robust weights.
const WITHOUT_ROWS: f64 = 2.0;

/// When the two frames of a pair were taken: seconds since the stream began, each that of the row that is read first.
#[derive(Clone, Copy, Debug, Default)]
struct Times {
    before_s: f64,
    now_s: f64,
    interval_s: f64,
    /// The part of the interval by which the stamps say otherwise; `None` where the interval is no more than a guess.
    error: Option<f64>,
}

/// The model's state.
#[derive(Debug)]
pub struct Continuous {
    calibrator: Calibrator,
    filter: Filter,
    /// Of the last pair; the default before the first.
    times: Times,
    observations: Observations,
    reweighting: Reweighting,
    gate: Gate,
    agreement: RowAgreement,
    persistence: Persistence,
    random: Congruential,
    newest: Motion,
}

impl Continuous {
    /// A model that has seen nothing, for a camera of which `optics` is known.
    pub fn new(optics: Optics, seed: u64, level: Level) -> Self {
        Self {
            calibrator: Calibrator::new(optics, MAX_TRACKS),
            filter: Filter::new(FIRST_SPACING_S, PRIOR, level),
            times: Times::default(),
            observations: Observations::new(level),
            reweighting: Reweighting::new(),
            gate: Gate::default(),
            agreement: RowAgreement::default(),
            persistence: Persistence::default(),
            random: Congruential::new(seed),
            newest: at_rest(RowMotion::default()),
        }
    }

    /// As [`super::Shutter::begin`].
    pub fn begin(&mut self, size: [usize; 2]) {
        self.calibrator.begin(size);
        self.times = Times::default();
        self.reweighting.begin();
        (self.gate, self.agreement) = (Gate::default(), RowAgreement::default());
        self.persistence = Persistence::default();
        self.newest = at_rest(self.rows(|_| Pose::default()));
    }

    /// As [`super::Shutter::newest`].
    pub fn newest(&self) -> Motion {
        self.newest
    }

    /// What is believed of the camera; `None` before the first pair.
    pub fn calibration(&self) -> Option<Calibration> {
        (self.times.interval_s > 0.0).then(|| self.calibrator.calibration())
    }

    /// Takes in what a pair of frames showed.
    pub fn observe(&mut self, pair: Pair<'_>) {
        let is_first = self.times.interval_s == 0.0;
        let before_s = self.times.now_s;
        self.times = Times {
            before_s,
            now_s: before_s + pair.interval_s,
            interval_s: pair.interval_s,
            error: pair.is_certain.then_some(pair.off_s / pair.interval_s),
        };
        self.calibrator.count_pair();
        self.extend(is_first);
        // the newest frame's last row, by the readout time that its tracks are measured with
        let last_s = self.times.now_s + self.calibrator.reading_s();
        self.filter.drift(pair.interval_s);
        let count = pair.tracks.len().min(MAX_TRACKS);
        let confidence = self.estimate(&mut pair.tracks[..count]);
        if confidence > 0.0 {
            self.gate.passed(pair.interval_s);
            self.compare_rows();
            self.filter.learn_prior(pair.interval_s);
            self.filter.learn_flow(pair.interval_s);
        } else {
            self.rest();
        }
        self.newest = self.motion(last_s, confidence);
        if confidence > 0.0 {
            self.persistence.learn(pose_of(self.newest.motion), pair.interval_s);
        }
        let reference_s = self.reference_s();
        self.calibrator.follow_anchor(reference_s, pair.interval_s, &self.filter);
        self.filter.accept(self.times.now_s);
        self.calibrator.follow(&self.times, &mut self.filter);
    }

    /// The newest frame's reference time.
    fn reference_s(&self) -> f64 {
        self.times.now_s + self.calibrator.middle_s()
    }

    /// Gives the path control points for the pair, as far as its rows are to be drawn; restarts the path where the interval changed or the
    /// rows were timed by a readout that was far off.
    fn extend(&mut self, is_first: bool) {
        let Times { before_s, now_s, interval_s, .. } = self.times;
        let wanted_s = (interval_s / POINTS_PER_FRAME).max(MIN_SPACING_S);
        let is_other_rate = interval_s > 0.0 && !SPACING_WILL_DO.contains(&(wanted_s / self.filter.spacing_s()));
        let is_stale = self.calibrator.take_path_is_stale();
        if is_first {
            self.calibrator.expect(interval_s, &mut self.filter);
        }
        let (middle_s, longest_s) = (self.calibrator.middle_s(), self.calibrator.longest_s());
        let drawn_to_s = now_s + middle_s + 0.5 * longest_s;
        if is_first || is_other_rate || is_stale || !self.filter.extend_to(drawn_to_s) {
            let spacing_s = wanted_s.max((interval_s + 2.0 * longest_s) / (MAX_POINTS - SPARE_POINTS) as f64);
            self.filter.restart(before_s, pose_of(self.newest.path), spacing_s);
            if is_stale {
                self.filter.forget_calibration();
            }
            self.filter.extend_to(drawn_to_s);
            self.filter.pin(before_s + middle_s, pose_of(self.newest.path));
        }
    }

    /// Solves for the path. Gives the confidence in it; 0 where it is unknown.
    fn estimate(&mut self, tracks: &mut [Track]) -> f64 {
        self.filter.start_trial();
        if tracks.len() < MIN_TRACKS {
            self.filter.solve();
            return 0.0;
        }
        let common = self.reweighting.common();
        self.observations.gather(tracks, &self.times, &self.calibrator, &self.filter, common);
        let turn = self.consensus();
        self.reweighting.start(&self.observations, &turn);
        let focal = self.calibrator.camera.focal;
        let moved_px = focal * hypot(turn[0], turn[3]).max(hypot(turn[1], turn[4]));
        let share = self.calibrator.ask(moved_px, &self.times, &self.observations);
        self.observations.apply_prior_weights();
        // the rows that flow least, of those where the picture agrees with the turn, hold the path
        self.filter.hold_flow(&self.observations.presence(&self.reweighting.weights), self.times.interval_s);
        let solved = self.reweighting.solve(&mut self.observations, &mut self.filter, &self.calibrator, share);
        let Some(residuals) = solved else { return 0.0 };
        self.reweighting.learn(&residuals);
        for (track, weight) in tracks.iter_mut().zip(&self.reweighting.weights) {
            track.weight = *weight as f32;
        }
        let middle_s = self.calibrator.middle_s();
        let sigma = self.filter.deviation(self.times.before_s + middle_s, self.times.now_s + middle_s);
        let share = self.observations.agreeing_share(&self.reweighting.weights);
        self.gate.confidence(&Support { inliers: residuals.inliers, share, sigma_px: focal * hypot(sigma[0], sigma[1]) })
    }

    /// The background's turn, roughly; what it says of the readout time is taken in.
    fn consensus(&mut self) -> Turn {
        let Times { before_s, now_s, interval_s, .. } = self.times;
        let middle_s = self.calibrator.middle_s();
        let predicted = self.filter.pose(now_s + middle_s) - self.filter.pose(before_s + middle_s);
        let turn = consensus::best(&self.observations.sights, predicted, |below| self.random.below(below));
        // the flow, too, may hold what is the rows'
        let [yaw, pitch] = self.filter.flow_slope().map(|slope| slope * interval_s);
        self.calibrator.search([turn[0], turn[3]], [turn[1] + yaw, turn[4] + pitch], &self.times);
        turn
    }

    /// Asks the pictures whether the rows moved as the path says.
    fn compare_rows(&mut self) {
        let Times { before_s, now_s, interval_s, .. } = self.times;
        let middle_s = self.calibrator.middle_s();
        let whole = self.filter.pose(now_s + middle_s) - self.filter.pose(before_s + middle_s);
        let scale_px = WITHOUT_ROWS * self.reweighting.scale_px();
        let Self { observations, reweighting, filter, calibrator, agreement, .. } = self;
        let compared = observations.compared(&reweighting.weights, filter, calibrator, whole, scale_px);
        agreement.add(compared, interval_s);
    }

    /// The motion is unknown. What is not believed must not move the path: it goes on as this camera's does, and comes to rest.
    fn rest(&mut self) {
        let Motion { path, motion, .. } = self.newest;
        let expected = self.persistence.next(pose_of(motion));
        self.persistence.skip();
        self.filter.pin(self.reference_s(), pose_of(path) + expected);
        self.filter.start_trial();
        self.filter.solve();
        self.calibrator.skip();
        self.gate.failed();
    }

    /// The newest frame's motion, whose last row is read at `last_s`, by the path as it was solved for.
    fn motion(&self, last_s: f64, confidence: f64) -> Motion {
        let Times { now_s, interval_s, .. } = self.times;
        let reference_s = self.reference_s();
        let path = self.filter.pose(reference_s);
        let height = self.calibrator.size[1] as f64;
        let (by_row_s, middle_row) = (self.calibrator.drawn_s / height, 0.5 * height);
        let path_at = |time_s: f64| PathParameters(self.filter.pose(time_s).0);
        let ends = RowSpan {
            first: path_at(now_s),
            last: path_at(last_s),
            last_before: path_at(last_s - interval_s),
            half_s: self.calibrator.middle_s(),
            interval_s,
        };
        Motion {
            rows: self.rows(|y| self.filter.pose(reference_s + by_row_s * (y - middle_row)) - path),
            motion: PathParameters((path - pose_of(self.newest.path)).0),
            path: PathParameters(path.0),
            ends,
            confidence,
            agreement: self.agreement.part(),
        }
    }

    /// The rows' poses, less that of the reference time.
    fn rows(&self, pose: impl Fn(f64) -> Pose) -> RowMotion {
        let spacing = (self.calibrator.size[1] as f64 - 1.0).max(1.0) / (RowPoses::SAMPLES - 1) as f64;
        let samples = std::array::from_fn(|i| pose(i as f64 * spacing));
        RowMotion::Poses { camera: self.calibrator.camera, rows: RowPoses { samples, spacing } }
    }
}

/// The motion of a camera at rest, of which nothing was measured.
fn at_rest(rows: RowMotion) -> Motion {
    let (motion, path) = (PathParameters::default(), PathParameters::default());
    Motion { rows, motion, path, ends: RowSpan::default(), confidence: 1.0, agreement: 1.0 }
}

/// Geman and McClure's weight of a squared residual: 1 at 0, a quarter at the scale, then falling fast.
#[inline]
fn geman_mcclure(square: f64, scale_square: f64) -> f64 {
    let ratio = 1.0 + square / scale_square;
    1.0 / (ratio * ratio)
}

/// The pose that this model's parameters are.
fn pose_of(path: PathParameters) -> Pose {
    Pose(path.0)
}

/// Output pixel -> virtual camera at `smoothed` -> camera at the frame's reference time -> the row that saw it.
pub fn map(motion: &Motion, smoothed: PathParameters, strength: f64, view: &View) -> OutputMap {
    let RowMotion::Poses { camera, rows } = motion.rows else { return OutputMap::Projective(view.window) };
    let turn = camera.turned(pose_of(motion.path) - pose_of(smoothed));
    let ((window, kept), view) = match camera.bend == 0.0 {
        true => ((Homography::IDENTITY, 0.0), Homography(turn.0 * view.window.0).scaled()),
        false => (view.through(&camera), turn),
    };
    OutputMap::Rows { window, view, camera, kept, rows: rows.part(strength) }
}

#[cfg(test)]
mod tests;
