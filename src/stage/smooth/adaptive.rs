//! The virtual camera's drive of its own: the [`Forecast`] says where the camera will be, the [`plan`] how to move so that the crop window
//! holds it with as little acceleration as can be.

use super::Tuning;
use super::forecast::Forecast;
use super::plan::{self, Ahead, Motion};

/// Least length of a tick, seconds: frames that come faster are taken several at a time.
const LEAST_TICK_S: f64 = 0.8 / 30.0;
/// Factor by which the frames' interval may be off the ticks' before these are chosen anew.
const OFF: f64 = 1.3;

/// After a push, the way to the camera is not covered faster than in so many ticks.
const CATCH_UP_TICKS: f64 = 2.0;

/// One channel of the virtual camera.
#[derive(Clone, Debug)]
pub struct Drive {
    forecast: Forecast,
    /// In the path's units, and ticks.
    motion: Motion,
    /// Frames to a tick, and its length in seconds.
    frames: f64,
    tick_s: f64,
}

impl Drive {
    /// Knows nothing; to begin before it steps.
    pub fn new() -> Self {
        Self { forecast: Forecast::new(), motion: Motion::default(), frames: 1.0, tick_s: 1.0 }
    }

    /// The camera is at `camera`, the virtual camera at `place`, frames come every `interval_s`; `half` is half of the crop window.
    pub fn begin(&mut self, tuning: &Tuning, camera: f64, place: f64, interval_s: f64, half: f64) {
        self.frames = (LEAST_TICK_S / interval_s).ceil().max(1.0);
        self.tick_s = self.frames * interval_s;
        self.forecast.begin(tuning, camera, half);
        self.motion = Motion { place, ticks: 1.0 / self.frames, ..Motion::default() };
    }

    /// The virtual camera's place `interval_s` seconds on, when the camera is at `camera`; half of the window is `half`, the correction
    /// may be `now` and, as far as is known, `later`.
    pub fn step(&mut self, tuning: &Tuning, camera: f64, interval_s: f64, half: f64, now: [f64; 2], later: [f64; 2]) -> f64 {
        self.keep_time(tuning, camera, interval_s, half);
        let ticks = interval_s / self.tick_s;
        let expected = self.forecast.step(tuning, camera, ticks, self.tick_s, half);
        let deviations = self.forecast.deviations();
        let believed = |deviation: f64| tuning.doubt * (deviation / half).hypot(tuning.least_deviation);
        let ahead = Ahead {
            camera: std::array::from_fn(|i| if i == 0 { 0.0 } else { expected[i - 1] / half }),
            deviation: std::array::from_fn(|i| if i == 0 { plan::NOW } else { believed(deviations[i - 1]) }),
            now: now.map(|edge| edge / half),
            later: later.map(|edge| edge / half),
            tick_s: self.tick_s,
        };
        let Motion { place, speed, acceleration, ticks: before } = self.motion;
        let motion =
            Motion { place: (place - camera) / half, speed: speed / half, acceleration: acceleration / half, ticks: before };
        let planned = camera + half * plan::next(tuning, &motion, ticks, &ahead);
        let place = camera + (planned - camera).clamp(now[0], now[1]);
        let mut speed = (place - self.motion.place) / ticks;
        if place != planned {
            speed = held_back(speed, camera - place);
        }
        let acceleration = (speed - self.motion.speed) / (0.5 * (ticks + before));
        self.motion = Motion { place, speed, acceleration, ticks };
        place
    }

    /// The virtual camera had to be set back by `slip`, while the camera is at `camera`; it goes on at the speed that this gave it.
    pub fn slipped(&mut self, slip: f64, camera: f64) {
        self.motion.place += slip;
        if slip != 0.0 {
            self.motion.speed = held_back(self.motion.speed + slip / self.motion.ticks, camera - self.motion.place);
        }
    }

    /// Chooses ticks of another length where the rate of the frames has changed.
    fn keep_time(&mut self, tuning: &Tuning, camera: f64, interval_s: f64, half: f64) {
        let off = interval_s * self.frames / self.tick_s;
        if !(1.0 / OFF..OFF).contains(&off) {
            let motion = self.motion;
            let before_s = self.tick_s;
            self.begin(tuning, camera, motion.place, interval_s, half);
            let longer = self.tick_s / before_s;
            (self.motion.speed, self.motion.acceleration) = (motion.speed * longer, motion.acceleration * longer * longer);
        }
    }
}

/// However hard the edge of the window pushed, the camera may stop now: no speed that would carry past it before it is braked.
fn held_back(speed: f64, way: f64) -> f64 {
    let most = way.abs() / CATCH_UP_TICKS;
    if speed * way > 0.0 { speed.clamp(-most, most) } else { speed }
}
