//! The camera's constants (readout time, field of view, the lens's k1): what is expected of them, what the tracks are asked, and how the
//! model follows what they say ([`super::globals`]).

use super::batch::Said;
use super::flow::Flow;
use super::globals::Globals;
use super::normal::G;
use super::{Continuous, MIN_WEIGHT, dot};
use crate::geometry::{Calibration, Pinhole, Pose, hypot};

/// Readout time that is expected of a camera of which nothing is known, and its standard deviation (frame intervals).
const USUAL_READOUT: f64 = 0.75;
const READOUT_SPREAD: f64 = 0.25;
/// Horizontal field of view that is expected likewise, and its standard deviation (degrees).
pub(super) const USUAL_HFOV_DEG: f64 = 60.0;
const HFOV_SPREAD_DEG: f64 = 12.0;
/// Standard deviation of a field of view that was given, where the lens is not known: data sheets say what is seen from edge to edge, or
/// what the focal length gives, and often round.
const GIVEN_SPREAD_DEG: f64 = 4.0;
/// Standard deviation of the lens's k1 from 0 that is expected likewise.
const LENS_SPREAD: f64 = 0.1;
/// Furthest that k1 may be from 0, and furthest that it is moved at a time.
pub const LENS_LIMIT: f64 = 0.35;
const LENS_STEP: f64 = 0.02;
/// Longest readout time that is looked for (frame intervals): one that fills the interval is found with its error, and what ends here was
/// not found.
pub const LONGEST_READOUT: f64 = 1.1;
/// Standard deviations up to which the first look at the readout time is taken at its word; what is added to one, and a share of
/// the value (frame intervals). It is rough: on rendered clips of any shake it is 1.0 to 1.4 times the truth.
const LOOK_DEVIATIONS: f64 = 2.0;
const LOOK_FLOOR: f64 = 0.03;
const LOOK_SHARE: f64 = 0.1;
/// Change of the turn from pair to pair that it asks for, pixels.
pub(super) const LOOK_LEAST_PX: f64 = 0.7;
/// Uncertainty from which it sees little (frame intervals), and the factor on it then.
const LOOK_BLIND: f64 = 0.4;
const LOOK_DOUBT: f64 = 1.5;
/// Seconds for which all pairs are asked of the constants, and which are later.
const ASKED_ALL_S: f64 = 10.0;
const ASKED_EVERY: u32 = 3;
/// Furthest that the readout time is moved at a time (frame intervals).
const READOUT_STEP: f64 = 0.05;
/// Part of its distance to what is believed that the readout time by which the rows are drawn goes at a time: a new belief does not move the
/// picture at once.
const GLIDE: f64 = 0.05;
/// How far off it the readout time must be for its search to restart (frame intervals).
const FAR: f64 = 0.25;
/// Seconds of the path whose mean stays where it is when the constants change.
pub(super) const ANCHOR_S: f64 = 1.0;
/// Fields of view that a camera may have (degrees): an estimate stays between.
pub const HFOV_LIMITS_DEG: [f64; 2] = [45.0, 110.0];
/// Distance from them at which one counts as there.
const EDGE_DEG: f64 = 0.1;

impl Continuous {
    /// Before the first pair: what is expected of readout time, field of view and lens.
    pub(super) fn expect(&mut self, interval_s: f64) {
        let (readout_s, readout_deviation) = self.optics.readout_s.or(USUAL_READOUT * interval_s, READOUT_SPREAD * interval_s);
        let (hfov_deg, hfov_deviation) = self.optics.hfov_deg.or(USUAL_HFOV_DEG, HFOV_SPREAD_DEG);
        let (k1, k1_deviation) = self.optics.lens_k1.or(0.0, LENS_SPREAD);
        // a field of view that was given may be the lens's from edge to edge, and a lens that is not known is found beside it alone
        let hfov_deviation = if k1_deviation > 0.0 { hfov_deviation.max(GIVEN_SPREAD_DEG) } else { hfov_deviation };
        self.camera = Pinhole::new(self.size, hfov_deg).with_lens(k1, self.size[0]);
        let log_focal = hfov_deviation / self.degrees_per_log_focal();
        self.calibration = Calibration {
            readout_s,
            readout_deviation_s: readout_deviation,
            hfov_deg,
            hfov_deviation_deg: hfov_deviation,
            lens_k1: k1,
            lens_k1_deviation: k1_deviation,
        };
        self.drawn_s = readout_s;
        self.filter.forget_globals();
        self.filter.forget_flow(Flow::new(self.camera.focal, 0.5 * self.size[0] as f64, readout_deviation > 0.0));
        self.globals = Globals::new([readout_deviation, log_focal, k1_deviation]);
        self.unknown = [readout_deviation > 0.0, hfov_deviation > 0.0, k1_deviation > 0.0];
    }

    /// How many degrees the field of view narrows as the logarithm of the focal length grows by one.
    fn degrees_per_log_focal(&self) -> f64 {
        let half = 0.5 * self.size[0] as f64 / self.camera.focal;
        (2.0 * half / (1.0 + half * half)).to_degrees()
    }

    /// Where the readout time (seconds) can be, by the [`ReadoutSearch`].
    fn initial_range(&self) -> [f64; 2] {
        let most = LONGEST_READOUT * self.interval_s;
        self.readout_search.readout().map_or([-most, most], |(readout, deviation)| {
            let off = LOOK_DEVIATIONS * hypot(deviation, LOOK_FLOOR * self.interval_s + LOOK_SHARE * readout.abs());
            // a look that sees little rules out little
            let off = if off > LOOK_BLIND * self.interval_s { LOOK_DOUBT * off } else { off };
            [readout - off, readout + off].map(|edge| edge.clamp(-most, most))
        })
    }

    /// The readout time is far from what was believed: `readout_s` is believed instead, and what it rested on forgotten.
    fn restart_search(&mut self, readout_s: f64) {
        let spread = READOUT_SPREAD * self.interval_s;
        self.calibration.readout_s = readout_s;
        self.calibration.readout_deviation_s = spread;
        let log_focal = if self.unknown[1] { HFOV_SPREAD_DEG / self.degrees_per_log_focal() } else { 0.0 };
        let k1 = if self.unknown[2] { LENS_SPREAD } else { 0.0 };
        self.globals = Globals::new([spread, log_focal, k1]);
        self.filter.forget_globals();
        self.restarting = true;
    }

    /// All that the camera ever turned is in the path, as an angle; the tracks measured it in pixels, and with another focal length or lens they
    /// say another angle. On a long pan a change of a thousandth would move the path by more than the camera moves from frame to frame. Where the path
    /// begins is free to choose: it is moved so that the place about which the camera is held, its mean, stays where it is.
    pub(super) fn follow_anchor(&mut self, reference_s: f64, interval_s: f64) {
        if self.unknown == [false; G] {
            return;
        }
        let news = 1.0 - (-interval_s / ANCHOR_S).exp();
        let now = self.filter.sensitivity(reference_s);
        for (mean, now) in self.anchor.as_flattened_mut().iter_mut().zip(now.as_flattened()) {
            *mean += news * (now - *mean);
        }
    }

    /// Takes over what the last pair said of the camera, and starts from there.
    pub(super) fn follow_camera(&mut self) {
        // where the time is not known nothing was asked, and no limit counts that hangs on it
        if self.unknown == [false; G] || self.timed.is_none() {
            return;
        }
        let marginal = self.filter.marginal();
        let [readout, log_focal, lens] = self.globals.take(&marginal);
        let Calibration { readout_s, lens_k1: k1, .. } = self.calibration;
        let width = self.size[0] as f64;
        let focal = |hfov_deg: f64| 0.5 * width / (0.5 * hfov_deg.to_radians()).tan();
        // never outside of what cameras are and of what the first look says, and never far at once
        let interval_s = self.interval_s;
        let [least_s, most_s] = self.initial_range();
        if self.unknown[0] && (readout_s < least_s - FAR * interval_s || readout_s > most_s + FAR * interval_s) {
            return self.restart_search(0.5 * (least_s + most_s));
        }
        let step = readout.clamp(-READOUT_STEP * interval_s, READOUT_STEP * interval_s);
        let to_readout_s = (readout_s + step).clamp(least_s, most_s);
        let to_focal = (self.camera.focal * log_focal.clamp(-0.05, 0.05).exp())
            .clamp(focal(HFOV_LIMITS_DEG[1]), focal(HFOV_LIMITS_DEG[0]));
        let shift = [
            if self.unknown[0] { to_readout_s - readout_s } else { 0.0 },
            if self.unknown[1] { (to_focal / self.camera.focal).ln() } else { 0.0 },
            if self.unknown[2] { (k1 + lens.clamp(-LENS_STEP, LENS_STEP)).clamp(-LENS_LIMIT, LENS_LIMIT) - k1 } else { 0.0 },
        ];
        self.calibration.readout_s += shift[0];
        self.camera.focal *= shift[1].exp();
        self.calibration.hfov_deg = (2.0 * (0.5 * width / self.camera.focal).atan()).to_degrees();
        self.calibration.lens_k1 += shift[2];
        self.camera = self.camera.with_lens(self.calibration.lens_k1, self.size[0]);
        let offset = std::array::from_fn(|c| -(0..G).map(|g| shift[g] * self.anchor[g][c]).sum::<f64>());
        self.filter.move_globals(shift, &offset);
        self.globals.moved(shift, &marginal);
        self.state_deviations([readout, log_focal, lens], shift);
    }

    /// Says how uncertain the constants are, which were to move by `wanted` and did by `shift`: as what is on its way is far from where the tracks
    /// would have it. What ends at a limit was not found.
    fn state_deviations(&mut self, wanted: [f64; G], shift: [f64; G]) {
        let deviations = self.globals.deviations();
        let [readout, log_focal, lens] = std::array::from_fn(|g| hypot(deviations[g], wanted[g] - shift[g]));
        let by_times = self.calibration.readout_s * self.unevenness.deviation();
        let per_log = self.degrees_per_log_focal();
        let unknown = self.unknown;
        let (interval_s, found) = (self.interval_s, &mut self.calibration);
        let at_limit = |deviation: f64, is_there: bool, spread: f64| if is_there { deviation.max(spread) } else { deviation };
        if unknown[0] {
            let is_there = found.readout_s.abs() >= LONGEST_READOUT * interval_s;
            found.readout_deviation_s = at_limit(hypot(readout, by_times), is_there, READOUT_SPREAD * interval_s);
        }
        if unknown[1] {
            let [narrowest, widest] = HFOV_LIMITS_DEG;
            let is_there = found.hfov_deg <= narrowest + EDGE_DEG || found.hfov_deg >= widest - EDGE_DEG;
            found.hfov_deviation_deg = at_limit(log_focal * per_log, is_there, HFOV_SPREAD_DEG);
        }
        if unknown[2] {
            found.lens_k1_deviation = at_limit(lens, found.lens_k1.abs() >= LENS_LIMIT, LENS_SPREAD);
        }
    }

    /// The rows of the next frame are drawn by a readout time that is nearer to what is believed, as far as the pictures carry it.
    pub(super) fn glide(&mut self) {
        let believed_s = self.calibration.readout_s;
        let goal_s = if self.unknown[0] { self.readout_search.drawn(believed_s) } else { believed_s };
        self.drawn_s += GLIDE * (goal_s - self.drawn_s);
    }

    /// Whether the last pair is asked of the constants: at first each is, later some are, which says as much and costs less.
    pub(super) fn is_asked(&self) -> bool {
        self.now_s < ASKED_ALL_S || self.pairs.is_multiple_of(ASKED_EVERY)
    }

    /// How what the path says of measurement `i` depends on readout time (pixels / s), on the logarithm of the focal length and on k1
    /// (pixels), with the path as it is believed at the moment.
    fn by_global(&self, i: usize, said: &Said, rows: [f64; 2]) -> [[f64; 2]; G] {
        let Said { change, speeds: [sooner, later] } = *said;
        let from_bottom = if self.calibration.readout_s < 0.0 { 1.0 } else { 0.0 };
        let [before, after] = rows.map(|y| y / self.size[1] as f64 - from_bottom);
        let moved: Pose = std::array::from_fn(|c| later[c] * after - sooner[c] * before);
        let [by_focal, by_lens] = &self.effects[i];
        let along = |is_unknown: bool, rows: &[Pose; 2], pose: &Pose| match is_unknown {
            true => [dot(&rows[0], pose), dot(&rows[1], pose)],
            false => [0.0; 2],
        };
        let [readout, focal, lens] = self.unknown;
        [along(readout, &self.sights[i].derivative, &moved), along(focal, by_focal, &change), along(lens, by_lens, &change)]
    }

    /// Puts on trial what the tracks say of readout time, focal length and k1, with the path as it is believed at the moment; of all of it
    /// the part `share`.
    pub(super) fn ask_globals(&mut self, tracks: &[crate::frame::Track], share: f64) {
        let (mut corner, mut right) = ([[0.0; G]; G], [0.0; G]);
        for index in 0..self.batch.len() {
            let (i, said) = self.batch.said_at(index);
            let sight = &self.sights[i];
            let rows = [tracks[i].from[1], tracks[i].to[1]];
            let by_global = self.by_global(i, &said, rows).map(|pixels| pixels.map(|value| share * value));
            self.batch.set_globals(index, &sight.derivative, &by_global);
            if self.weights[i] > MIN_WEIGHT {
                let information = self.information[i] * self.weights[i];
                for (g, [gx, gy]) in by_global.iter().enumerate() {
                    for (h, [hx, hy]) in by_global.iter().enumerate() {
                        corner[g][h] += information * (gx * hx + gy * hy);
                    }
                    right[g] += information * (gx * sight.moved[0] + gy * sight.moved[1]);
                }
            }
        }
        self.filter.add_globals(corner, right);
    }
}
