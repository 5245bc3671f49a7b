//! The calibration (readout time, field of view, the lens's k1): its prior, what the tracks are asked of it, and how the model follows what
//! they say ([`super::evidence`]).

use super::Times;
use super::batch::Prediction;
use super::consensus::Sight;
use super::evidence::{Evidence, IntervalError};
use super::filter::Filter;
use super::flow::Flow;
use super::normal::G;
use super::observations::{Detail, Observations};
use super::readout_search::ReadoutSearch;
use super::reweight::MIN_WEIGHT;
use crate::geometry::{Calibration, Estimate, PerChannel, Pinhole, Pose, hypot};
use crate::stage::shutter::Optics;

/// Readout time that is expected of a camera of which nothing is known, and its standard deviation (frame intervals): most webcams and
/// phones take two thirds of the interval to all of it.
const USUAL_READOUT: f64 = 0.75;
const READOUT_SIGMA: f64 = 0.25;
/// Horizontal field of view that is expected likewise, and its standard deviation (degrees): most webcams have 50 to 80.
const USUAL_HFOV_DEG: f64 = 60.0;
const HFOV_SIGMA_DEG: f64 = 12.0;
/// Standard deviation of a field of view that was given, where the lens is not known: data sheets say what is seen from edge to edge, or
/// what the focal length gives, and often round.
const GIVEN_SIGMA_DEG: f64 = 4.0;
/// Standard deviation of the lens's k1 from 0 that is expected likewise.
const LENS_SIGMA: f64 = 0.1;
/// Furthest that k1 may be from 0, and furthest that it is moved at a time.
pub const LENS_LIMIT: f64 = 0.35;
const LENS_STEP: f64 = 0.02;
/// Longest readout time that is looked for (frame intervals): one that fills the interval is found with its error, and what ends here was
/// not found.
pub const LONGEST_READOUT: f64 = 1.1;
/// Standard deviations within which the search's readout time is believed; what is added to one, and a share of the value (frame
/// intervals). The search is rough: on rendered clips of any shake it gives 1.0 to 1.4 times the truth.
const SEARCH_SIGMAS: f64 = 2.0;
const SEARCH_FLOOR: f64 = 0.03;
const SEARCH_SHARE: f64 = 0.1;
/// Change of the turn from pair to pair that the search asks for, pixels: several times the noise of a turn that 300 tracks measure.
const SEARCH_MIN_PX: f64 = 0.7;
/// Uncertainty from which the search sees little (frame intervals), and the factor on it then.
const SEARCH_BLIND: f64 = 0.4;
const SEARCH_DOUBT: f64 = 1.5;
/// Motion of a pair (pixels) up to which it is not asked of the calibration, and from which it counts wholly: a picture that hardly moves
/// says nothing of the camera, but its noise would.
const ASKED_PX: [f64; 2] = [0.3, 1.0];
/// Seconds for which all pairs are asked of the calibration, and which are later: as much is learned for less.
const ASKED_ALL_S: f64 = 10.0;
const ASKED_EVERY: u32 = 3;
/// Part of a known interval that it may be off by, at most: a stamp that is later by several frames is a late stamp.
const MAX_INTERVAL_ERROR: f64 = 0.35;
/// Furthest that the readout time (frame intervals) and the logarithm of the focal length are moved at a time: what is linear in them is so
/// near where they are.
const READOUT_STEP: f64 = 0.05;
const FOCAL_STEP: f64 = 0.05;
/// Part of its distance to what is believed that the readout time by which the rows are drawn goes at a time: a new belief does not move the
/// picture at once.
const GLIDE: f64 = 0.05;
/// How far off what the search says the readout time must be for it to restart (frame intervals): one standard deviation of the prior.
const RESTART_DISTANCE: f64 = 0.25;
/// Seconds of the path whose mean stays where it is when the calibration changes.
const ANCHOR_S: f64 = 1.0;
/// Fields of view that a camera may have (degrees): an estimate stays between.
pub const HFOV_LIMITS_DEG: [f64; 2] = [45.0, 110.0];
/// Distance from them at which one counts as there.
const EDGE_DEG: f64 = 0.1;

/// What is believed of the camera, and how it is learned.
#[derive(Debug)]
pub struct Calibrator {
    optics: Optics,
    /// Of the pictures (width, height).
    pub size: [usize; 2],
    /// As it is believed to be.
    pub camera: Pinhole,
    calibration: Calibration,
    /// Whether readout time, focal length and k1 are to be found.
    unknown: [bool; G],
    /// How each track depends on focal length and k1 ([`Pinhole::effects`]); of a pair that is asked.
    effects: Vec<[[PerChannel; 2]; 2]>,
    evidence: Evidence,
    interval_error: IntervalError,
    search: ReadoutSearch,
    /// The readout time that the rows are drawn by, seconds: it glides to what is believed.
    pub drawn_s: f64,
    /// How the path's mean over [`ANCHOR_S`] depends on the parameters.
    anchor: [PerChannel; G],
    /// Pairs since the stream began.
    pairs: u32,
    /// Whether the path is to restart: its rows were timed by a readout that was far off.
    path_is_stale: bool,
}

impl Calibrator {
    /// For a camera of which `optics` is known, and `room` tracks at most.
    pub fn new(optics: Optics, room: usize) -> Self {
        Self {
            optics,
            size: [1, 1],
            camera: Pinhole::default(),
            calibration: Calibration::default(),
            unknown: [false; G],
            effects: Vec::with_capacity(room),
            evidence: Evidence::default(),
            interval_error: IntervalError::default(),
            search: ReadoutSearch::default(),
            drawn_s: 0.0,
            anchor: [[0.0; 4]; G],
            pairs: 0,
            path_is_stale: false,
        }
    }

    /// A stream of pictures of `size` begins.
    pub fn begin(&mut self, size: [usize; 2]) {
        let effects = std::mem::take(&mut self.effects);
        *self = Self { effects, size, unknown: self.unknown, ..Self::new(self.optics, 0) };
        self.camera = Pinhole::new(size, self.optics.hfov_deg.or(USUAL_HFOV_DEG, 0.0).value);
    }

    /// What is believed of the camera.
    pub fn calibration(&self) -> Calibration {
        self.calibration
    }

    fn readout_s(&self) -> f64 {
        self.calibration.readout_s.value
    }

    /// Seconds in which a frame is read.
    pub fn reading_s(&self) -> f64 {
        self.readout_s().abs()
    }

    /// Seconds from a frame's time to the exposure of row `y`; never negative.
    pub fn delay(&self, y: f64) -> f64 {
        let y = y.clamp(0.0, self.size[1] as f64);
        self.readout_s() * y / self.size[1] as f64 + (-self.readout_s()).max(0.0)
    }

    /// Seconds from a frame's time to that of its middle row.
    pub fn middle_s(&self) -> f64 {
        0.5 * self.reading_s()
    }

    /// Seconds for which the path is needed after the middle row of a frame, as far as the rows are read or drawn.
    pub fn longest_s(&self) -> f64 {
        self.reading_s().max(self.drawn_s.abs())
    }

    /// Whether the path has to restart since the last call.
    pub fn take_path_is_stale(&mut self) -> bool {
        std::mem::take(&mut self.path_is_stale)
    }

    /// Before the first pair, of which frames come every `interval_s`: the prior.
    pub fn expect(&mut self, interval_s: f64, filter: &mut Filter) {
        let Optics { readout_s, hfov_deg, lens_k1 } = self.optics;
        let readout_s = readout_s.or(USUAL_READOUT * interval_s, READOUT_SIGMA * interval_s);
        let mut hfov_deg = hfov_deg.or(USUAL_HFOV_DEG, HFOV_SIGMA_DEG);
        let lens_k1 = lens_k1.or(0.0, LENS_SIGMA);
        // a field of view that was given may be the lens's from edge to edge, and a lens that is not known is found beside it alone
        if lens_k1.sigma > 0.0 {
            hfov_deg.sigma = hfov_deg.sigma.max(GIVEN_SIGMA_DEG);
        }
        self.camera = Pinhole::new(self.size, hfov_deg.value).with_lens(lens_k1.value, self.size[0]);
        let log_focal = hfov_deg.sigma / self.degrees_per_log_focal();
        self.calibration = Calibration { readout_s, hfov_deg, lens_k1 };
        self.drawn_s = readout_s.value;
        self.unknown = [readout_s, hfov_deg, lens_k1].map(|estimate| estimate.sigma > 0.0);
        self.evidence = Evidence::new([readout_s.sigma, log_focal, lens_k1.sigma]);
        filter.forget_calibration();
        filter.forget_flow(Flow::new(self.camera.focal, 0.5 * self.size[0] as f64, self.unknown[0]));
    }

    /// A pair comes, measured or not.
    pub fn count_pair(&mut self) {
        self.pairs = self.pairs.wrapping_add(1);
    }

    /// The pair's motion is unknown: the search must not compare it with its neighbours.
    pub fn skip(&mut self) {
        self.search.interrupt();
    }

    /// Takes in a pair's turn (yaw, pitch) and its slope over the rows, 1 / picture height; a pair whose interval is a guess
    /// says nothing of the readout time.
    pub fn search(&mut self, turn: [f64; 2], slope: [f64; 2], times: &Times) {
        match times.error {
            Some(_) => self.search.add(turn, slope, times.interval_s, SEARCH_MIN_PX / self.camera.focal),
            None => self.search.interrupt(),
        }
    }

    /// The part (0 to 1) of what a pair that moved by `moved_px` says of the calibration that counts.
    pub fn ask(&mut self, moved_px: f64, times: &Times, observations: &Observations) -> f64 {
        let is_turn = times.now_s < ASKED_ALL_S || self.pairs.is_multiple_of(ASKED_EVERY);
        let is_asked = self.unknown != [false; G] && times.error.is_some() && is_turn;
        let [from, to] = ASKED_PX;
        let share = if is_asked { ((moved_px - from) / (to - from)).clamp(0.0, 1.0) } else { 0.0 };
        if share > 0.0 {
            let Self { effects, camera, size, .. } = self;
            effects.clear();
            let of = |(sight, detail): (&Sight, &Detail)| camera.effects(detail.middle, &sight.derivative, size[0]);
            effects.extend(observations.sights.iter().zip(&observations.details).map(of));
        }
        self.interval_error.add(share, times.error.unwrap_or(0.0).abs().min(MAX_INTERVAL_ERROR));
        share
    }

    /// Puts on trial what the tracks say of the calibration, with the path as it is believed at the moment; of all of it the part `share`.
    pub fn add_terms(&self, observations: &mut Observations, weights: &[f64], share: f64, filter: &mut Filter) {
        let (mut corner, mut right) = ([[0.0; G]; G], [0.0; G]);
        let Observations { sights, details, batch } = observations;
        for index in 0..batch.len() {
            let (i, prediction) = batch.prediction(index);
            let (derivative, detail) = (&sights[i].derivative, &details[i]);
            let by_parameter =
                self.slopes(i, &prediction, derivative, detail.rows).map(|pixels| pixels.map(|value| share * value));
            batch.set_parameters(index, derivative, &by_parameter);
            if weights[i] > MIN_WEIGHT {
                let information = detail.information * weights[i];
                for (g, [gx, gy]) in by_parameter.iter().enumerate() {
                    for (h, [hx, hy]) in by_parameter.iter().enumerate() {
                        corner[g][h] += information * (gx * hx + gy * hy);
                    }
                    right[g] += information * (gx * detail.moved[0] + gy * detail.moved[1]);
                }
            }
        }
        filter.add_calibration(corner, right);
    }

    /// How what the path says of measurement `i` depends on readout time (pixels / s), on the logarithm of the focal length and on k1
    /// (pixels), with the path as it is believed at the moment.
    fn slopes(&self, i: usize, prediction: &Prediction, derivative: &[PerChannel; 2], rows: [f64; 2]) -> [[f64; 2]; G] {
        let Prediction { change, speeds: [sooner, later] } = *prediction;
        let from_bottom = if self.readout_s() < 0.0 { 1.0 } else { 0.0 };
        let [before, after] = rows.map(|y| y / self.size[1] as f64 - from_bottom);
        let moved = later * after - sooner * before;
        let [by_focal, by_lens] = &self.effects[i];
        let along = |is_unknown: bool, rows: &[PerChannel; 2], pose: &Pose| match is_unknown {
            true => [pose.dot(&rows[0]), pose.dot(&rows[1])],
            false => [0.0; 2],
        };
        let [readout, focal, lens] = self.unknown;
        [along(readout, derivative, &moved), along(focal, by_focal, &change), along(lens, by_lens, &change)]
    }

    /// All that the camera ever turned is in the path, as an angle; the tracks measured it in pixels, and with another focal length or lens they
    /// say another angle. On a long pan a change of a thousandth would move the path by more than the camera moves from frame to frame. Where the path
    /// begins is free to choose: it is moved so that the place about which the camera is held, its mean, stays where it is. To be called
    /// after [`Filter::solve`] and before [`Filter::accept`].
    pub fn follow_anchor(&mut self, reference_s: f64, interval_s: f64, filter: &Filter) {
        if self.unknown == [false; G] {
            return;
        }
        let news = 1.0 - (-interval_s / ANCHOR_S).exp();
        let now = filter.sensitivity(reference_s);
        for (mean, now) in self.anchor.as_flattened_mut().iter_mut().zip(now.as_flattened()) {
            *mean += news * (now - *mean);
        }
    }

    /// Takes over what the last pair said of the camera, and starts from there. Where the interval is a guess nothing was asked, and no limit
    /// counts that depends on it. To be called after [`Filter::accept`].
    pub fn follow(&mut self, times: &Times, filter: &mut Filter) {
        if self.unknown != [false; G] && times.error.is_some() {
            self.update(times.interval_s, filter);
        }
        // the rows of the next frame are drawn by a readout time that is nearer to what is believed, as far as the pictures confirm it
        let believed_s = self.readout_s();
        let goal_s =
            if self.unknown[0] { self.search.readout_to_draw(believed_s, self.learned(times.interval_s)) } else { believed_s };
        self.drawn_s += GLIDE * (goal_s - self.drawn_s);
    }

    /// How much is known of the readout time beyond what is expected of any camera: nothing while half of that expectation's variance is left,
    /// enough (1) where a quarter is.
    fn learned(&self, interval_s: f64) -> f64 {
        let left = (self.calibration.readout_s.sigma / (READOUT_SIGMA * interval_s)).powi(2);
        (2.0 - 4.0 * left).clamp(0.0, 1.0)
    }

    fn update(&mut self, interval_s: f64, filter: &mut Filter) {
        let marginal = filter.marginal();
        let wanted = self.evidence.add(&marginal);
        let readout_s = self.readout_s();
        let [least_s, most_s] = self.range_s(interval_s);
        if self.unknown[0]
            && (readout_s < least_s - RESTART_DISTANCE * interval_s || readout_s > most_s + RESTART_DISTANCE * interval_s)
        {
            return self.restart(0.5 * (least_s + most_s), interval_s, filter);
        }
        let shift = self.limit(wanted, [least_s, most_s], interval_s);
        let width = self.size[0] as f64;
        let Calibration { readout_s, hfov_deg, lens_k1 } = &mut self.calibration;
        readout_s.value += shift[0];
        self.camera.focal *= shift[1].exp();
        hfov_deg.value = (2.0 * (0.5 * width / self.camera.focal).atan()).to_degrees();
        lens_k1.value += shift[2];
        self.camera = self.camera.with_lens(lens_k1.value, self.size[0]);
        let offset = Pose::from_fn(|c| -(0..G).map(|g| shift[g] * self.anchor[g][c]).sum::<f64>());
        filter.move_calibration(shift, &offset);
        self.evidence.move_origin(shift, &marginal);
        self.state_sigmas(wanted, shift, interval_s);
    }

    /// The part of a wanted shift of the parameters that stays inside of what cameras are and of what the search says, and is not far.
    fn limit(&self, [readout, log_focal, lens]: [f64; G], [least_s, most_s]: [f64; 2], interval_s: f64) -> [f64; G] {
        let width = self.size[0] as f64;
        let focal = |hfov_deg: f64| 0.5 * width / (0.5 * hfov_deg.to_radians()).tan();
        let step = readout.clamp(-READOUT_STEP * interval_s, READOUT_STEP * interval_s);
        let to_readout_s = (self.readout_s() + step).clamp(least_s, most_s);
        let to_focal = (self.camera.focal * log_focal.clamp(-FOCAL_STEP, FOCAL_STEP).exp())
            .clamp(focal(HFOV_LIMITS_DEG[1]), focal(HFOV_LIMITS_DEG[0]));
        let k1 = self.calibration.lens_k1.value;
        let to_k1 = (k1 + lens.clamp(-LENS_STEP, LENS_STEP)).clamp(-LENS_LIMIT, LENS_LIMIT);
        [
            if self.unknown[0] { to_readout_s - self.readout_s() } else { 0.0 },
            if self.unknown[1] { (to_focal / self.camera.focal).ln() } else { 0.0 },
            if self.unknown[2] { to_k1 - k1 } else { 0.0 },
        ]
    }

    /// How many degrees the field of view narrows as the logarithm of the focal length grows by one.
    fn degrees_per_log_focal(&self) -> f64 {
        let half = 0.5 * self.size[0] as f64 / self.camera.focal;
        (2.0 * half / (1.0 + half * half)).to_degrees()
    }

    /// Where the readout time (seconds) can be, by the [`ReadoutSearch`].
    fn range_s(&self, interval_s: f64) -> [f64; 2] {
        let most = LONGEST_READOUT * interval_s;
        self.search.readout().map_or([-most, most], |(readout, deviation)| {
            let off = SEARCH_SIGMAS * hypot(deviation, SEARCH_FLOOR * interval_s + SEARCH_SHARE * readout.abs());
            // a search that sees little rules out little
            let off = if off > SEARCH_BLIND * interval_s { SEARCH_DOUBT * off } else { off };
            [readout - off, readout + off].map(|edge| edge.clamp(-most, most))
        })
    }

    /// The readout time is far from what was believed: `readout_s` is believed instead, and what it rested on forgotten.
    fn restart(&mut self, readout_s: f64, interval_s: f64, filter: &mut Filter) {
        let sigma = READOUT_SIGMA * interval_s;
        self.calibration.readout_s = Estimate { value: readout_s, sigma };
        let log_focal = if self.unknown[1] { HFOV_SIGMA_DEG / self.degrees_per_log_focal() } else { 0.0 };
        let k1 = if self.unknown[2] { LENS_SIGMA } else { 0.0 };
        self.evidence = Evidence::new([sigma, log_focal, k1]);
        filter.forget_calibration();
        self.path_is_stale = true;
    }

    /// Says how uncertain the calibration is, which was to move by `wanted` and did by `shift`: as what is on its way is far from where the
    /// tracks would have it. What ends at a limit was not found.
    fn state_sigmas(&mut self, wanted: [f64; G], shift: [f64; G], interval_s: f64) {
        let sigmas = self.evidence.deviations();
        let [readout, log_focal, lens] = std::array::from_fn(|g| hypot(sigmas[g], wanted[g] - shift[g]));
        let by_times = self.readout_s() * self.interval_error.deviation();
        let per_log = self.degrees_per_log_focal();
        let Calibration { readout_s, hfov_deg, lens_k1 } = &mut self.calibration;
        let at_limit = |sigma: f64, is_there: bool, prior: f64| if is_there { sigma.max(prior) } else { sigma };
        if self.unknown[0] {
            let is_there = readout_s.value.abs() >= LONGEST_READOUT * interval_s;
            readout_s.sigma = at_limit(hypot(readout, by_times), is_there, READOUT_SIGMA * interval_s);
        }
        if self.unknown[1] {
            let [narrowest, widest] = HFOV_LIMITS_DEG;
            let is_there = hfov_deg.value <= narrowest + EDGE_DEG || hfov_deg.value >= widest - EDGE_DEG;
            hfov_deg.sigma = at_limit(log_focal * per_log, is_there, HFOV_SIGMA_DEG);
        }
        if self.unknown[2] {
            lens_k1.sigma = at_limit(lens, lens_k1.value.abs() >= LENS_LIMIT, LENS_SIGMA);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::PRIOR;
    use super::*;
    use crate::kernel::Level;
    use crate::stage::shutter::Prior;

    const INTERVAL_S: f64 = 1.0 / 30.0;

    fn calibrator(optics: Optics) -> Calibrator {
        let mut calibrator = Calibrator::new(optics, 1);
        calibrator.begin([640, 480]);
        calibrator.expect(INTERVAL_S, &mut Filter::new(0.01, PRIOR, Level::SCALAR));
        calibrator
    }

    #[test]
    fn the_prior_is_what_is_known_of_the_camera() {
        let unknown = calibrator(Optics::default());
        let Calibration { readout_s, hfov_deg, lens_k1 } = unknown.calibration();
        assert_eq!(readout_s, Estimate { value: 0.75 * INTERVAL_S, sigma: 0.25 * INTERVAL_S });
        assert_eq!((hfov_deg, lens_k1), (Estimate { value: 60.0, sigma: 12.0 }, Estimate { value: 0.0, sigma: 0.1 }));
        assert_eq!(unknown.unknown, [true; G]);
        let hfov_deg = Prior::Fixed(70.0);
        let without_lens = calibrator(Optics { hfov_deg, ..Optics::default() });
        assert_eq!(without_lens.calibration().hfov_deg, Estimate { value: 70.0, sigma: 4.0 }, "the lens is found beside it");
        let fixed = Optics { readout_s: Prior::Fixed(0.02), hfov_deg, lens_k1: Prior::Fixed(-0.1) };
        let mut fixed = calibrator(fixed);
        assert_eq!((fixed.unknown, fixed.calibration().hfov_deg), ([false; G], Estimate::exact(70.0)));
        let times = Times { interval_s: INTERVAL_S, now_s: INTERVAL_S, error: Some(0.0), ..Times::default() };
        assert_eq!(fixed.ask(9.0, &times, &Observations::new(Level::SCALAR)), 0.0, "nothing is to be found");
    }

    #[test]
    fn rows_are_exposed_from_the_end_that_is_read_first() {
        for (readout_s, first, last) in [(0.02, 0.0, 0.02), (-0.02, 0.02, 0.0)] {
            let calibrator = calibrator(Optics { readout_s: Prior::Fixed(readout_s), ..Optics::default() });
            assert_eq!((calibrator.delay(0.0), calibrator.delay(480.0)), (first, last));
            assert_eq!((calibrator.middle_s(), calibrator.delay(240.0)), (0.01, 0.01));
        }
    }

    #[test]
    fn a_pair_is_asked_where_it_moves_and_its_time_is_known() {
        let mut calibrator = calibrator(Optics::default());
        let times = Times { interval_s: INTERVAL_S, now_s: INTERVAL_S, error: Some(0.0), ..Times::default() };
        let none = Observations::new(Level::SCALAR);
        for (moved_px, share) in [(0.2, 0.0), (0.65, 0.5), (4.0, 1.0)] {
            assert!((calibrator.ask(moved_px, &times, &none) - share).abs() < 1e-12);
        }
        assert_eq!(calibrator.ask(4.0, &Times { error: None, ..times }, &none), 0.0);
        let late = Times { now_s: 60.0, ..times };
        let asked: f64 = (0..9)
            .map(|_| {
                calibrator.count_pair();
                calibrator.ask(4.0, &late, &none)
            })
            .sum();
        assert_eq!(asked, 3.0, "later, each third pair");
    }

    #[test]
    fn parameters_move_a_step_at_a_time_and_stay_within_what_cameras_are() {
        let mut calibrator = calibrator(Optics::default());
        let most = LONGEST_READOUT * INTERVAL_S;
        let [readout, log_focal, lens] = calibrator.limit([1.0, 1.0, 1.0], [-most, most], INTERVAL_S);
        for (moved, step) in [(readout, READOUT_STEP * INTERVAL_S), (log_focal, FOCAL_STEP), (lens, LENS_STEP)] {
            assert!((moved - step).abs() < 1e-12, "{moved} {step}");
        }
        calibrator.calibration.lens_k1.value = LENS_LIMIT - 0.001;
        calibrator.camera = Pinhole::new([640, 480], HFOV_LIMITS_DEG[0] + 0.5);
        let [readout, log_focal, lens] = calibrator.limit([1.0, 1.0, 1.0], [-most, 0.76 * INTERVAL_S], INTERVAL_S);
        assert!((readout - 0.01 * INTERVAL_S).abs() < 1e-12 && (lens - 0.001).abs() < 1e-12, "{readout} {lens}");
        assert!(log_focal > 0.0 && log_focal < 0.02, "{log_focal}");
    }

    #[test]
    fn what_ends_at_a_limit_was_not_found() {
        let mut calibrator = calibrator(Optics::default());
        calibrator.evidence = Evidence::new([1e-4, 1e-3, 1e-3]);
        calibrator.state_sigmas([0.0; G], [0.0; G], INTERVAL_S);
        let found = calibrator.calibration();
        assert!((found.readout_s.sigma - 1e-4).abs() < 1e-9 && found.hfov_deg.sigma < 0.1, "{found:?}");
        calibrator.calibration.readout_s.value = -LONGEST_READOUT * INTERVAL_S;
        calibrator.calibration.hfov_deg.value = HFOV_LIMITS_DEG[1];
        calibrator.calibration.lens_k1.value = LENS_LIMIT;
        calibrator.state_sigmas([0.0; G], [0.0; G], INTERVAL_S);
        let stuck = calibrator.calibration();
        assert_eq!((stuck.readout_s.sigma, stuck.hfov_deg.sigma, stuck.lens_k1.sigma), (0.25 * INTERVAL_S, 12.0, 0.1));
    }
}
