//! The virtual camera's drive of its own: the [`Forecast`] says where the camera will be, the [`plan`] how to move so that the crop window
//! holds it with as little acceleration as can be.
//!
//! Two things are taken from what the camera did of late. Whether it fits in the window: then the virtual camera would rather stand, else
//! go along. And whether it was foreseen: then little distance is kept from the window's edge, else more.

use super::Tuning;
use super::forecast::Forecast;
use super::plan::{self, Ahead, Motion};
use crate::geometry::hypot;

/// After a push, the way to the camera is not covered faster than in so many ticks.
const CATCH_UP_TICKS: f64 = 2.0;

/// Rate at which speed is worth as much as acceleration where one place is to be held, Hz.
const TRIPOD_HZ: f64 = 30.0;

/// One channel of the virtual camera.
#[derive(Clone, Debug, Default)]
pub struct Controller {
    /// In the path's units, and ticks.
    motion: Motion,
    /// The same at the step before.
    before: Motion,
    /// Length of these ticks, seconds.
    tick_s: f64,
}

/// What a step is made in.
#[derive(Clone, Copy, Debug)]
pub struct StepInput {
    /// The camera's place.
    pub camera: f64,
    /// Seconds since the step before.
    pub interval_s: f64,
    /// Seconds for which the camera's path from here on is known.
    pub known_s: f64,
    /// The largest correction: the unit of the plan.
    pub limit: f64,
    /// Least and most correction.
    pub now: [f64; 2],
    /// The same later, as far as is known.
    pub later: [f64; 2],
    /// How much the virtual camera would rather hold its place than follow, 0 to 1.
    pub hold: f64,
}

impl Controller {
    /// The virtual camera stands at `place`.
    pub fn begin(&mut self, place: f64) {
        *self = Self { motion: Motion { place, ticks: 1.0, ..Motion::default() }, ..Self::default() };
    }

    /// The virtual camera's place.
    pub fn step(&mut self, tuning: &Tuning, forecast: &Forecast, at: &StepInput) -> f64 {
        let StepInput { camera, interval_s, limit, now, .. } = *at;
        self.keep_time(forecast.tick_s(), interval_s);
        self.before = self.motion;
        let ticks = interval_s / self.tick_s;
        let ahead = outlook(tuning, forecast, at);
        let Motion { place, speed, acceleration, ticks: before } = self.motion;
        let motion =
            Motion { place: (place - camera) / limit, speed: speed / limit, acceleration: acceleration / limit, ticks: before };
        let planned = camera + limit * plan::next(tuning, &motion, ticks, &ahead);
        let place = camera + (planned - camera).clamp(now[0], now[1]);
        let mut speed = (place - self.motion.place) / ticks;
        if place != planned {
            speed = limited_speed(speed, camera - place);
        }
        let acceleration = (speed - self.motion.speed) / (0.5 * (ticks + before));
        self.motion = Motion { place, speed, acceleration, ticks };
        place
    }

    /// The virtual camera had to be set back by `shift`, while the camera is at `camera`; it goes on at the speed that this gave it.
    pub fn was_set_back(&mut self, shift: f64, camera: f64) {
        self.motion.place += shift;
        if shift != 0.0 {
            self.motion.speed = limited_speed(self.motion.speed + shift / self.motion.ticks, camera - self.motion.place);
        }
    }

    /// A step without a plan: [`Controller::blend`] says all of it.
    pub fn wait(&mut self, forecast: &Forecast, interval_s: f64) {
        self.keep_time(forecast.tick_s(), interval_s);
        self.before = self.motion;
        self.motion.ticks = interval_s / self.tick_s;
    }

    /// How it moved before the last step.
    pub fn before(&self) -> Motion {
        self.before
    }

    /// Ticks of the last step.
    pub fn ticks(&self) -> f64 {
        self.motion.ticks
    }

    /// Goes the part `share` of the way from where the last step led to `place`, to which the virtual camera would have been `held` back
    /// by the window. Gives its place.
    pub fn blend(&mut self, share: f64, place: f64, held: bool, camera: f64) -> f64 {
        let (Motion { ticks, .. }, before) = (self.motion, self.before);
        let mut speed = (place - before.place) / ticks;
        if held {
            speed = limited_speed(speed, camera - place);
        }
        self.motion.place += share * (place - self.motion.place);
        self.motion.speed += share * (speed - self.motion.speed);
        self.motion.acceleration = (self.motion.speed - before.speed) / (0.5 * (ticks + before.ticks));
        self.motion.place
    }

    /// Takes ticks of the length that the forecast has now.
    fn keep_time(&mut self, tick_s: f64, interval_s: f64) {
        if self.tick_s == 0.0 {
            self.motion.ticks = interval_s / tick_s;
        } else if self.tick_s != tick_s {
            let longer = tick_s / self.tick_s;
            self.motion.speed *= longer;
            self.motion.acceleration *= longer * longer;
            self.motion.ticks /= longer;
        }
        self.tick_s = tick_s;
    }
}

/// What a plan is made against, in units of the largest correction.
pub fn outlook(tuning: &Tuning, forecast: &Forecast, at: &StepInput) -> Ahead {
    let StepInput { camera, known_s, limit, later, hold, .. } = *at;
    let tick_s = forecast.tick_s();
    let unpredictable = part(forecast.forecast_error() / limit, tuning.foreseen_to, tuning.unforeseen_from);
    let between = |a: f64, b: f64| a + unpredictable * (b - a);
    let doubt = between(tuning.doubt, tuning.doubt_unforeseen);
    let share = between(tuning.later, tuning.later_unforeseen);
    let share = share + hold * (1.0 - share);
    let mut ahead = Ahead {
        later: later.map(|edge| share * edge / limit),
        known: later.map(|edge| tuning.known * edge / limit),
        tick_s,
        known_s,
        drag_hz: drag_hz(tuning, 0.5 * forecast.range(tuning.hold_s) / limit, hold),
        ..Ahead::default()
    };
    for (i, (place, deviation)) in ahead.camera.iter_mut().zip(&mut ahead.deviation).enumerate().skip(1) {
        let seconds = i as f64 * tick_s - known_s;
        let (expected, error) = forecast.at(seconds);
        *place = (expected - camera) / limit;
        let believed = doubt * hypot(error / limit, tuning.least_deviation);
        *deviation = if seconds <= 0.0 { plan::KNOWN } else { believed };
    }
    ahead
}

/// How much the virtual camera would rather stand, where what the camera did of late takes `range` windows: shake about a place
/// that fits is not worth a step; a camera that goes elsewhere is followed. The more so, the more (0 to 1) it is to `hold` its place.
fn drag_hz(tuning: &Tuning, range: f64, hold: f64) -> f64 {
    let follow = part(range, tuning.hold_to, tuning.follow_from) * (1.0 - hold);
    tuning.hold_hz * (tuning.follow_hz / tuning.hold_hz).powf(follow) * (TRIPOD_HZ / tuning.hold_hz).powf(hold)
}

/// How far `value` is on its way from `none`, or less, to `all`, or more: 0 to 1.
fn part(value: f64, none: f64, all: f64) -> f64 {
    ((value - none) / (all - none)).clamp(0.0, 1.0)
}

/// However hard the edge of the window pushed, the camera may stop now: no speed that would carry past it before it is braked.
fn limited_speed(speed: f64, way: f64) -> f64 {
    let most = way.abs() / CATCH_UP_TICKS;
    if speed * way > 0.0 { speed.clamp(-most, most) } else { speed }
}
