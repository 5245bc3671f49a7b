//! The virtual camera's drive of its own: stands still for as long as the crop window allows, then follows.
//!
//! Each channel of the path is looked at against its share of the crop window. While the camera's low-passed place is within
//! [`STILL`] of the middle, nothing pulls: a camera that shakes about a place is held perfectly still. Farther out a spring sets
//! in. Whoever pans pushes the window's edge along, always the same way; that is noticed ([`Drive::strain`]), and the virtual
//! camera then follows the camera's own place closely instead of its low-passed one. It never goes faster than it can still stop
//! in, so that nothing overshoots, and nothing is pulled back after.

use std::f64::consts::TAU;

/// The numbers, found by search.
#[derive(Clone, Copy, Debug)]
#[allow(missing_docs, reason = "being tuned")]
pub struct Tuning(pub [f64; 25]);
impl Tuning {
    pub const NAMES: [&str; 25] = [
        "calm_hz",
        "pan_hz",
        "still",
        "pull",
        "pull_power",
        "pan_still",
        "pan_pull",
        "fade_s",
        "arrive_held_s",
        "arrive_pan_s",
        "brake_s",
        "return_hz",
        "strain_s",
        "strain_pan",
        "soft",
        "soft_ahead_s",
        "soft_s",
        "soft_lasts",
        "firm",
        "firm_lasts",
        "hard_lasts",
        "roll",
        "overload_s",
        "overload",
        "over_from",
    ];
    pub fn calm_hz(&self) -> f64 {
        self.0[0]
    }
    pub fn pan_hz(&self) -> f64 {
        self.0[1]
    }
    pub fn still(&self) -> f64 {
        self.0[2]
    }
    pub fn pull(&self) -> f64 {
        self.0[3]
    }
    pub fn pull_power(&self) -> f64 {
        self.0[4]
    }
    pub fn pan_still(&self) -> f64 {
        self.0[5]
    }
    pub fn pan_pull(&self) -> f64 {
        self.0[6]
    }
    pub fn fade_s(&self) -> f64 {
        self.0[7]
    }
    pub fn arrive_held_s(&self) -> f64 {
        self.0[8]
    }
    pub fn arrive_pan_s(&self) -> f64 {
        self.0[9]
    }
    pub fn brake_s(&self) -> f64 {
        self.0[10]
    }
    pub fn return_hz(&self) -> f64 {
        self.0[11]
    }
    pub fn strain_s(&self) -> f64 {
        self.0[12]
    }
    pub fn strain_pan(&self) -> f64 {
        self.0[13]
    }
    pub fn soft(&self) -> f64 {
        self.0[14]
    }
    pub fn soft_ahead_s(&self) -> f64 {
        self.0[15]
    }
    pub fn soft_s(&self) -> f64 {
        self.0[16]
    }
    pub fn soft_lasts(&self) -> f64 {
        self.0[17]
    }
    pub fn firm(&self) -> f64 {
        self.0[18]
    }
    pub fn firm_lasts(&self) -> f64 {
        self.0[19]
    }
    pub fn hard_lasts(&self) -> f64 {
        self.0[20]
    }
    pub fn roll(&self) -> f64 {
        self.0[21]
    }
    pub fn overload_s(&self) -> f64 {
        self.0[22]
    }
    pub fn overload(&self) -> f64 {
        self.0[23]
    }
    pub fn over_from(&self) -> f64 {
        self.0[24]
    }
}
impl Default for Tuning {
    fn default() -> Self {
        Self([
            0.6584, 12.0, 0.8975, 25.5861, 1.8388, 0.0827, 28.1337, 0.5867, 0.021, 0.0756, 0.0247, 0.002, 0.1604, 0.6829,
            0.8878, 0.012, 0.1386, 0.7057, 0.8942, 3.8167, 0.9268, 0.7, 1.0, 4.0, 0.3,
        ])
    }
}
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
    pub fn step(&mut self, [place, speed]: [f64; 2], camera: f64, half: f64, h: f64, t: &Tuning) -> [f64; 2] {
        self.calm.step(t.calm_hz(), camera, h);
        self.quick.step(t.pan_hz(), camera, h);
        let pan = smooth(self.strain.abs() / t.strain_pan());
        let way = self.calm.place + (self.quick.place - self.calm.place) * pan - place;
        let share = way.abs() / half;
        let mut pull = t.pull() * (share - t.still()).max(0.0).powf(t.pull_power());
        if way * self.strain > 0.0 {
            pull += pan * t.pan_pull() * (share - t.pan_still()).max(0.0);
        }
        let mut speed = (speed + (pull * half * h).copysign(way)) * (-h * (1.0 - pan) / t.fade_s()).exp();
        let along = speed * way.signum();
        let most = (share - t.pan_still()).max(0.0) * half / (t.arrive_held_s() + (t.arrive_pan_s() - t.arrive_held_s()) * pan);
        let wanted = along.clamp(0.0, most).copysign(way);
        speed += (wanted - speed) * (1.0 - (-h / t.brake_s()).exp());
        [place + (speed + TAU * t.return_hz() * way) * h, speed]
    }

    /// How many times wider the window would have to be for shake that it does not hold: 1 while it holds it, or while it is
    /// pushed one way alone.
    pub fn wanting(&self, t: &Tuning) -> f64 {
        1.0 + t.overload() * (self.pushed[0] - self.pushed[1].abs() - t.over_from()).max(0.0)
    }

    /// Takes in how far the virtual camera went, pushes included.
    pub fn went(&mut self, way: f64, pushed: f64, half: f64, h: f64, t: &Tuning) {
        let pushed = pushed / half;
        for (sum, way) in self.pushed.iter_mut().zip([pushed.abs(), pushed]) {
            *sum += way - *sum * h / t.overload_s();
        }
        self.strain += way / half - self.strain * h / t.strain_s();
    }
}

/// From 0 at 0 to 1 at 1 with no edge at either end.
pub fn smooth(x: f64) -> f64 {
    let x = x.clamp(0.0, 1.0);
    x * x * (3.0 - 2.0 * x)
}
