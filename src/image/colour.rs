//! What samples mean: their range, the matrix between RGB and luma with chroma, and where chroma lies.
//!
//! Inside gimbald every picture has one meaning: BT.601, limited range (luma 16 to 235, chroma 16 to 240). It is the only one that every
//! reader of a virtual camera or of a y4m file takes for granted: v4l2loopback 0.13 to 0.15 pass no range on, and where no matrix is named
//! ffmpeg, GStreamer and browsers take BT.601 for V4L2's sRGB cameras. Cameras' JPEG and RGB have full range; they are brought to
//! limited range where they are unpacked, and nothing behind that point needs to ask. What sinks write is labelled with
//! [`Colour::inside`].

use super::PixelFormat;

/// The numbers that black and white have in luma.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Range {
    /// Nothing said; see [`Range::of`].
    #[default]
    Unknown,
    /// 16 to 235.
    Limited,
    /// 0 to 255.
    Full,
}

impl Range {
    /// The range of `pixel`'s samples where `self` is what was said of it: JPEG (JFIF) and RGB are full unless it is said otherwise, all
    /// others limited. Never [`Range::Unknown`].
    pub fn of(self, pixel: PixelFormat) -> Self {
        match self {
            Self::Unknown if pixel.is_compressed() || pixel.is_rgb() => Self::Full,
            Self::Unknown => Self::Limited,
            said => said,
        }
    }
}

/// Where a 4:2:0 chroma sample lies among its four luma samples.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Siting {
    /// In their middle, as JPEG and MPEG-1 have it; also where nothing is said.
    #[default]
    Centre,
    /// Midway between the left two, as MPEG-2 and H.264 have it.
    Left,
    /// On the top-left one (PAL-DV puts it so, U and V on alternate rows; taken as one).
    TopLeft,
}

/// What a stream says of its samples' meaning; carried from source to sink.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Colour {
    /// Range of the samples.
    pub range: Range,
    /// Place of 4:2:0 chroma.
    pub siting: Siting,
}

impl Colour {
    /// The meaning of the pictures that frames of `pixel` become, `self` being what is said of the frames: limited range, unless nothing
    /// was said and nothing had to be done.
    pub fn inside(self, pixel: PixelFormat) -> Self {
        let unsaid = self.range == Range::Unknown && self.range.of(pixel) == Range::Limited;
        Self { range: if unsaid { Range::Unknown } else { Range::Limited }, ..self }
    }
}

/// Black: luma, and both of chroma.
pub const BLACK: [u8; 2] = [16, 128];

/// Black and white in luma.
const LUMA: [f64; 2] = [16.0, 235.0];
/// From the least to the greatest of chroma.
const CHROMA_SPAN: f64 = 224.0;
/// Chroma of grey.
const GREY: f64 = 128.0;

/// Shares of red and blue in luma, ITU-R BT.601; the rest is green's.
const RED: f64 = 0.299;
const BLUE: f64 = 0.114;

/// A sample `n` of full range becomes `base + (gain n + offset) / 255`, rounded down: the nearest to the exact value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ToLimited {
    /// At most 255, as is `n`; `gain n + offset` fits 16 bits.
    pub gain: u16,
    /// At most 510.
    pub offset: u16,
    /// Least value.
    pub base: u8,
}

impl ToLimited {
    /// Luma: 16 + 219/255 n.
    pub const LUMA: Self = Self { gain: 219, offset: 127, base: 16 };
    /// Chroma: 128 + 224/255 (n - 128), that is 15 + (224 n + 143)/255.
    pub const CHROMA: Self = Self { gain: 224, offset: 143 + 127, base: 15 };
}

/// A sample of limited range becomes the nearest of full range to `gain (n - zero) / span + zero_full`, kept within 0 to 255: the
/// inverse of [`ToLimited`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ToFull {
    /// Steps of limited range that 255 steps of full range have.
    span: i32,
    /// The sample that stays where it is, or becomes 0.
    zero: i32,
    /// What it becomes.
    zero_full: i32,
}

impl ToFull {
    /// Luma: 255/219 (n - 16).
    pub const LUMA: Self = Self { span: 219, zero: 16, zero_full: 0 };
    /// Chroma: 128 + 255/224 (n - 128).
    pub const CHROMA: Self = Self { span: 224, zero: 128, zero_full: 128 };

    /// The sample of full range.
    pub fn apply(self, sample: u8) -> u8 {
        let scaled = 255 * (i32::from(sample) - self.zero);
        // Halves away from zero.
        let rounded = (scaled + scaled.signum() * self.span / 2) / self.span;
        (rounded + self.zero_full).clamp(0, 255) as u8
    }
}

/// Weights of R, G, B in luma and in each of chroma, and what is added: in 1/256 of a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FromRgb {
    /// Y, U, V: weights of R, G, B.
    pub weights: [[i32; 3]; 3],
    /// What is added to Y; U and V get 128 steps.
    pub black: i32,
}

impl FromRgb {
    /// From samples of `range`, which is full unless it is said to be limited.
    pub fn new(range: Range) -> Self {
        let (luma, black) = match range {
            Range::Limited => (1.0, 0.0),
            Range::Full | Range::Unknown => ((LUMA[1] - LUMA[0]) / 255.0, LUMA[0]),
        };
        let chroma = luma * CHROMA_SPAN / (LUMA[1] - LUMA[0]);
        let green = 1.0 - RED - BLUE;
        let weights = |gain: f64, rgb: [f64; 3]| rgb.map(|weight| (256.0 * gain * weight).round() as i32);
        Self {
            weights: [
                weights(luma, [RED, green, BLUE]),
                weights(chroma / (2.0 * (1.0 - BLUE)), [-RED, -green, 1.0 - BLUE]),
                weights(chroma / (2.0 * (1.0 - RED)), [1.0 - RED, -green, -BLUE]),
            ],
            black: (256.0 * black) as i32,
        }
    }
}

/// The colour (R, G, B, 0 to 255) of luma and chroma as pictures have them inside.
pub fn rgb([y, u, v]: [u8; 3]) -> [u8; 3] {
    let luma = (f64::from(y) - LUMA[0]) * 255.0 / (LUMA[1] - LUMA[0]);
    let [u, v] = [u, v].map(|chroma| (f64::from(chroma) - GREY) * 2.0 * 255.0 / CHROMA_SPAN);
    let (red, blue) = (luma + (1.0 - RED) * v, luma + (1.0 - BLUE) * u);
    let green = (luma - RED * red - BLUE * blue) / (1.0 - RED - BLUE);
    [red, green, blue].map(|value| value.round().clamp(0.0, 255.0) as u8)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn full_range_becomes_the_nearest_limited_value() {
        for n in 0..=255u8 {
            let apply = |map: ToLimited| map.base + ((u32::from(map.gain) * u32::from(n) + u32::from(map.offset)) / 255) as u8;
            assert_eq!(f64::from(apply(ToLimited::LUMA)), (16.0 + 219.0 / 255.0 * f64::from(n)).round(), "luma {n}");
            let chroma = 128.0 + 224.0 / 255.0 * (f64::from(n) - 128.0);
            assert!((f64::from(apply(ToLimited::CHROMA)) - chroma).abs() <= 0.51, "chroma {n}");
        }
    }

    #[test]
    fn limited_range_becomes_the_nearest_full_value_and_back() {
        for n in 0..=255u8 {
            let exact = (255.0 / 219.0 * (f64::from(n) - 16.0)).clamp(0.0, 255.0);
            assert!((f64::from(ToFull::LUMA.apply(n)) - exact).abs() <= 0.51, "luma {n}");
            let exact = (128.0 + 255.0 / 224.0 * (f64::from(n) - 128.0)).clamp(0.0, 255.0);
            assert!((f64::from(ToFull::CHROMA.apply(n)) - exact).abs() <= 0.51, "chroma {n}");
        }
        let limited =
            |map: ToLimited, n: u8| map.base + ((u32::from(map.gain) * u32::from(n) + u32::from(map.offset)) / 255) as u8;
        assert!((16..=235).all(|n| limited(ToLimited::LUMA, ToFull::LUMA.apply(n)) == n));
        assert!((16..=240).all(|n| limited(ToLimited::CHROMA, ToFull::CHROMA.apply(n)) == n));
    }

    #[test]
    fn weights_are_those_of_the_standard() {
        let full = FromRgb::new(Range::Full);
        assert_eq!(full.weights, [[66, 129, 25], [-38, -74, 112], [112, -94, -18]]);
        let limited = FromRgb::new(Range::Limited);
        assert_eq!((limited.weights[0].iter().sum::<i32>(), limited.black), (256, 0));
    }

    #[test]
    fn colours_go_there_and_back() {
        for range in [Range::Full, Range::Limited] {
            let FromRgb { weights, black } = FromRgb::new(range);
            for colour in 0..8u8 {
                let bits = [0, 1, 2].map(|bit| if colour >> bit & 1 == 1 { 255u8 } else { 0 });
                let given = bits.map(|value| match range {
                    Range::Limited => {
                        if value == 255 {
                            235
                        } else {
                            16
                        }
                    }
                    _ => i32::from(value),
                });
                let sum = |n: usize| weights[n].iter().zip(given).map(|(weight, value)| weight * value).sum::<i32>();
                let yuv = [sum(0) + black, sum(1) + (128 << 8), sum(2) + (128 << 8)].map(|value| ((value + 128) >> 8) as u8);
                for (back, want) in rgb(yuv).into_iter().zip(bits) {
                    assert!(back.abs_diff(want) <= 2, "{range:?}: {bits:?} becomes {yuv:?} and that {:?}", rgb(yuv));
                }
            }
        }
    }

    #[test]
    fn what_is_said_of_a_stream() {
        let said = |range, pixel| Colour { range, siting: Siting::Left }.inside(pixel);
        for (range, pixel, becomes) in [
            (Range::Full, PixelFormat::I420, Range::Limited),
            (Range::Unknown, PixelFormat::I420, Range::Unknown),
            (Range::Unknown, PixelFormat::Mjpeg, Range::Limited),
            (Range::Unknown, PixelFormat::Rgb24, Range::Limited),
            (Range::Limited, PixelFormat::Rgb24, Range::Limited),
        ] {
            assert_eq!(said(range, pixel), Colour { range: becomes, siting: Siting::Left }, "{range:?} {pixel}");
        }
    }
}
