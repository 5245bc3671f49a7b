//! The virtual camera's path.
//!
//! Two drives move it: one that forecasts the camera and plans its way through the crop window ([`Mode::Adaptive`]), each channel alone
//! while the window is wide enough and yaw, pitch and roll together where it is full, and the paper's low-pass ([`Mode::Iir`]), whose correction is made smaller where the window does not hold it, and slowly grows back. With look-ahead,
//! cameras are observed ([`Smoother::observe`]) before their frames are placed ([`Smoother::step`]). In both, a correction stays inside
//! of the bounds that it is given, frame by frame. All times are in seconds, so that the rate of the frames changes little.

mod adaptive;
mod forecast;
mod joint;
mod plan;
mod tuning;

use std::f64::consts::TAU;

use super::crop::{Bounds, Rows};
use super::paper::low_pass as iir;
use super::shutter::RowSpan;
use crate::geometry::{PITCH, PerChannel, Pose, ROLL, YAW, ZOOM};
use adaptive::StepInput;
use forecast::Forecast;
use joint::{JointInput, Planned};
use plan::Ahead;
pub use tuning::Tuning;

/// Which drive moves the virtual camera.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Mode {
    /// As little acceleration as the crop window allows: at rest under shake, smooth after a pan.
    #[default]
    Adaptive,
    /// The paper's causal low-pass.
    Iir,
}

/// Settings of the path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Params {
    /// Which drive.
    pub mode: Mode,
    /// How steady. Up to 1, the part of the crop window that may be used; 0 removes nothing but rolling shutter. From 1 to [`TRIPOD`],
    /// adaptive alone: how much the virtual camera would rather hold its place than follow.
    pub strength: f64,
    /// Adaptive alone: milliseconds by which frames may be late so that the path is planned with what comes (0 to 500).
    pub lookahead_ms: f64,
    /// Iir alone: motion slower than this is followed, faster is removed (Hz, 0.05 to 10).
    pub cutoff_hz: f64,
}

impl Params {
    /// Seconds by which frames may be late: none where the drive would make nothing of it.
    pub fn lookahead_s(&self) -> f64 {
        if self.mode == Mode::Adaptive { 1e-3 * self.lookahead_ms.max(0.0) } else { 0.0 }
    }
}

impl Default for Params {
    fn default() -> Self {
        Self { mode: Mode::default(), strength: 1.0, lookahead_ms: 0.0, cutoff_hz: 0.6 }
    }
}

/// The strength with which one place is held for as long as the window lasts.
pub const TRIPOD: f64 = 2.0;
/// Longest step of the paper's filter, seconds.
const STEP_S: f64 = 0.0085;
/// The order of the channels: roll and zoom take their part of the window first, the rest is for yaw and pitch.
const ORDER: [usize; 4] = [ZOOM, ROLL, YAW, PITCH];
/// Part of its own bound that each channel may take, at most.
const SHARE: [f64; 4] = [1.0, 1.0, 0.8, 0.25];
/// Part of the window that is never used: the bounds are planes, the picture's edge is not quite.
const SPARE: f64 = 0.005;
/// Seconds in which strength goes from 0 to 1.
const STRENGTH_S: f64 = 1.0;

/// Moves the virtual camera.
#[derive(Clone, Debug)]
pub struct Smoother {
    params: Params,
    tuning: Tuning,
    /// Strength as it is, on its way to the one that is wanted.
    strength: f64,
    /// Whether a stream has begun: whether a camera was observed, and whether the virtual one was placed.
    observed: bool,
    begun: bool,
    /// The largest correction of each channel at full strength, as it was last; infinite for one that moves nothing.
    limit: PerChannel,
    channels: [Channel; 4],
    /// The plan of the channels together, and the share of the time for which the window was full of late.
    planner: joint::Planner,
    fullness: f64,
}

#[derive(Clone, Debug)]
struct Channel {
    /// The camera's place.
    camera: f64,
    /// The virtual camera's.
    place: f64,
    /// Where the camera goes.
    forecast: Forecast,
    /// The adaptive drive, and whether it moved the place last.
    drive: adaptive::Controller,
    driven: bool,
    /// The paper's filter, and the part of its correction that the window allows.
    filter: iir::LowPass,
    gain: f64,
}

impl Smoother {
    /// A virtual camera that has seen nothing.
    pub fn new(params: &Params) -> Self {
        Self::tuned(params, &Tuning::default())
    }

    /// The same with other numbers.
    pub fn tuned(params: &Params, tuning: &Tuning) -> Self {
        let channel = || Channel {
            camera: 0.0,
            place: 0.0,
            forecast: Forecast::new(),
            drive: adaptive::Controller::default(),
            driven: false,
            filter: iir::LowPass::default(),
            gain: 1.0,
        };
        Self {
            params: *params,
            tuning: *tuning,
            strength: params.strength,
            observed: false,
            begun: false,
            limit: [0.0; 4],
            channels: [channel(), channel(), channel(), channel()],
            planner: joint::Planner::default(),
            fullness: 0.0,
        }
    }

    /// Takes new settings; what changes glides.
    pub fn set_params(&mut self, params: &Params) {
        self.params = *params;
    }

    /// A stream begins: the next path is followed from where it is.
    pub fn begin(&mut self) {
        (self.observed, self.begun, self.limit) = (false, false, [0.0; 4]);
        self.strength = self.params.strength;
        self.fullness = 0.0;
        self.planner.forget();
    }

    /// The camera is seen at `camera`, `interval_s` seconds after the frame before, and at `ends` where the frame's rows began and ended.
    pub fn observe(&mut self, camera: Pose, interval_s: f64, ends: RowSpan<Pose>) {
        for (c, channel) in self.channels.iter_mut().enumerate() {
            let unit = if self.params.mode == Mode::Adaptive { self.limit[c] } else { 0.0 };
            let ends = ends.map(|end| end[c]);
            match self.observed {
                true => channel.forecast.observe(&self.tuning, camera[c], interval_s, ends, unit),
                false => channel.forecast.begin(camera[c]),
            }
        }
        self.observed = true;
    }

    /// The correction that the frame before got.
    pub fn correction(&self) -> Pose {
        if self.begun { Pose::from_fn(|c| self.channels[c].correction()) } else { Pose::default() }
    }

    /// The virtual camera's place after `interval_s` seconds in which the camera went to `camera`, inside of `bounds`. What was observed
    /// last is `known_s` seconds later.
    pub fn step(&mut self, camera: Pose, interval_s: f64, known_s: f64, bounds: &Bounds) -> Pose {
        let alone = bounds.alone();
        self.limit = std::array::from_fn(|c| alone[c] * SHARE[c]);
        if !self.begun {
            self.begun = true;
            for (channel, camera) in self.channels.iter_mut().zip(camera.0) {
                channel.follow(camera);
            }
            return camera;
        }
        let goal = self.params.strength.clamp(0.0, TRIPOD);
        self.strength += (goal - self.strength).clamp(-interval_s / STRENGTH_S, interval_s / STRENGTH_S);
        let hold = (self.strength - 1.0).clamp(0.0, TRIPOD - 1.0);
        let share = self.joint_share();
        for c in ORDER {
            let limit = self.limit[c] * self.part();
            if !limit.is_finite() || limit <= 0.0 {
                // a channel that moves nothing, or no window at all
                self.channels[c].follow(camera[c]);
                continue;
            }
            let later = self.interval(bounds, c, Rows::Still);
            let before = std::mem::replace(&mut self.channels[c].camera, camera[c]);
            let now = self.interval(bounds, c, Rows::Moving);
            let channel = &mut self.channels[c];
            if interval_s > 0.0 {
                match self.params.mode {
                    Mode::Adaptive => {
                        let at = StepInput { camera: camera[c], interval_s, known_s, limit, now, later, hold };
                        channel.drive(&self.tuning, at, c == ZOOM || share < 1.0);
                    }
                    Mode::Iir => channel.filter(self.params.cutoff_hz, before, interval_s, later),
                }
            }
            let held = channel.camera + channel.correction().clamp(now[0], now[1]);
            channel.set_back(held - channel.place);
        }
        if self.params.mode == Mode::Adaptive && interval_s > 0.0 {
            self.plan_together(share, known_s, hold, bounds);
        }
        // the channels were held back one by one, each for what the others were: together they may still be too much
        let crop_use = bounds.crop_use(&self.correction());
        if crop_use > 1.0 - 0.5 * SPARE {
            for channel in &mut self.channels {
                channel.set_back(channel.correction() * ((1.0 - SPARE) / crop_use - 1.0));
            }
        }
        let full = if crop_use > self.tuning.full_use * self.part() { 1.0 } else { 0.0 };
        self.fullness += (full - self.fullness) * (1.0 - (-interval_s / self.tuning.full_s).exp());
        Pose::from_fn(|c| self.channels[c].place)
    }

    /// How far the virtual camera goes from where the channels' own plans lead to where the plan of all of them together leads: 0 to 1, by how
    /// often the window was full of late.
    fn joint_share(&self) -> f64 {
        let Tuning { full_from, full_to, .. } = self.tuning;
        ((self.fullness - full_from) / (full_to - full_from)).clamp(0.0, 1.0)
    }

    /// Goes the part `share` of the way to where the plan of all channels together leads.
    fn plan_together(&mut self, share: f64, known_s: f64, hold: f64, bounds: &Bounds) {
        let planned = |c: usize| self.channels[c].driven && self.limit[c].is_finite();
        let Some(first) = (0..joint::C).find(|&c| planned(c)).filter(|_| share > 0.0) else {
            self.planner.forget();
            return;
        };
        let (tuning, part) = (self.tuning.joint(), self.part());
        let limit = std::array::from_fn(|c| if planned(c) { self.limit[c] * part } else { 0.0 });
        let camera = Pose::from_fn(|c| self.channels[c].camera);
        let ahead = std::array::from_fn(|c| match limit[c] > 0.0 {
            true => {
                let edges = [-limit[c], limit[c]];
                let at =
                    StepInput { camera: camera[c], interval_s: 0.0, known_s, limit: limit[c], now: edges, later: edges, hold };
                adaptive::outlook(&tuning, &self.channels[c].forecast, &at)
            }
            false => Ahead::default(),
        });
        let motion = std::array::from_fn(|c| self.channels[c].drive.before());
        let (ticks, zoom) = (self.channels[first].drive.ticks(), self.channels[ZOOM].correction());
        let input =
            JointInput { camera, ahead: &ahead, motion: &motion, limit, ticks, bounds, part: part * (1.0 - SPARE), zoom };
        let Some(Planned { wanted, inside }) = self.planner.step(&tuning, &input) else { return };
        for c in (0..joint::C).filter(|&c| limit[c] > 0.0) {
            let channel = &mut self.channels[c];
            channel.place = channel.drive.blend(share, camera[c] + inside[c], inside[c] != wanted[c], camera[c]);
            channel.filter = iir::LowPass { input: camera[c], output: channel.place, speed: 0.0 };
        }
    }

    /// The part of the window that may be used.
    fn part(&self) -> f64 {
        self.strength.min(1.0)
    }

    /// The least and the most that channel `c` may correct, the others as they are; roll and zoom do not ask yaw and pitch.
    fn interval(&self, bounds: &Bounds, c: usize, rows: Rows) -> [f64; 2] {
        let mut correction = self.correction();
        if SHARE[c] < 1.0 {
            (correction[YAW], correction[PITCH]) = (0.0, 0.0);
        }
        let part = self.part() * (1.0 - SPARE);
        let most = if SHARE[c] < 1.0 { self.limit[c] } else { f64::INFINITY };
        let [low, high] = bounds.interval(c, &correction, rows);
        [low.max(-most) * part, high.min(most) * part]
    }
}

impl Channel {
    fn correction(&self) -> f64 {
        self.place - self.camera
    }

    /// To where the camera is.
    fn follow(&mut self, camera: f64) {
        (self.camera, self.place, self.gain, self.driven) = (camera, camera, 1.0, false);
        self.filter = iir::LowPass { input: camera, output: camera, speed: 0.0 };
    }

    /// The place is moved back by `shift`.
    fn set_back(&mut self, shift: f64) {
        self.place += shift;
        if self.driven {
            self.drive.was_set_back(shift, self.camera);
        }
    }

    /// A step of the adaptive drive; with no plan of its own, the place is up to the plan of all channels.
    fn drive(&mut self, tuning: &Tuning, at: StepInput, alone: bool) {
        if self.forecast.tick_s() == 0.0 {
            return;
        }
        if !self.driven {
            self.drive.begin(self.place);
            self.driven = true;
        }
        if alone {
            self.place = self.drive.step(tuning, &self.forecast, &at);
        } else {
            self.drive.wait(&self.forecast, at.interval_s);
        }
        self.filter = iir::LowPass { input: self.camera, output: self.place, speed: 0.0 };
        self.gain = 1.0;
    }

    fn filter(&mut self, cutoff_hz: f64, before: f64, interval_s: f64, [low, high]: [f64; 2]) {
        let steps = (interval_s / STEP_S).ceil().max(1.0);
        let h = interval_s / steps;
        for k in 1..=steps as usize {
            let camera = before + (self.camera - before) * k as f64 / steps;
            self.filter = self.filter.after(TAU * cutoff_hz, camera, h);
            let wanted = self.filter.output - camera;
            self.gain = iir::gain(self.gain, wanted.abs(), if wanted < 0.0 { -low } else { high }, h);
            self.place = camera + self.gain * wanted;
        }
        self.driven = false;
    }
}

#[cfg(test)]
mod tests;
