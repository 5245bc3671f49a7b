//! Chooses among the modes that a camera offers.

use std::cmp::Reverse;

use crate::image::PixelFormat;

/// Sizes that are tried where a camera takes any size in a range.
const COMMON_SIZES: [(u32, u32); 8] =
    [(1280, 720), (1920, 1080), (640, 480), (640, 360), (800, 600), (1280, 960), (320, 240), (320, 180)];

/// What may be asked of a camera; what is `None` is chosen.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Wish {
    /// Layout of the frames.
    pub format: Option<PixelFormat>,
    /// Luma samples in a row.
    pub width: Option<u32>,
    /// Luma rows.
    pub height: Option<u32>,
    /// Frames a second.
    pub fps: Option<f64>,
}

/// One thing a camera can do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Mode {
    /// Layout of the frames.
    pub pixel: PixelFormat,
    /// The code by which the camera knows it (motion JPEG has two).
    pub fourcc: [u8; 4],
    /// Luma samples in a row.
    pub width: u32,
    /// Luma rows.
    pub height: u32,
    /// Time between frames (seconds, numerator and denominator); (0, 0) where the camera does not say.
    pub interval: (u32, u32),
}

impl Mode {
    /// Frames a second; `None` where the camera does not say.
    pub fn rate(&self) -> Option<f64> {
        rate(self.interval)
    }
}

/// The sizes of a format.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sizes {
    /// One.
    One(u32, u32),
    /// Any from the smallest to the largest, in steps (width, height).
    Range {
        /// Smallest.
        min: (u32, u32),
        /// Largest.
        max: (u32, u32),
        /// From one to the next.
        step: (u32, u32),
    },
}

impl Sizes {
    /// The sizes worth considering: each on its own; of a range the wished, the common ones and the largest.
    pub(super) fn candidates(self, wish: &Wish) -> Vec<(u32, u32)> {
        match self {
            Self::One(width, height) => vec![(width, height)],
            Self::Range { min, max, step } => {
                let on_step = |n: u32, min: u32, max: u32, step: u32| {
                    n >= min && n <= max && (step < 2 || (n - min).is_multiple_of(step))
                };
                let wished =
                    COMMON_SIZES.iter().chain([&max]).map(|&(w, h)| (wish.width.unwrap_or(w), wish.height.unwrap_or(h)));
                let mut sizes: Vec<_> =
                    wished.filter(|&(w, h)| on_step(w, min.0, max.0, step.0) && on_step(h, min.1, max.1, step.1)).collect();
                sizes.sort_unstable();
                sizes.dedup();
                sizes
            }
        }
    }
}

/// The times between frames that a size allows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Intervals {
    /// One (seconds, numerator and denominator).
    One(u32, u32),
    /// Any from the shortest to the longest.
    Range {
        /// Shortest.
        min: (u32, u32),
        /// Longest.
        max: (u32, u32),
    },
}

impl Intervals {
    /// The interval of these that comes nearest to `fps`.
    pub(super) fn nearest(self, fps: f64) -> (u32, u32) {
        match self {
            Self::One(numerator, denominator) => (numerator, denominator),
            Self::Range { min, max } => {
                let wished = interval(fps);
                let (fastest, slowest) = (rate(min).unwrap_or(f64::INFINITY), rate(max).unwrap_or(0.0));
                if fps > fastest {
                    min
                } else if fps < slowest {
                    max
                } else {
                    wished
                }
            }
        }
    }
}

/// `fps` as a time between frames, in whole milliseconds' fractions where it is not a whole number.
pub(super) fn interval(fps: f64) -> (u32, u32) {
    let whole = fps.round();
    if (fps - whole).abs() < 1e-6 {
        (1, whole.clamp(1.0, 1000.0) as u32)
    } else {
        (1000, (fps * 1000.0).round().clamp(1.0, 1e6) as u32)
    }
}

pub(super) fn rate(interval: (u32, u32)) -> Option<f64> {
    (interval.0 != 0 && interval.1 != 0).then(|| f64::from(interval.1) / f64::from(interval.0))
}

/// The frames a second that are aimed at where nothing is wished: what call apps send.
pub(super) const USUAL_FPS: f64 = 30.0;

/// The best of `modes` for `wish`; `None` where none has the wished format and size.
///
/// A wished format and size are conditions. Among what is left: first modes that are fast enough (the wished rate within 2 %; 25
/// frames a second where none is wished); then those no larger than 1280x720; of these the largest, of larger ones the smallest;
/// then the rate nearest to the wished (30 where none is); then the format that costs least to read. Where no mode is fast
/// enough, rate goes before size.
pub fn choose(modes: &[Mode], wish: &Wish) -> Option<Mode> {
    let aim = wish.fps.unwrap_or(USUAL_FPS);
    let enough = wish.fps.map_or(25.0, |fps| fps * 0.98);
    let merit = |mode: &Mode| {
        // Where the camera does not say, S_PARM will show; the doubt costs a little.
        let (fast, distance) = mode.rate().map_or((true, 1.0), |rate| (rate >= enough, (rate - aim).abs()));
        let fits = mode.width <= 1280 && mode.height <= 720;
        let area = u64::from(mode.width) * u64::from(mode.height);
        let size = if fits { i128::from(area) } else { -i128::from(area) };
        // In thousandths of a frame a second, so that 30000/1001 and 30 differ and can be ordered.
        let near = Reverse((distance * 1000.0) as u64);
        (fast, (!fast).then_some(near), fits, size, near, Reverse(cost(mode.pixel)))
    };
    modes
        .iter()
        .filter(|mode| {
            wish.format.is_none_or(|format| mode.pixel == format)
                && wish.width.is_none_or(|width| mode.width == width)
                && wish.height.is_none_or(|height| mode.height == height)
        })
        .copied()
        // The first of equals wins: a driver lists its preferred first. (max_by_key would take the last.)
        .rev()
        .max_by_key(merit)
}

/// What a format costs to read, as a rank.
fn cost(pixel: PixelFormat) -> u8 {
    match pixel {
        PixelFormat::I420 => 0,
        PixelFormat::Nv12 => 1,
        PixelFormat::Yuyv | PixelFormat::Uyvy => 2,
        PixelFormat::I422 | PixelFormat::I444 => 3,
        PixelFormat::Rgb24 | PixelFormat::Bgr24 => 4,
        PixelFormat::Mjpeg => 5,
        // Cheapest of all, but a camera that has colours is wanted for them.
        PixelFormat::Grey => 6,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mode(pixel: PixelFormat, width: u32, height: u32, fps: u32) -> Mode {
        Mode { pixel, fourcc: pixel.fourcc(), width, height, interval: (1, fps) }
    }

    /// What most webcams offer.
    fn webcam() -> Vec<Mode> {
        use PixelFormat::{Mjpeg, Yuyv};
        vec![
            mode(Yuyv, 640, 480, 30),
            mode(Yuyv, 640, 480, 15),
            mode(Yuyv, 1280, 720, 10),
            mode(Yuyv, 1920, 1080, 5),
            mode(Mjpeg, 640, 480, 30),
            mode(Mjpeg, 1280, 720, 60),
            mode(Mjpeg, 1280, 720, 30),
            mode(Mjpeg, 1920, 1080, 30),
        ]
    }

    #[test]
    fn nothing_wished_is_720p_at_30() {
        assert_eq!(choose(&webcam(), &Wish::default()), Some(mode(PixelFormat::Mjpeg, 1280, 720, 30)));
    }

    #[test]
    fn the_cheapest_of_equals() {
        let all = [PixelFormat::Grey, PixelFormat::Mjpeg, PixelFormat::Rgb24, PixelFormat::Nv12, PixelFormat::Yuyv];
        let modes = all.map(|pixel| mode(pixel, 640, 480, 30));
        assert_eq!(choose(&modes, &Wish::default()).map(|m| m.pixel), Some(PixelFormat::Nv12));
        let equal = [mode(PixelFormat::Uyvy, 640, 480, 30), mode(PixelFormat::Yuyv, 640, 480, 30)];
        assert_eq!(choose(&equal, &Wish::default()), Some(equal[0]), "the driver's first");
    }

    #[test]
    fn what_is_wished_is_had_or_nothing() {
        let yuyv = Wish { format: Some(PixelFormat::Yuyv), ..Wish::default() };
        assert_eq!(choose(&webcam(), &yuyv), Some(mode(PixelFormat::Yuyv, 640, 480, 30)));
        let large = Wish { width: Some(1920), ..yuyv };
        assert_eq!(choose(&webcam(), &large), Some(mode(PixelFormat::Yuyv, 1920, 1080, 5)), "slow, but wished");
        assert_eq!(choose(&webcam(), &Wish { height: Some(600), ..Wish::default() }), None);
        let fast = Wish { fps: Some(60.0), ..Wish::default() };
        assert_eq!(choose(&webcam(), &fast), Some(mode(PixelFormat::Mjpeg, 1280, 720, 60)));
        let slow = Wish { fps: Some(15.0), width: Some(640), ..yuyv };
        assert_eq!(choose(&webcam(), &slow), Some(mode(PixelFormat::Yuyv, 640, 480, 15)));
    }

    #[test]
    fn where_all_is_large_or_slow() {
        let large = [mode(PixelFormat::Yuyv, 3840, 2160, 30), mode(PixelFormat::Yuyv, 1920, 1080, 30)];
        assert_eq!(choose(&large, &Wish::default()), Some(large[1]), "the smallest of the large");
        let slow = [mode(PixelFormat::Yuyv, 1280, 720, 5), mode(PixelFormat::Yuyv, 640, 480, 20)];
        assert_eq!(choose(&slow, &Wish::default()), Some(slow[1]), "the fastest of the slow");
        let silent = [Mode { interval: (0, 0), ..mode(PixelFormat::Yuyv, 640, 480, 30) }];
        assert_eq!(choose(&silent, &Wish::default()), Some(silent[0]), "one that does not say how fast");
    }

    #[test]
    fn ranges() {
        let range = Sizes::Range { min: (48, 32), max: (8192, 8192), step: (1, 1) };
        assert!(range.candidates(&Wish::default()).contains(&(1280, 720)));
        let odd = Wish { width: Some(500), height: Some(400), ..Wish::default() };
        assert_eq!(range.candidates(&odd), [(500, 400)]);
        let stepped = Sizes::Range { min: (16, 16), max: (640, 480), step: (16, 16) };
        assert_eq!(stepped.candidates(&odd), [], "500 is no multiple of 16");
        let any = Intervals::Range { min: (1, 60), max: (1, 5) };
        assert_eq!([any.nearest(30.0), any.nearest(90.0), any.nearest(2.0)], [(1, 30), (1, 60), (1, 5)]);
        assert_eq!(any.nearest(29.97), (1000, 29970));
    }
}
