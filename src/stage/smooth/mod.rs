//! The virtual camera's path.
//!
//! Two drives move it: one that forecasts the camera and plans its way through the crop window ([`Mode::Adaptive`]), and the paper's
//! low-pass ([`Mode::Iir`]), whose correction is made smaller where the window does not hold it, and slowly grows back. With look-ahead,
//! cameras are observed ([`Smoother::observe`]) before their frames are placed ([`Smoother::step`]). Whatever they
//! want, the crop window has the last word, frame by frame, on all that turns and zooms together. All is in seconds, so that the rate of
//! the frames changes little.

mod adaptive;
mod forecast;
mod iir;
mod plan;
mod tuning;

use std::f64::consts::TAU;

use super::crop::{Room, Rows};
use super::shutter::Ends;
use crate::geometry::Pose;
use adaptive::Circumstances;
use forecast::Forecast;
pub use tuning::Tuning;

/// Which drive moves the virtual camera.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Mode {
    /// As little acceleration as the crop window allows: stands still under shake, glides after a pan.
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
    /// How steady: the part of the crop window that may be used (0 to 1). 0 takes out nothing but rolling shutter.
    pub strength: f64,
    /// Adaptive alone: milliseconds by which frames may be late so that the path is planned with what comes (0 to 500).
    pub lookahead_ms: f64,
    /// Iir alone: motion slower than this is followed, faster is taken out (Hz, 0.05 to 10).
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

/// Longest step of the paper's filter, seconds.
const STEP_S: f64 = 0.0085;
/// The order of the channels: what turns takes its part of the window first, the rest is for yaw and pitch.
const ORDER: [usize; 4] = [3, 2, 0, 1];
/// Part of the window that roll and zoom may take.
const SHARE: [f64; 4] = [1.0, 1.0, 0.8, 0.25];
/// Part of the window that is never used: what the window's description leaves out.
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
    /// Half of the crop window, as it was last.
    half: Pose,
    channels: [Channel; 4],
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
    drive: adaptive::Drive,
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
            drive: adaptive::Drive::default(),
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
            half: [0.0; 4],
            channels: [channel(), channel(), channel(), channel()],
        }
    }

    /// Takes new settings; what changes glides.
    pub fn set_params(&mut self, params: &Params) {
        self.params = *params;
    }

    /// A stream begins: the next path is followed from where it is.
    pub fn begin(&mut self) {
        (self.observed, self.begun, self.half) = (false, false, [0.0; 4]);
        self.strength = self.params.strength;
    }

    /// The camera is seen at `camera`, `interval_s` seconds after the frame before, and at `ends` where the frame's rows began and ended.
    pub fn observe(&mut self, camera: Pose, interval_s: f64, ends: Ends<Pose>) {
        for (c, channel) in self.channels.iter_mut().enumerate() {
            let unit = if self.params.mode == Mode::Adaptive { self.half[c] } else { 0.0 };
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
        if self.begun { std::array::from_fn(|c| self.channels[c].correction()) } else { [0.0; 4] }
    }

    /// The virtual camera's place after `interval_s` seconds in which the camera went to `camera`, inside of `room`. What was observed
    /// last is `known_s` seconds later.
    pub fn step(&mut self, camera: Pose, interval_s: f64, known_s: f64, room: &Room) -> Pose {
        self.half = std::array::from_fn(|c| room.half()[c] * SHARE[c]);
        if !self.begun {
            self.begun = true;
            for (channel, camera) in self.channels.iter_mut().zip(camera) {
                channel.follow(camera);
            }
            return camera;
        }
        let goal = self.params.strength.clamp(0.0, 1.0);
        self.strength += (goal - self.strength).clamp(-interval_s / STRENGTH_S, interval_s / STRENGTH_S);
        for c in ORDER {
            let half = self.half[c] * self.strength;
            if !half.is_finite() || half <= 0.0 {
                // a channel that moves nothing, or no window at all
                self.channels[c].follow(camera[c]);
                continue;
            }
            let later = self.allowed(room, c, Rows::Still);
            let before = std::mem::replace(&mut self.channels[c].camera, camera[c]);
            let now = self.allowed(room, c, Rows::Moving);
            let channel = &mut self.channels[c];
            if interval_s > 0.0 {
                match self.params.mode {
                    Mode::Adaptive => {
                        channel.drive(&self.tuning, Circumstances { camera: camera[c], interval_s, known_s, half, now, later });
                    }
                    Mode::Iir => channel.filter(self.params.cutoff_hz, before, interval_s, later),
                }
            }
            let held = channel.camera + channel.correction().clamp(now[0], now[1]);
            channel.slip(held - channel.place);
        }
        // the channels were held back one by one, each for what the others were: together they may still be too much
        let reach = room.reach(&self.correction());
        if reach > 1.0 - 0.5 * SPARE {
            for channel in &mut self.channels {
                channel.slip(channel.correction() * ((1.0 - SPARE) / reach - 1.0));
            }
        }
        std::array::from_fn(|c| self.channels[c].place)
    }

    /// The least and the most that channel `c` may correct, the others as they are.
    fn allowed(&self, room: &Room, c: usize, rows: Rows) -> [f64; 2] {
        let mut correction = self.correction();
        if SHARE[c] < 1.0 {
            (correction[0], correction[1]) = (0.0, 0.0);
        }
        let whole = self.strength * (1.0 - SPARE);
        let most = if SHARE[c] < 1.0 { SHARE[c] * room.half()[c] } else { f64::INFINITY };
        let [low, high] = room.of(c, &correction, rows);
        [low.max(-most) * whole, high.min(most) * whole]
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

    /// The place is held back by `slip`.
    fn slip(&mut self, slip: f64) {
        self.place += slip;
        if self.driven {
            self.drive.slipped(slip, self.camera);
        }
    }

    fn drive(&mut self, tuning: &Tuning, at: Circumstances) {
        if self.forecast.tick_s() == 0.0 {
            return;
        }
        if !self.driven {
            self.drive.begin(self.place);
            self.driven = true;
        }
        self.place = self.drive.step(tuning, &self.forecast, &at);
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
