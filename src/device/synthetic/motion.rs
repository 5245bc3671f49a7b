//! How the synthetic camera moves: smooth functions of time, known for every instant, the same for the same seed.

use crate::geometry::{PITCH, Pose, ROLL, YAW};
use crate::random::SplitMix;
use std::f64::consts::TAU;
use std::str::FromStr;

/// A manner of moving. Angles at a gain of 1.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Motion {
    /// Not at all.
    Still,
    /// Held in the hand: 0.3 to 7 Hz, 0.55 degrees RMS in yaw and pitch, 0.35 in roll; a little zoom.
    #[default]
    Handheld,
    /// Carried while walking: steps at 1.9 Hz, swaying at 0.95 Hz, hand shake on top.
    Walk,
    /// On a desk: still, but for knocks that ring at 8 to 11 Hz, and typing.
    Desk,
    /// Fast left and right: yaw of 4.5 degrees at 1.3 Hz.
    Horizontal,
    /// Fast up and down: pitch of 3.5 degrees at 1.3 Hz.
    Vertical,
    /// Hand-held, with a pan of 16 degrees within 1.6 seconds.
    Pan,
}

impl Motion {
    /// Every manner.
    pub const ALL: [Self; 7] =
        [Self::Still, Self::Handheld, Self::Walk, Self::Desk, Self::Horizontal, Self::Vertical, Self::Pan];

    /// Its name in settings.
    pub fn name(self) -> &'static str {
        match self {
            Self::Still => "still",
            Self::Handheld => "handheld",
            Self::Walk => "walk",
            Self::Desk => "desk",
            Self::Horizontal => "horizontal",
            Self::Vertical => "vertical",
            Self::Pan => "pan",
        }
    }
}

impl FromStr for Motion {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        Self::ALL.into_iter().find(|motion| motion.name() == name).ok_or_else(|| {
            let names = Self::ALL.map(Self::name).join(", ");
            format!("unknown motion {name:?}; choose one of {names}")
        })
    }
}

/// `amplitude * sin(TAU * hz * t + phase)`.
#[derive(Clone, Copy, Debug)]
struct Sine {
    amplitude: f64,
    hz: f64,
    phase: f64,
}

/// The knocks of a desk: one in every `EVERY` seconds, at its own time and of its own strength.
const EVERY: f64 = 1.8;

/// The orientation and zoom of a camera over time.
#[derive(Clone, Debug)]
pub(super) struct Path {
    motion: Motion,
    gain: f64,
    seed: u64,
    pan_start: f64,
    axes: [Vec<Sine>; 4],
}

impl Path {
    /// `duration_s` is where the clip ends, which says when a pan begins.
    pub(super) fn new(motion: Motion, gain: f64, seed: u64, duration_s: f64) -> Self {
        let mut random = SplitMix::new(seed ^ 0x6d6f_7469_6f6e);
        let mut axes: [Vec<Sine>; 4] = Default::default();
        let [yaw, pitch, roll, zoom] = &mut axes;
        let one = |degrees: f64, hz: f64, phase: f64| Sine { amplitude: degrees.to_radians(), hz, phase };
        match motion {
            Motion::Still => {}
            Motion::Handheld => {
                band(&mut random, yaw, 0.3, 7.0, 0.55_f64.to_radians());
                band(&mut random, pitch, 0.3, 7.0, 0.55_f64.to_radians());
                band(&mut random, roll, 0.3, 5.0, 0.35_f64.to_radians());
                band(&mut random, zoom, 0.3, 2.0, 0.002);
            }
            Motion::Walk => {
                pitch.extend([one(1.0, 1.9, 0.0), one(0.3, 3.8, 1.0)]);
                yaw.push(one(0.8, 0.95, 0.4));
                roll.push(one(0.5, 0.95, 0.0));
                band(&mut random, yaw, 0.3, 6.0, 0.3_f64.to_radians());
                band(&mut random, pitch, 0.3, 6.0, 0.3_f64.to_radians());
            }
            Motion::Desk => band(&mut random, pitch, 12.0, 18.0, 0.03_f64.to_radians()),
            Motion::Horizontal => yaw.push(one(4.5, 1.3, 0.0)),
            Motion::Vertical => pitch.push(one(3.5, 1.3, 0.0)),
            Motion::Pan => {
                band(&mut random, yaw, 0.4, 7.0, 0.35_f64.to_radians());
                band(&mut random, pitch, 0.4, 7.0, 0.35_f64.to_radians());
                band(&mut random, roll, 0.4, 5.0, 0.25_f64.to_radians());
            }
        }
        Self { motion, gain, seed, pan_start: 0.35 * duration_s.clamp(0.0, 6.0), axes }
    }

    /// Yaw, pitch, roll in radians and log zoom at `t` seconds.
    pub(super) fn at(&self, t: f64) -> Pose {
        let mut pose =
            Pose::from_fn(|axis| self.axes[axis].iter().map(|s| s.amplitude * (TAU * s.hz * t + s.phase).sin()).sum::<f64>());
        if self.motion == Motion::Desk {
            self.knocks(t, &mut pose);
        }
        pose = pose * self.gain;
        if self.motion == Motion::Pan {
            // What is meant is not shake: the gain leaves it alone.
            let done = ((t - self.pan_start) / 1.6).clamp(0.0, 1.0);
            pose[YAW] += (16.0 * done * done * (3.0 - 2.0 * done) - 8.0).to_radians();
        }
        pose
    }

    fn knocks(&self, t: f64, pose: &mut Pose) {
        let latest = (t / EVERY).floor();
        // A knock has died away to a hundredth within two periods.
        for n in [latest - 1.0, latest] {
            if n < 0.0 {
                continue;
            }
            let mut random = SplitMix::new(self.seed ^ (n as u64 + 1).wrapping_mul(0x6b6e_6f63_6b21));
            let since = t - (n * EVERY + random.uniform(0.1, 1.3));
            let (hz, degrees, decay) = (random.uniform(8.0, 11.0), random.uniform(0.5, 1.2), random.uniform(0.25, 0.45));
            let (yaw, roll) = (random.uniform(-0.5, 0.5), random.uniform(-0.2, 0.2));
            if since > 0.0 {
                let ring = degrees.to_radians() * (-since / decay).exp() * (TAU * hz * since).sin();
                pose[YAW] += yaw * ring;
                pose[PITCH] += ring;
                pose[ROLL] += roll * ring;
            }
        }
    }
}

/// Adds noise of the given RMS within `low` to `high` Hz: 24 sines, the slower the stronger (as 1 / sqrt f).
fn band(random: &mut SplitMix, axis: &mut Vec<Sine>, low: f64, high: f64, rms: f64) {
    const SINES: usize = 24;
    let step = (high - low) / SINES as f64;
    let first = axis.len();
    for n in 0..SINES {
        let hz = low + step * (n as f64 + random.uniform(0.0, 1.0));
        axis.push(Sine { amplitude: random.uniform(0.5, 1.5) / hz.sqrt(), hz, phase: random.uniform(0.0, TAU) });
    }
    let power: f64 = axis[first..].iter().map(|s| s.amplitude * s.amplitude / 2.0).sum();
    for sine in &mut axis[first..] {
        sine.amplitude *= rms / power.sqrt();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_and_back() {
        for motion in Motion::ALL {
            assert_eq!(motion.name().parse(), Ok(motion));
        }
        assert!("tripod".parse::<Motion>().unwrap_err().contains("still, handheld"));
    }

    #[test]
    fn hands_shake_as_much_as_they_say() {
        let path = Path::new(Motion::Handheld, 1.0, 3, 5.0);
        let mean = (0..20_000).map(|n| path.at(n as f64 * 0.01)[0].to_degrees().powi(2)).sum::<f64>() / 20_000.0;
        assert!((mean.sqrt() - 0.55).abs() < 0.03, "{}", mean.sqrt());
        assert_eq!(Path::new(Motion::Still, 1.0, 3, 5.0).at(1.0), Pose::default());
    }

    #[test]
    fn every_motion_is_smooth_and_seeded() {
        for motion in Motion::ALL {
            let path = Path::new(motion, 1.0, 5, 5.0);
            let same = Path::new(motion, 1.0, 5, 5.0);
            for n in -100..6000 {
                let t = f64::from(n) * 1e-3;
                assert_eq!(path.at(t), same.at(t));
                let (a, b) = (path.at(t), path.at(t + 1e-3));
                let fastest = (0..4).map(|axis| (b[axis] - a[axis]).abs()).fold(0.0, f64::max) * 1e3;
                assert!(fastest < 2.0, "{motion:?} turns with {fastest} rad/s at {t}");
            }
        }
    }
}
