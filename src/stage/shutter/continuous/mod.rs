//! Continuous time: the camera has one path, and every row of every frame sees its own moment of it.
//!
//! Row y of a frame taken at t is exposed at `t + readout y / H` (H rows; a negative readout reads from bottom to top). A point
//! seen at x_a in one frame and at x_b in the next measures the path P = (yaw, pitch, roll, log zoom) between both moments,
//!
//! ```text
//! x_b - x_a = B(x_mid) (P(t_b + readout y_b / H) - P(t_a + readout y_a / H))
//! ```
//!
//! with B the derivative of a pixel by the pose ([`Pinhole::derivative`]); what a camera that travels adds to that is an unknown of its own
//! ([`flow`]). P is a cubic spline with about four control points to a
//! frame, so this is linear in the unknowns. Minimised is the sum of the robust misfits (Geman-McClure, pixels) and of the prior
//! (white acceleration) by an information filter ([`filter`]). There is no latency: the newest pair measures the path up to the
//! newest frame's last row, and its beginning is known from the pairs before.
//!
//! A frame's reference time is that of its middle row.

mod agreement;
mod batch;
mod constants;
mod filter;
mod flow;
mod globals;
mod hypothesis;
mod normal;
mod slope;

use super::{Motion, Optics, Pair, RowSpan};
use crate::geometry::{Calibration, Homography, OutputMap, Pinhole, Pose, RowMotion, RowPoses, hypot};
use agreement::{Agreement, Compared};
use batch::{Batch, Said};
pub use constants::{HFOV_LIMITS_DEG, LENS_LIMIT, LONGEST_READOUT};
use constants::{LOOK_LEAST_PX, USUAL_HFOV_DEG};
use filter::{Filter, MAX_POINTS, MotionPrior};
use flow::Row;
use globals::{Globals, Unevenness};
use hypothesis::Sight;
use normal::G;
use slope::ReadoutSearch;

/// Control points to a frame interval.
const POINTS_PER_FRAME: f64 = 4.0;
/// Control points are no closer (seconds): hands and desks do not shake above some 30 Hz.
const MIN_SPACING_S: f64 = 0.007;
/// Before anything is measured. Cameras turn but hardly zoom: what magnifies is mostly travel, which is the flow's.
const PRIOR: MotionPrior =
    MotionPrior { acceleration: [7.5, 7.5, 4.5, 0.03], jerk: [150.0, 150.0, 90.0, 0.54], speed: [1.5, 1.5, 1.0, 0.006] };
/// Part of a known interval that it may be off by, at most: a stamp that is later by several frames is a late stamp.
const MAX_OFF: f64 = 0.35;
/// Rounds of weighing, at most and at least; one that changes less than this part of the weights is the last.
const ROUNDS: usize = 4;
const MIN_ROUNDS: usize = 2;
const SETTLED: f64 = 0.02;
/// Least scale of the robust weights, pixels.
const MIN_SCALE_PX: f64 = 0.5;
/// A track of less weight is left out.
const MIN_WEIGHT: f64 = 1e-3;
/// A track's place is off by more than its own difference and texture say, as all are alike: by blur and by what is no rotation.
/// Standard deviation of that (pixels), at least and at most; how fast what is found of it is believed.
const COMMON_SIGMA_PX: [f64; 2] = [0.03, 0.5];
const COMMON_NEWS: f64 = 0.1;
/// A track's own standard deviation is never taken for more, pixels.
const MAX_SIGMA_PX: f64 = 2.0;
/// Say of a track that never agreed with the camera, against 1 of one that always did.
const MIN_FOREGROUND_WEIGHT: f64 = 0.05;
/// Standard deviations of the motion between two frames up to which it is believed, and from which not at all (pixels).
const DOUBTFUL_PX: [f64; 2] = [0.5, 2.0];
/// Part of the motion from one frame to the next that is expected to go on while nothing is seen.
const KEPT_MOTION: f64 = 0.5;
/// Inliers up to which a motion is not believed at all, and from which wholly.
const MIN_INLIERS: [f64; 2] = [6.0, 30.0];
/// The same after frames of which nothing was believed, as a part of the usual number; seconds for which more are asked.
const WARY_SHARES: [f64; 2] = [0.1, 0.3];
const WARY_S: f64 = 0.3;
/// How fast the usual number of inliers is followed, frame by frame.
const USUAL_NEWS: f64 = 0.05;
/// Tracks below which nothing is estimated.
const MIN_TRACKS: usize = 10;
/// Tracks looked at, at most.
const MAX_TRACKS: usize = 4096;

/// The model's state.
#[derive(Debug)]
pub struct Continuous {
    optics: Optics,
    /// What is believed of the camera at the moment.
    calibration: Calibration,
    size: [usize; 2],
    camera: Pinhole,
    filter: Filter,
    /// Time of the newest frame's first row since the stream began, seconds.
    now_s: f64,
    interval_s: f64,
    /// Whether the interval is known, and then the part of it by which the stamps say otherwise.
    timed: Option<f64>,
    sights: Vec<Sight>,
    batch: Batch,
    /// Information of each track's place, 1 / pixels^2.
    information: Vec<f64>,
    weights: Vec<f64>,
    scale_px: f64,
    /// Variance that all tracks have in common, pixels^2.
    common: f64,
    random: u64,
    /// Whether readout time, focal length and k1 are to be found.
    unknown: [bool; G],
    /// How each track depends on focal length and k1 ([`Pinhole::effects`]).
    effects: Vec<[[Pose; 2]; 2]>,
    globals: Globals,
    unevenness: Unevenness,
    agreement: Agreement,
    readout_search: ReadoutSearch,
    /// The readout time that the rows are drawn by, seconds: it glides to what is believed.
    drawn_s: f64,
    /// How the path's mean over [`constants::ANCHOR_S`] depends on the globals.
    anchor: [Pose; G],
    /// Pairs seen since the stream began.
    pairs: u32,
    /// How recently nothing was believed, 1 (the frame before) to 0.
    wary: f64,
    /// The usual number of inliers.
    usual: f64,
    /// Whether the path is to restart: its rows were timed by a readout that was far off.
    restarting: bool,
    newest: Motion,
}

impl Continuous {
    /// A model that has seen nothing, for a camera of which `optics` is known.
    pub fn new(optics: Optics, seed: u64) -> Self {
        Self {
            optics,
            calibration: Calibration::default(),
            size: [1, 1],
            camera: Pinhole::default(),
            filter: Filter::new(1.0 / 120.0, PRIOR),
            now_s: 0.0,
            interval_s: 0.0,
            timed: None,
            sights: Vec::with_capacity(MAX_TRACKS),
            batch: Batch::new(MAX_TRACKS),
            information: Vec::with_capacity(MAX_TRACKS),
            weights: Vec::with_capacity(MAX_TRACKS),
            scale_px: MIN_SCALE_PX,
            common: COMMON_SIGMA_PX[0].powi(2),
            random: seed,
            unknown: [false; G],
            effects: Vec::with_capacity(MAX_TRACKS),
            globals: Globals::default(),
            unevenness: Unevenness::default(),
            agreement: Agreement::default(),
            readout_search: ReadoutSearch::default(),
            drawn_s: 0.0,
            anchor: [[0.0; 4]; G],
            pairs: 0,
            wary: 0.0,
            usual: 0.0,
            restarting: false,
            newest: Motion {
                rows: RowMotion::default(),
                motion: [0.0; 4],
                path: [0.0; 4],
                ends: RowSpan::default(),
                confidence: 1.0,
                rows_part: 1.0,
            },
        }
    }

    /// As [`super::Shutter::begin`].
    pub fn begin(&mut self, size: [usize; 2]) {
        self.size = size;
        let (hfov_deg, _) = self.optics.hfov_deg.or(USUAL_HFOV_DEG, 0.0);
        self.camera = Pinhole::new(size, hfov_deg);
        self.calibration = Calibration::default();
        self.now_s = 0.0;
        self.interval_s = 0.0;
        self.scale_px = MIN_SCALE_PX;
        self.common = COMMON_SIGMA_PX[0].powi(2);
        self.unevenness = Unevenness::default();
        self.agreement = Agreement::default();
        self.readout_search = ReadoutSearch::default();
        self.drawn_s = 0.0;
        self.anchor = [[0.0; 4]; G];
        self.restarting = false;
        (self.wary, self.usual, self.pairs) = (0.0, 0.0, 0);
        self.newest = Motion {
            rows: self.rows(|_| [0.0; 4]),
            motion: [0.0; 4],
            path: [0.0; 4],
            ends: RowSpan::default(),
            confidence: 1.0,
            rows_part: 1.0,
        };
    }

    /// As [`super::Shutter::newest`].
    pub fn newest(&self) -> Motion {
        self.newest
    }

    /// Seconds from a frame's time to the exposure of row `y`; never negative.
    fn delay(&self, y: f64) -> f64 {
        let y = y.clamp(0.0, self.size[1] as f64);
        self.calibration.readout_s * y / self.size[1] as f64 + (-self.calibration.readout_s).max(0.0)
    }

    /// Seconds from a frame's time to that of its middle row.
    fn middle(&self) -> f64 {
        0.5 * self.calibration.readout_s.abs()
    }

    fn rows(&self, pose: impl Fn(f64) -> Pose) -> RowMotion {
        let spacing = (self.size[1] as f64 - 1.0).max(1.0) / (RowPoses::SAMPLES - 1) as f64;
        let samples = std::array::from_fn(|i| pose(i as f64 * spacing));
        RowMotion::Poses { camera: self.camera, rows: RowPoses { samples, spacing } }
    }

    /// Gives the path control points for a pair that began at `before_s`, as far as its rows are to be drawn; restarts the path where the
    /// interval changed or the rows were timed by a readout that was far off. Gives the time of the newest frame's last row.
    fn extend(&mut self, before_s: f64, pair: &Pair<'_>) -> f64 {
        let wanted = (pair.interval_s / POINTS_PER_FRAME).max(MIN_SPACING_S);
        let changed = self.interval_s == 0.0 || !(0.6..1.6).contains(&(wanted / self.filter.spacing_s()));
        let restarting = std::mem::take(&mut self.restarting);
        let restarted = restarting || changed && (self.interval_s == 0.0 || pair.interval_s > 0.0);
        if self.interval_s == 0.0 {
            self.expect(pair.interval_s);
        }
        self.interval_s = pair.interval_s;
        self.timed = pair.is_certain.then_some(pair.off_s / pair.interval_s);
        let longest_s = self.calibration.readout_s.abs().max(self.drawn_s.abs());
        let drawn_to_s = self.now_s + self.middle() + 0.5 * longest_s;
        if restarted || !self.filter.extend_to(drawn_to_s) {
            let spacing = wanted.max((pair.interval_s + 2.0 * longest_s) / (MAX_POINTS - 8) as f64);
            self.filter.restart(before_s, self.newest.path, spacing);
            if restarting {
                self.filter.forget_globals();
            }
            self.filter.extend_to(drawn_to_s);
            self.filter.pin(before_s + self.middle(), self.newest.path);
        }
        self.now_s + self.calibration.readout_s.abs()
    }

    /// Takes in what a pair of frames showed.
    pub fn observe(&mut self, pair: Pair<'_>) {
        let before_s = self.now_s;
        self.now_s += pair.interval_s;
        self.pairs = self.pairs.wrapping_add(1);
        let last_s = self.extend(before_s, &pair);
        self.filter.drift(pair.interval_s);
        let confidence = self.estimate(pair.tracks, before_s);
        if confidence == 0.0 {
            // what is not believed must not move the path, and the motion before is no forecast: it comes to rest
            let rest: Pose = std::array::from_fn(|c| self.newest.path[c] + KEPT_MOTION * self.newest.motion[c]);
            self.filter.pin(self.now_s + self.middle(), rest);
            self.filter.start_trial();
            self.filter.solve();
            self.readout_search.interrupt();
            self.wary = 1.0;
        } else {
            self.wary *= (-pair.interval_s / WARY_S).exp();
            self.collect_tracks(pair.tracks, before_s);
            self.filter.learn_prior(pair.interval_s);
            self.filter.learn_flow(pair.interval_s);
        }
        let reference_s = self.now_s + self.middle();
        let path = self.filter.pose(reference_s);
        let by_row_s = self.drawn_s / self.size[1] as f64;
        let middle_row = 0.5 * self.size[1] as f64;
        let rows = self.rows(|y| subtract(self.filter.pose(reference_s + by_row_s * (y - middle_row)), path));
        let ends = RowSpan {
            first: self.filter.pose(self.now_s),
            last: self.filter.pose(last_s),
            last_before: self.filter.pose(last_s - pair.interval_s),
            half_s: self.middle(),
            interval_s: pair.interval_s,
        };
        let motion = subtract(path, self.newest.path);
        let rows_part = self.agreement.part();
        self.newest = Motion { rows, motion, path, ends, confidence, rows_part };
        self.follow_anchor(reference_s, pair.interval_s);
        self.filter.accept(self.now_s);
        self.follow_camera();
        self.glide();
    }

    /// Asks the pictures whether the rows moved as the path says.
    fn collect_tracks(&mut self, tracks: &[crate::frame::Track], before_s: f64) {
        let Self { filter, camera, agreement, .. } = self;
        let middle = 0.5 * self.calibration.readout_s.abs();
        let whole = subtract(filter.pose(self.now_s + middle), filter.pose(before_s + middle));
        let half_width = 0.5 * self.size[0] as f64;
        let scale = 2.0 * self.scale_px;
        let compared = self.batch.said().map(|(i, Said { change, .. })| {
            let (track, sight) = (&tracks[i], &self.sights[i]);
            let flow = filter.flow_at(self.batch.flow_row(i));
            let by_rows = sight.derivative.map(|row| dot(&row, &subtract(subtract(change, flow), whole)));
            // whoever agrees with the model or with one without rows has a word: the model's own friends would say yes to it
            let moved: [f64; 2] = std::array::from_fn(|i| sight.moved[i] - dot(&sight.derivative[i], &flow));
            let rest: [f64; 2] = std::array::from_fn(|i| moved[i] - dot(&sight.derivative[i], &whole));
            let weight = self.weights[i].max(geman_mcclure(rest[0] * rest[0] + rest[1] * rest[1], scale * scale));
            let place = std::array::from_fn(|i| (0.5 * (track.from[i] + track.to[i]) - camera.centre[i]) / half_width);
            Compared { place, moved, by_rows, weight: weight * sight.say.min(2.0) }
        });
        agreement.take(compared, self.interval_s);
    }

    /// The rows that flow least, of those where the picture agrees with the first idea of the turn, hold the path.
    fn hold_flow(&mut self) {
        let mut present = [0.0; flow::BINS];
        for (sight, weight) in self.sights.iter().zip(&self.weights) {
            let Row { bin, weights } = Row::new(sight.row + 0.5, 1.0);
            for (i, share) in weights.into_iter().enumerate() {
                present[bin + i] += share * weight * sight.say.min(2.0);
            }
        }
        self.filter.hold_flow(&present, self.interval_s);
    }

    /// What is believed of the camera.
    pub fn calibration(&self) -> Calibration {
        self.calibration
    }

    /// Weighs the tracks and solves for the path. Gives the confidence. What a pair whose time is not known says of the camera is not
    /// asked.
    fn estimate(&mut self, tracks: &mut [crate::frame::Track], before_s: f64) -> f64 {
        let count = tracks.len().min(MAX_TRACKS);
        let tracks = &mut tracks[..count];
        self.filter.start_trial();
        if tracks.len() < MIN_TRACKS {
            self.filter.solve();
            return 0.0;
        }
        self.sights.clear();
        self.batch.clear();
        self.information.clear();
        for track in tracks.iter() {
            let middle = [0.5 * (track.from[0] + track.to[0]), 0.5 * (track.from[1] + track.to[1])];
            let moved = [track.to[0] - track.from[0], track.to[1] - track.from[1]];
            let derivative = self.camera.derivative(middle);
            let (sooner, later) = (before_s + self.delay(track.from[1]), self.now_s + self.delay(track.to[1]));
            let row = middle[1] / self.size[1] as f64 - 0.5;
            let flow = Row::new(row + 0.5, self.interval_s);
            self.batch.push(&self.filter, [self.filter.place(sooner), self.filter.place(later)], flow);
            let flowed = self.filter.flow_at(&flow);
            let moved = [moved[0] - dot(&derivative[0], &flowed), moved[1] - dot(&derivative[1], &flowed)];
            self.sights.push(Sight { moved, derivative, row, say: 1.0 });
            let sigma = f64::from(track.sigma_px).min(MAX_SIGMA_PX);
            self.information.push(1.0 / (sigma * sigma + self.common));
        }
        self.batch.prepare(|i| {
            let moved = std::array::from_fn(|c| tracks[i].to[c] - tracks[i].from[c]);
            (self.sights[i].derivative, moved)
        });
        hypothesis::distribute_weights(
            tracks,
            self.size,
            |i| MIN_FOREGROUND_WEIGHT + (1.0 - MIN_FOREGROUND_WEIGHT) * f64::from(tracks[i].background),
            &mut self.sights,
        );
        let middle = self.middle();
        let predicted = subtract(self.filter.pose(self.now_s + middle), self.filter.pose(before_s + middle));
        let random = &mut self.random;
        let (turn, limit) = hypothesis::best(&self.sights, predicted, |below| {
            *random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            ((u128::from(*random) * below as u128) >> 64) as usize
        });
        let least = LOOK_LEAST_PX / self.camera.focal;
        match self.timed.is_some() {
            true => {
                // the flow, too, may hold what is the rows'
                let [yaw, pitch] = self.filter.flow_slope().map(|slope| slope * self.interval_s);
                let slope = [turn[1] + yaw, turn[4] + pitch, 0.0, 0.0];
                self.readout_search.take([turn[0], turn[3], turn[6], turn[7]], slope, self.interval_s, least);
            }
            false => self.readout_search.interrupt(),
        }
        self.weights.clear();
        self.weights.extend(self.sights.iter().map(|sight| geman_mcclure(sight.misfit(&turn), limit)));
        // a picture that hardly moves says nothing of the camera, but its noise would; nor does one whose speed is not known
        let moved_px = self.camera.focal * hypot(turn[0], turn[3]).max(hypot(turn[1], turn[4]));
        for (sight, track) in self.sights.iter_mut().zip(tracks.iter()) {
            sight.moved = std::array::from_fn(|c| track.to[c] - track.from[c]);
        }
        let asked = self.unknown != [false; G] && self.timed.is_some() && self.is_asked();
        let share = if asked { ((moved_px - 0.3) / 0.7).clamp(0.0, 1.0) } else { 0.0 };
        if share > 0.0 {
            self.effects.clear();
            let middle = |track: &crate::frame::Track| std::array::from_fn(|c| 0.5 * (track.from[c] + track.to[c]));
            let of = |(track, sight): (&crate::frame::Track, &Sight)| {
                self.camera.effects(middle(track), &sight.derivative, self.size[0])
            };
            self.effects.extend(tracks.iter().zip(&self.sights).map(of));
        }
        self.unevenness.take(share, self.timed.unwrap_or(0.0).abs().min(MAX_OFF));
        for (information, sight) in self.information.iter_mut().zip(&self.sights) {
            *information *= sight.say.min(2.0);
        }
        self.hold_flow();
        let (mut squares, mut common, mut certain) = (0.0, 0.0, 0.0);
        for round in 0..ROUNDS {
            self.filter.start_trial();
            if share > 0.0 && round > 0 {
                self.ask_globals(tracks, share);
            }
            let (weights, information) = (&self.weights, &self.information);
            self.batch.add_to(&mut self.filter, |i| if weights[i] > MIN_WEIGHT { information[i] * weights[i] } else { 0.0 });
            if !self.filter.solve() {
                return 0.0;
            }
            self.filter.ease_prior();
            self.batch.evaluate(&self.filter);
            let scale = self.scale_px;
            let (mut sum, mut changed) = (0.0, 0.0);
            (squares, common, certain) = (0.0, 0.0, 0.0);
            for (i, said) in self.batch.said() {
                let misfit = self.sights[i].misfit_of(&said.change);
                let weight = geman_mcclure(misfit, scale * scale);
                squares += weight * misfit;
                sum += weight;
                // of x and y together; the surest tracks tell most
                let (surety, own) = (weight * self.information[i], f64::from(tracks[i].sigma_px).min(MAX_SIGMA_PX));
                common += surety * (0.5 * misfit - own * own);
                certain += surety;
                changed += (weight - self.weights[i]).abs();
                self.weights[i] = weight;
            }
            if round + 1 >= MIN_ROUNDS && changed < SETTLED * sum {
                break;
            }
        }
        let (mut agreed, mut say, mut sum) = (0.0, 0.0, 0.0);
        for ((track, sight), weight) in tracks.iter_mut().zip(&self.sights).zip(&self.weights) {
            track.weight = *weight as f32;
            agreed += sight.say * weight;
            say += sight.say;
            sum += weight;
        }
        let [least, most] = COMMON_SIGMA_PX.map(|sigma| sigma * sigma);
        self.common += COMMON_NEWS * ((common / certain.max(1e-9)).clamp(least, most) - self.common);
        // the scale follows what the inliers leave over, slowly
        let noise = (squares / sum.max(1.0)).sqrt();
        self.scale_px += 0.1 * ((3.0 * noise).clamp(MIN_SCALE_PX, 2.0) - self.scale_px);
        let share = agreed / say.max(1e-9);
        let ramp = |x: f64, from: f64, to: f64| ((x - from) / (to - from)).clamp(0.0, 1.0);
        // what the covariance says of the motion to this frame's middle row; a few dark or blurred points leave it wide
        let deviation = self.filter.deviation(before_s + self.middle(), self.now_s + self.middle());
        let deviation_px = self.camera.focal * hypot(deviation[0], deviation[1]);
        // a few points that agree, right after a time in which nothing was seen, agree on anything
        let asked = [0, 1].map(|i| MIN_INLIERS[i].max(WARY_SHARES[i] * self.wary * self.usual));
        self.usual += USUAL_NEWS * (sum - self.usual);
        ramp(sum, asked[0], asked[1]) * ramp(share, 0.15, 0.4) * ramp(deviation_px, DOUBTFUL_PX[1], DOUBTFUL_PX[0])
    }
}

/// Geman and McClure's weight of a squared residual: 1 at 0, a quarter at the scale, then falling fast.
#[inline]
fn geman_mcclure(square: f64, scale_square: f64) -> f64 {
    let ratio = 1.0 + square / scale_square;
    1.0 / (ratio * ratio)
}

fn dot(row: &Pose, pose: &Pose) -> f64 {
    row[0] * pose[0] + row[1] * pose[1] + row[2] * pose[2] + row[3] * pose[3]
}

fn subtract(a: Pose, b: Pose) -> Pose {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2], a[3] - b[3]]
}

/// Output pixel -> virtual camera at `smoothed` -> camera at the frame's reference time -> the row that saw it.
pub fn map(motion: &Motion, smoothed: Pose, strength: f64, view: &Homography) -> OutputMap {
    let RowMotion::Poses { camera, rows } = motion.rows else { return OutputMap::Projective(*view) };
    let turn = camera.turned(subtract(motion.path, smoothed));
    let (window, view) = match camera.bend == 0.0 {
        true => (Homography::IDENTITY, Homography(turn.0 * view.0).scaled()),
        false => (*view, turn),
    };
    OutputMap::Rows { window, view, camera, rows: rows.part(strength) }
}

#[cfg(test)]
mod tests;
