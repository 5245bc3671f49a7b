//! Raw bytes to planes and back: unpacking, thinning of chroma, packing. Whole numbers only; halves round up.
//!
//! "Half as many" chroma samples are averages of the two (or four) they replace, rounded, halves up. Where a picture has an odd
//! number of rows or columns, the last chroma sample averages those that there are.

mod chroma;
mod pack;
mod packed;
mod range;
mod rgb;

#[cfg(test)]
mod tests;

pub(crate) use chroma::{interleaved, thin, to_420, widen};
pub use pack::{PackError, pack};
pub use packed::{LumaFirst, packed_422};
pub(crate) use range::{to_full, to_limited, to_limited_in_place};
pub use rgb::{RgbOrder, rgb};

/// The chroma value of grey.
pub const NEUTRAL: u8 = 128;

/// Mean of two samples, a half rounded up.
#[inline(always)]
fn mean(a: u8, b: u8) -> u8 {
    ((u16::from(a) + u16::from(b) + 1) >> 1) as u8
}

/// Mean of four samples, a half rounded up.
#[inline(always)]
fn mean4(a: u8, b: u8, c: u8, d: u8) -> u8 {
    ((u16::from(a) + u16::from(b) + u16::from(c) + u16::from(d) + 2) >> 2) as u8
}
