//! The virtual camera's drive of its own: stands still for as long as the crop window allows, then follows.
//!
//! Each channel of the path is looked at against its share of the crop window. While the camera's low-passed place is within
//! [`STILL`] of the middle, nothing pulls: a camera that shakes about a place is held perfectly still. Farther out a spring sets
//! in. Whoever pans pushes the window's edge along, always the same way; that is noticed ([`Drive::strain`]), and the virtual
//! camera then follows the camera's own place closely instead of its low-passed one. It never goes faster than it can still stop
//! in, so that nothing overshoots, and nothing is pulled back after.

use std::f64::consts::TAU;

// The numbers were found by search: on paths measured in clips of shake, of walking and of a pan.
/// Low-pass of the camera's place while it is held, Hz.
const CALM_HZ: f64 = 1.2;
/// The same while it pans, Hz.
const PAN_HZ: f64 = 12.0;
/// Share of the window within which nothing pulls.
const STILL: f64 = 0.8048;
/// Pull where the share of the window is beyond that by 1, half windows / second^2.
const PULL: f64 = 19.9;
/// Its power of the share.
const PULL_POWER: f64 = 0.926;
/// Share of the window within which nothing pulls while it pans.
const PAN_STILL: f64 = 0.036;
/// Pull where the share of the window is beyond that by 1, half windows / second^2.
const PAN_PULL: f64 = 19.9;
/// Seconds in which speed fades while nothing pans.
const FADE_S: f64 = 0.669;
/// The way that is left is never covered faster than in so many seconds, held.
const ARRIVE_HELD_S: f64 = 0.0251;
/// The same, panning.
const ARRIVE_PAN_S: f64 = 0.0783;
/// Seconds in which too high a speed is braked.
const BRAKE_S: f64 = 0.01;
/// Slow return to the middle, Hz.
const RETURN_HZ: f64 = 0.0061;
/// Seconds for which the strain is remembered.
const STRAIN_S: f64 = 0.1147;
/// Way gone within that time, in half windows, that is a pan.
const STRAIN_PAN: f64 = 0.5823;
/// Seconds for which pushes are remembered.
const OVERLOAD_S: f64 = 1.361;
/// How much wider the window is wanted for each half window of way that was pushed forth and back within that time ...
const OVERLOAD: f64 = 1.969;
/// ... beyond so many.
const OVER_FROM: f64 = 0.3064;

/// What one channel remembers.
#[derive(Clone, Copy, Debug, Default)]
pub struct Drive {
    calm: Follower,
    quick: Follower,
    /// Way the virtual camera went of late, in half windows, with its sign.
    strain: f64,
    /// Way that the edges pushed it of late, in half windows: all of it, and with its sign.
    pushed: [f64; 2],
}

/// A critically damped second-order low-pass.
#[derive(Clone, Copy, Debug, Default)]
struct Follower {
    place: f64,
    speed: f64,
}

impl Follower {
    fn step(&mut self, hz: f64, input: f64, h: f64) {
        let w = TAU * hz;
        self.speed += (w * w * (input - self.place) - 2.0 * w * self.speed) * h;
        self.place += self.speed * h;
    }
}

impl Drive {
    /// At rest at `place`.
    pub fn at(place: f64) -> Self {
        let follower = Follower { place, speed: 0.0 };
        Self { calm: follower, quick: follower, strain: 0.0, pushed: [0.0; 2] }
    }

    /// The virtual camera's new (place, speed) after `h` seconds, when it was at `place` with `speed`, the camera came to `camera`
    /// and half the window is `half` wide.
    pub fn step(&mut self, [place, speed]: [f64; 2], camera: f64, half: f64, h: f64) -> [f64; 2] {
        self.calm.step(CALM_HZ, camera, h);
        self.quick.step(PAN_HZ, camera, h);
        let pan = smooth(self.strain.abs() / STRAIN_PAN);
        let way = self.calm.place + (self.quick.place - self.calm.place) * pan - place;
        let share = way.abs() / half;
        let mut pull = PULL * (share - STILL).max(0.0).powf(PULL_POWER);
        if way * self.strain > 0.0 {
            pull += pan * PAN_PULL * (share - PAN_STILL).max(0.0);
        }
        let mut speed = (speed + (pull * half * h).copysign(way)) * (-h * (1.0 - pan) / FADE_S).exp();
        let along = speed * way.signum();
        let most = (share - PAN_STILL).max(0.0) * half / (ARRIVE_HELD_S + (ARRIVE_PAN_S - ARRIVE_HELD_S) * pan);
        let wanted = along.clamp(0.0, most).copysign(way);
        speed += (wanted - speed) * (1.0 - (-h / BRAKE_S).exp());
        [place + (speed + TAU * RETURN_HZ * way) * h, speed]
    }

    /// How many times wider the window would have to be for shake that it does not hold: 1 while it holds it, or while it is
    /// pushed one way alone.
    pub fn wanting(&self) -> f64 {
        1.0 + OVERLOAD * (self.pushed[0] - self.pushed[1].abs() - OVER_FROM).max(0.0)
    }

    /// Takes in how far the virtual camera went, pushes included.
    pub fn went(&mut self, way: f64, pushed: f64, half: f64, h: f64) {
        let pushed = pushed / half;
        for (sum, way) in self.pushed.iter_mut().zip([pushed.abs(), pushed]) {
            *sum += way - *sum * h / OVERLOAD_S;
        }
        self.strain += way / half - self.strain * h / STRAIN_S;
    }
}

/// From 0 at 0 to 1 at 1 with no edge at either end.
pub fn smooth(x: f64) -> f64 {
    let x = x.clamp(0.0, 1.0);
    x * x * (3.0 - 2.0 * x)
}
