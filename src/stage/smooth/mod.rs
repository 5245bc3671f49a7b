//! The virtual camera's path.
//!
//! Two drives say where it wants to go: the paper's low-pass ([`Mode::Iir`]) and one that uses the crop window for standing still
//! ([`Mode::Adaptive`]). Where the window does not hold what the low-pass wants, all of it is made smaller, and slowly grows back;
//! what stands still is pushed along by the window's edges, against motion outwards alone, so that it yields to the camera and is
//! never thrown back. All in seconds, in steps far finer than a frame, so that the rate of the frames changes little.

mod adaptive;
mod iir;

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

/// Longest step, seconds.
const STEP_S: f64 = 0.0085;
/// The order of the channels: what turns takes its part of the window first, the rest is for yaw and pitch.
const ORDER: [usize; 4] = [3, 2, 0, 1];
/// The way to the camera is never covered faster than in so many seconds, pushed or not.
const CATCH_UP_S: f64 = 0.05;
/// Seconds in which a place that had to be set back has gained the speed for it.
const HARD_S: f64 = 1.0 / 30.0;
/// Share of the window from which its edge pushes the speed.
const SOFT: f64 = 0.97;
/// Seconds ahead that it looks.
const SOFT_AHEAD_S: f64 = 0.01;
/// Seconds in which it pushes.
const SOFT_S: f64 = 0.669;
/// Part of that push that lasts.
const SOFT_LASTS: f64 = 0.675;
/// Share of the window from which its edge carries the place along, until at 1 nothing goes farther out.
const FIRM: f64 = 0.955;
/// Speed that lasts of it, per second.
const FIRM_LASTS: f64 = 17.5;
/// Part of the speed that lasts where the place had to be set back.
const HARD_LASTS: f64 = 0.77;
/// Part of the window that roll may take.
const ROLL: f64 = 0.6855;
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
    /// The same in the window that its shake wants.
    inner: f64,
    /// Speed of that, units / second.
    speed: f64,
    drive: adaptive::Drive,
    /// The paper's filter, and the part of its correction that the window allows.
    filter: iir::LowPass,
    gain: f64,
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
            let at = |camera| Channel {
                camera,
                place: camera,
                inner: camera,
                speed: 0.0,
                drive: adaptive::Drive::at(camera),
                filter: iir::LowPass { input: camera, output: camera, speed: 0.0 },
                gain: 1.0,
            };
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
                let half = room.half()[c] * share(c) * self.strength;
                let now = before[c] + slope[c] * h * k as f64;
                let edges = allowed(room, c, state, self.strength, Rows::Still);
                state[c].step(&self.params, now, slope[c], half, edges, h);
            }
        }
        for c in ORDER {
            state[c].camera = camera[c];
            let [low, high] = allowed(room, c, state, self.strength, Rows::Moving);
            let channel = &mut state[c];
            let held = camera[c] + (channel.place - camera[c]).clamp(low, high);
            channel.speed += HARD_LASTS * channel.drive.wanting() * (held - channel.place) / HARD_S;
            channel.inner += (held - channel.place) * channel.drive.wanting();
            channel.place = held;
            channel.hold_back();
        }
        // the channels were set back one by one, each for what the others were: together they may still be too much
        let reach = room.reach(&state.map(|channel| channel.place - channel.camera));
        if reach > 1.0 - 0.5 * SPARE {
            for channel in state.iter_mut() {
                channel.place = channel.camera + (channel.place - channel.camera) * (1.0 - SPARE) / reach;
            }
        }
        state.map(|channel| channel.place)
    }
}

/// The part of the window that channel `c` may take.
fn share(c: usize) -> f64 {
    [1.0, 1.0, ROLL, 0.25][c]
}

/// The least and the most that channel `c` may correct, the others as they are.
fn allowed(room: &Room, c: usize, state: &[Channel; 4], strength: f64, rows: Rows) -> [f64; 2] {
    let mut correction = state.map(|channel| channel.place - channel.camera);
    if share(c) < 1.0 {
        (correction[0], correction[1]) = (0.0, 0.0);
    }
    let whole = strength * (1.0 - SPARE);
    let most = if share(c) < 1.0 { share(c) * room.half()[c] } else { f64::INFINITY };
    let [low, high] = room.of(c, &correction, rows);
    [low.max(-most) * whole, high.min(most) * whole]
}

impl Channel {
    /// `h` seconds in which the camera came to `camera` at `slope` units / second; `half` is half of the window, `window` what
    /// the correction may be.
    fn step(&mut self, params: &Params, camera: f64, slope: f64, half: f64, window: [f64; 2], h: f64) {
        let from = self.inner;
        if !half.is_finite() || half <= 0.0 {
            // a channel that moves nothing, or no window at all
            (self.camera, self.place, self.inner, self.speed) = (camera, camera, camera, 0.0);
            self.drive = adaptive::Drive::at(camera);
            self.filter = iir::LowPass { input: camera, output: camera, speed: 0.0 };
            return;
        }
        match params.mode {
            Mode::Adaptive => {
                let wide = self.drive.wanting();
                [self.inner, self.speed] = self.drive.step([self.inner, self.speed], camera, half * wide, h);
                self.camera = camera;
                let driven = self.inner;
                self.push(slope, window.map(|edge| edge * wide), h);
                self.drive.went(self.inner - from, self.inner - driven, half * wide, h);
                self.place = camera + (self.inner - camera) / wide;
                self.filter = iir::LowPass { input: camera, output: self.place, speed: self.speed };
            }
            Mode::Iir => {
                self.filter = self.filter.after(TAU * params.cutoff_hz, camera, h);
                self.camera = camera;
                let wanted = self.filter.output - camera;
                let edge = if wanted < 0.0 { -window[0] } else { window[1] };
                self.gain = iir::gain(self.gain, wanted.abs(), edge, h);
                self.place = camera + self.gain * wanted;
                self.drive = adaptive::Drive::at(camera);
                self.inner = self.place;
            }
        }
    }

    /// What the window's edges do.
    fn push(&mut self, slope: f64, [low, high]: [f64; 2], h: f64) {
        let least = (self.camera + SOFT * low - self.inner) / SOFT_AHEAD_S;
        let most = (self.camera + SOFT * high - self.inner) / SOFT_AHEAD_S;
        let push = (self.speed.max(least).min(most) - self.speed) * (1.0 - (-h / SOFT_S).exp());
        self.speed += SOFT_LASTS * push;
        self.inner += push * h;
        let correction = self.inner - self.camera;
        let outwards = slope - self.speed;
        if outwards * correction < 0.0 {
            let edge = if correction < 0.0 { low } else { high };
            let use_ = if edge == 0.0 { 1.0 } else { correction / edge };
            let firm = adaptive::smooth((use_ - FIRM) / (1.0 - FIRM));
            // no farther than back to where its edge begins
            let most = correction.abs() - FIRM * edge.abs();
            let way = (firm * outwards * h).clamp(-most.max(0.0), most.max(0.0));
            self.inner += way;
            self.speed += FIRM_LASTS * way;
        }
        self.hold_back();
    }

    /// However hard the edges pushed, the camera may stop now: no speed that would carry past it before it is braked.
    fn hold_back(&mut self) {
        let way = self.camera - self.inner;
        if self.speed * way > 0.0 {
            self.speed = self.speed.clamp(-way.abs() / CATCH_UP_S, way.abs() / CATCH_UP_S);
        }
    }
}

#[cfg(test)]
mod tests;
