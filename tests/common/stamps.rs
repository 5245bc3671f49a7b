//! Frames of an even camera, stamped as drivers do it that stamp on arrival: late by what varies, in bursts, after stalls.

use super::{Shot, normal};
use gimbald::random::SplitMix;

/// How frames are stamped; times in milliseconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Stamped {
    Evenly,
    /// Off by a normally distributed time.
    Jitter(f64),
    /// A tenth of the frames late by up to this.
    Late(f64),
    /// So many at a time, a millisecond apart, when the last one is there.
    Bursts(u64),
    /// Each thirtieth frame waits for so long, and what came meanwhile follows a millisecond apart.
    Stalls(f64),
    /// The first time is nonsense.
    Nonsense,
    /// The clock is set back now and then.
    SetBack,
    /// Each tenth time is that of the frame before.
    Equal,
    /// From the sixtieth frame on the times are those of another clock.
    Foreign,
    /// An eighth of the frames is missing, counted or not.
    Dropped {
        counted: bool,
    },
    /// Every time is the same.
    Still,
    /// The camera halves its rate for 40 frames, and takes it up again.
    Halved,
}

/// Every kind with which pictures were seen to be thrown about, or calibration to be wrong, and milder ones.
pub const ALL: [Stamped; 20] = [
    Stamped::Evenly,
    Stamped::Jitter(1.0),
    Stamped::Jitter(3.0),
    Stamped::Jitter(8.0),
    Stamped::Late(20.0),
    Stamped::Late(40.0),
    Stamped::Bursts(2),
    Stamped::Bursts(3),
    Stamped::Bursts(5),
    Stamped::Bursts(8),
    Stamped::Stalls(50.0),
    Stamped::Stalls(166.0),
    Stamped::Stalls(500.0),
    Stamped::Nonsense,
    Stamped::SetBack,
    Stamped::Equal,
    Stamped::Foreign,
    Stamped::Dropped { counted: true },
    Stamped::Dropped { counted: false },
    Stamped::Halved,
];

/// Stamps `shots`, the frames of a camera of `fps` frames a second, and leaves out those that never came. Gives the numbers of those left.
pub fn stamp(shots: &mut Vec<Shot>, stamped: Stamped, fps: f64, seed: u64) -> Vec<u64> {
    let (ms, period_ms) = (1e6, 1e3 / fps);
    let mut random = SplitMix::new(seed);
    let (mut due_ms, mut last_ms) = (0.0_f64, 0.0_f64);
    let (mut count, mut came) = (0, Vec::new());
    for (n, mut shot) in (0u64..).zip(std::mem::take(shots)) {
        let true_ms = 50_000.0 + n as f64 * period_ms;
        let is_missing = match stamped {
            Stamped::Dropped { .. } => n > 0 && random.signed() < -0.75,
            Stamped::Halved => n / 40 % 2 == 1 && n % 2 == 1,
            _ => false,
        };
        if is_missing {
            continue;
        }
        let time_ms = match stamped {
            Stamped::Jitter(deviation_ms) => true_ms + deviation_ms * normal(&mut random),
            Stamped::Late(most_ms) if random.signed() < -0.8 => true_ms + 0.5 * most_ms * (1.0 + random.signed()),
            Stamped::Bursts(size) => true_ms + (size - 1 - n % size) as f64 * (period_ms - 1.0),
            Stamped::Stalls(stall_ms) => {
                let came_ms = true_ms + normal(&mut random);
                due_ms = if n % 30 == 29 { came_ms + stall_ms } else { due_ms };
                came_ms.max(due_ms).max(last_ms + 1.0)
            }
            Stamped::Nonsense if n == 0 => 4_154_505_010_207.0,
            Stamped::Still => 50_000.0,
            Stamped::SetBack => true_ms - 200.0 * (n / 30) as f64,
            Stamped::Equal if n % 10 == 9 => last_ms,
            Stamped::Foreign if n >= 60 => true_ms + 1.7e12,
            Stamped::Dropped { .. } => true_ms + normal(&mut random),
            _ => true_ms,
        };
        last_ms = time_ms;
        let is_counted = !matches!(stamped, Stamped::Dropped { counted: false } | Stamped::Halved);
        shot.stamp.time_ns = (ms * time_ms).round() as i64;
        shot.stamp.sequence = if is_counted { n } else { count };
        count += 1;
        came.push(n);
        shots.push(shot);
    }
    came
}
