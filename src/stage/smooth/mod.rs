//! The virtual camera's path.
//!
//! Two drives say where it wants to go: the paper's low-pass ([`Mode::Iir`]) and one that uses the crop window for standing still
//! ([`Mode::Adaptive`]). Where the window does not hold what the low-pass wants, all of it is made smaller, and slowly grows back;
//! what stands still is pushed along by the window's edges, against motion outwards alone, so that it yields to the camera and is
//! never thrown back. All in seconds, in steps far finer than a frame, so that the rate of the frames changes little.

mod adaptive;
mod forecast;
mod iir;
mod plan;

use std::f64::consts::TAU;

use super::crop::{Room, Rows};
use crate::geometry::Pose;

/// Which drive moves the virtual camera.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Mode {
    /// Stands still for as long as the crop window allows, follows a pan.
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
    /// Iir alone: motion slower than this is followed, faster is taken out (Hz, 0.05 to 10).
    pub cutoff_hz: f64,
}

impl Default for Params {
    fn default() -> Self {
        Self { mode: Mode::default(), strength: 1.0, cutoff_hz: 0.6 }
    }
}

/// Longest step of the paper's filter, seconds.
const STEP_S: f64 = 0.0085;
/// The order of the channels: what turns takes its part of the window first, the rest is for yaw and pitch.
const ORDER: [usize; 4] = [3, 2, 0, 1];
/// Part of the window that roll and zoom may take.
const SHARE: [f64; 4] = [1.0, 1.0, 0.6, 0.25];
/// Part of the window that is never used: what the window's description leaves out.
const SPARE: f64 = 0.005;
/// Seconds in which strength goes from 0 to 1.
const STRENGTH_S: f64 = 1.0;

/// Numbers of the adaptive drive.
#[derive(Clone, Copy, Debug)]
pub struct Tuning {
    /// Ridge against which the forecast's weights are learned, half windows^2.
    pub ridge: f64,
    /// Seconds for which the forecast remembers.
    pub forget_s: f64,
    /// Seconds for which the forecast's errors are remembered.
    pub error_s: f64,
    /// Error that is expected of a forecast six ticks ahead, half windows.
    pub first_error: f64,
    /// Factor on the measured errors, and the least that is believed, half windows.
    pub doubt: f64,
    /// See `doubt`.
    pub least_deviation: f64,
    /// Rate at which speed is worth as much as acceleration, Hz.
    pub drag_hz: f64,
    /// Weight of jerk, of an excess over the window now, and later.
    pub jerk: f64,
    /// See `jerk`.
    pub rho_now: f64,
    /// See `jerk`.
    pub rho: f64,
    /// Seconds after which a foreseen excess counts e times less.
    pub option_s: f64,
    /// Speed at which the window ahead is half as wide, half windows to a tick.
    pub lead_speed: f64,
    /// Share of the window that the plan counts on later.
    pub later: f64,
}

impl Default for Tuning {
    fn default() -> Self {
        Self {
            ridge: 0.00003,
            forget_s: 45.0,
            error_s: 0.37,
            first_error: 0.56,
            doubt: 0.347,
            least_deviation: 0.16,
            drag_hz: 0.495,
            jerk: 0.0145,
            rho_now: 0.0152,
            rho: 0.119,
            option_s: 0.119,
            lead_speed: 0.0097,
            later: 0.85,
        }
    }
}

/// Moves the virtual camera.
#[derive(Clone, Debug)]
pub struct Smoother {
    params: Params,
    tuning: Tuning,
    /// Strength as it is, on its way to the one that is wanted.
    strength: f64,
    /// Whether a stream has begun.
    begun: bool,
    channels: [Channel; 4],
}

#[derive(Clone, Debug)]
struct Channel {
    /// The camera's place.
    camera: f64,
    /// The virtual camera's.
    place: f64,
    /// `None` until it is needed.
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
            drive: adaptive::Drive::new(),
            driven: false,
            filter: iir::LowPass::default(),
            gain: 1.0,
        };
        Self {
            params: *params,
            tuning: *tuning,
            strength: params.strength,
            begun: false,
            channels: [channel(), channel(), channel(), channel()],
        }
    }

    /// Takes new settings; what changes glides.
    pub fn set_params(&mut self, params: &Params) {
        self.params = *params;
    }

    /// A stream begins: the next path is followed from where it is.
    pub fn begin(&mut self) {
        self.begun = false;
        self.strength = self.params.strength;
    }

    /// The correction that the frame before got.
    pub fn correction(&self) -> Pose {
        if self.begun { std::array::from_fn(|c| self.channels[c].correction()) } else { [0.0; 4] }
    }

    /// The virtual camera's place after `interval_s` seconds in which the camera went to `camera`, inside of `room`.
    pub fn step(&mut self, camera: Pose, interval_s: f64, room: &Room) -> Pose {
        if !self.begun {
            self.begun = true;
            for (channel, camera) in self.channels.iter_mut().zip(camera) {
                channel.follow(camera);
            }
            return camera;
        }
        let interval_s = interval_s.clamp(0.0, 10.0);
        let goal = self.params.strength.clamp(0.0, 1.0);
        self.strength += (goal - self.strength).clamp(-interval_s / STRENGTH_S, interval_s / STRENGTH_S);
        for c in ORDER {
            let half = room.half()[c] * SHARE[c] * self.strength;
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
                    Mode::Adaptive => channel.drive(&self.tuning, interval_s, half, now, later),
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

    fn drive(&mut self, tuning: &Tuning, interval_s: f64, half: f64, now: [f64; 2], later: [f64; 2]) {
        if !self.driven {
            self.drive.begin(tuning, self.camera, self.place, interval_s, half);
            self.driven = true;
        }
        self.place = self.drive.step(tuning, self.camera, interval_s, half, now, later.map(|edge| tuning.later * edge));
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
