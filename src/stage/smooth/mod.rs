//! The virtual camera's path.
//!
//! Two drives say where it wants to go: the paper's low-pass ([`Mode::Iir`]) and one that uses the crop window for standing still
//! ([`Mode::Adaptive`]). Both are pushed by the window's edges, in the same way: softly, from some way off, and against motion
//! outwards alone, so that the virtual camera yields to the camera and is never thrown back. All in seconds, in steps far finer
//! than a frame, so that the rate of the frames changes little.

mod adaptive;
mod iir;

use std::f64::consts::TAU;

use super::crop::Room;
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

/// Longest step, seconds.
const STEP_S: f64 = 0.0085;
/// Part of the window that yaw and pitch, roll and zoom may take.
const SHARE: Pose = [1.0, 1.0, 0.4, 0.25];
/// The order of the channels: what turns takes its part of the window first, the rest is for yaw and pitch.
const ORDER: [usize; 4] = [3, 2, 0, 1];
/// Share of the window from which its edge pushes the speed, the seconds ahead it looks and in which it does so, and the part of
/// the push that lasts.
const SOFT: f64 = 0.876;
const SOFT_AHEAD_S: f64 = 0.032;
const SOFT_S: f64 = 0.291;
const SOFT_LASTS: f64 = 0.695;
/// Share of the window from which its edge carries the place along, until at 1 nothing goes farther out.
const FIRM: f64 = 0.802;
/// Part of that speed that lasts, per second.
const FIRM_LASTS: f64 = 0.105 / 0.033;
/// Part of the window that is never used: what the window's description leaves out.
const SPARE: f64 = 0.005;
/// Seconds in which strength goes from 0 to 1.
const STRENGTH_S: f64 = 1.0;

/// Moves the virtual camera.
#[derive(Clone, Debug)]
pub struct Smoother {
    params: Params,
    /// Strength as it is, on its way to the one that is wanted.
    strength: f64,
    state: Option<[Channel; 4]>,
}

#[derive(Clone, Copy, Debug, Default)]
struct Channel {
    /// The camera's place.
    camera: f64,
    /// The virtual camera's.
    place: f64,
    /// Its speed, units / second.
    speed: f64,
    drive: adaptive::Drive,
}

impl Smoother {
    /// A virtual camera that has seen nothing.
    pub fn new(params: &Params) -> Self {
        Self { params: *params, strength: params.strength, state: None }
    }

    /// Takes new settings; what changes glides.
    pub fn set_params(&mut self, params: &Params) {
        self.params = *params;
    }

    /// A stream begins: the next path is followed from where it is.
    pub fn begin(&mut self) {
        self.state = None;
        self.strength = self.params.strength;
    }

    /// The correction that the frame before got.
    pub fn correction(&self) -> Pose {
        self.state.map_or([0.0; 4], |state| state.map(|channel| channel.place - channel.camera))
    }

    /// The virtual camera's place after `interval_s` seconds in which the camera went to `camera`, inside of `room`.
    pub fn step(&mut self, camera: Pose, interval_s: f64, room: &Room) -> Pose {
        let Some(state) = &mut self.state else {
            let at = |camera| Channel { camera, place: camera, speed: 0.0, drive: adaptive::Drive::at(camera) };
            self.state = Some(camera.map(at));
            return camera;
        };
        let interval_s = interval_s.clamp(0.0, 10.0);
        let steps = (interval_s / STEP_S).ceil().max(1.0);
        let h = interval_s / steps;
        let before = state.map(|channel| channel.camera);
        let slope: Pose = std::array::from_fn(|c| if interval_s > 0.0 { (camera[c] - before[c]) / interval_s } else { 0.0 });
        for k in 1..=steps as usize {
            let goal = self.params.strength.clamp(0.0, 1.0);
            self.strength += (goal - self.strength).clamp(-h / STRENGTH_S, h / STRENGTH_S);
            for c in ORDER {
                let window = allowed(room, c, state, self.strength);
                let half = room.half()[c] * SHARE[c] * self.strength;
                let now = before[c] + slope[c] * h * k as f64;
                state[c].step(&self.params, now, slope[c], half, window, h);
            }
        }
        for c in ORDER {
            state[c].camera = camera[c];
            let [low, high] = allowed(room, c, state, self.strength);
            let channel = &mut state[c];
            channel.place = camera[c] + (channel.place - camera[c]).clamp(low, high);
        }
        state.map(|channel| channel.place)
    }
}

/// The least and the most that channel `c` may correct, the others as they are.
fn allowed(room: &Room, c: usize, state: &[Channel; 4], strength: f64) -> [f64; 2] {
    let mut correction = state.map(|channel| channel.place - channel.camera);
    if SHARE[c] < 1.0 {
        (correction[0], correction[1]) = (0.0, 0.0);
    }
    let whole = strength * (1.0 - SPARE);
    let most = if SHARE[c] < 1.0 { SHARE[c] * room.half()[c] } else { f64::INFINITY };
    let [low, high] = room.of(c, &correction);
    [low.max(-most) * whole, high.min(most) * whole]
}

impl Channel {
    /// `h` seconds in which the camera came to `camera` at `slope` units / second; `half` is half of the window, `window` what
    /// the correction may be.
    fn step(&mut self, params: &Params, camera: f64, slope: f64, half: f64, window: [f64; 2], h: f64) {
        let from = self.place;
        if !half.is_finite() || half <= 0.0 {
            // a channel that moves nothing, or no window at all
            (self.camera, self.place, self.speed) = (camera, camera, 0.0);
            self.drive = adaptive::Drive::at(camera);
            return;
        }
        match params.mode {
            Mode::Adaptive => {
                [self.place, self.speed] = self.drive.step([self.place, self.speed], camera, half, h);
            }
            Mode::Iir => {
                let filter = iir::LowPass { input: self.camera, output: self.place, speed: self.speed };
                let after = filter.after(TAU * params.cutoff_hz, camera, h);
                (self.place, self.speed) = (after.output, after.speed);
            }
        }
        self.camera = camera;
        self.push(slope, window, h);
        self.drive.went(self.place - from, half, h);
    }

    /// What the window's edges do.
    fn push(&mut self, slope: f64, [low, high]: [f64; 2], h: f64) {
        let least = (self.camera + SOFT * low - self.place) / SOFT_AHEAD_S;
        let most = (self.camera + SOFT * high - self.place) / SOFT_AHEAD_S;
        let push = (self.speed.max(least).min(most) - self.speed) * (1.0 - (-h / SOFT_S).exp());
        self.speed += SOFT_LASTS * push;
        self.place += push * h;
        let correction = self.place - self.camera;
        let outwards = slope - self.speed;
        if outwards * correction < 0.0 {
            let edge = if correction < 0.0 { low } else { high };
            let use_ = if edge == 0.0 { 1.0 } else { correction / edge };
            let firm = adaptive::smooth((use_ - FIRM) / (1.0 - FIRM));
            self.place += firm * outwards * h;
            self.speed += FIRM_LASTS * firm * outwards * h;
        }
    }
}

#[cfg(test)]
mod tests;
