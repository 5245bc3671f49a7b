//! Sixteen pixels from two by two neighbours each, as two octets.

use std::arch::aarch64::*;

use super::Pair;

/// What a row shows at eight places (1/4096 of a column from the octet's first byte on), in 1/128 grey levels.
#[target_feature(enable = "neon")]
#[inline]
fn along(x: uint16x8_t) -> impl Fn(uint8x16_t) -> int16x8_t {
    let right = vand_u8(vshrn_n_u16::<5>(x), vdup_n_u8(127));
    let left = vsub_u8(vdup_n_u8(128), right);
    let column = vmovn_u16(vshrq_n_u16::<12>(x));
    let next = vadd_u8(column, vdup_n_u8(1));
    move |samples| {
        let sum = vmull_u8(vqtbl1_u8(samples, column), left);
        vreinterpretq_s16_u16(vmlal_u8(sum, vqtbl1_u8(samples, next), right))
    }
}

/// Mixes two rows of each plane; `y` in 1/4096 from the upper to the lower, below 4096.
#[target_feature(enable = "neon")]
#[inline]
pub(super) fn mix<const N: usize>(x: [uint16x8_t; 2], y: [int16x8_t; 2], planes: [[Pair; 2]; N]) -> [uint8x16_t; N] {
    let along = [along(x[0]), along(x[1])];
    let parts = y.map(|y| vshlq_n_s16::<3>(y));
    planes.map(|[top, bottom]| {
        let [first, second] = [0, 1].map(|o| between(along[o](top[o]), along[o](bottom[o]), parts[o]));
        finish(first, second)
    })
}

/// Mixes the first and second or the second and third row, as `y` says.
#[target_feature(enable = "neon")]
#[inline]
pub(super) fn mix_steep<const N: usize>(x: [uint16x8_t; 2], y: [int16x8_t; 2], planes: [[Pair; 3]; N]) -> [uint8x16_t; N] {
    let along = [along(x[0]), along(x[1])];
    let below = y.map(|y| vcgtq_s16(y, vdupq_n_s16(4095)));
    let parts = y.map(|y| vshlq_n_s16::<3>(vandq_s16(y, vdupq_n_s16(4095))));
    planes.map(|rows| {
        let [first, second] = [0, 1].map(|o| {
            let [upper, middle, lower] = rows.map(|row| along[o](row[o]));
            between(vbslq_s16(below[o], middle, upper), vbslq_s16(below[o], lower, middle), parts[o])
        });
        finish(first, second)
    })
}

/// A share (1/32768) of the way from the upper row to the lower.
#[target_feature(enable = "neon")]
#[inline]
fn between(top: int16x8_t, bottom: int16x8_t, part: int16x8_t) -> int16x8_t {
    vaddq_s16(top, vqrdmulhq_s16(vsubq_s16(bottom, top), part))
}

/// From 1/128 grey levels to bytes.
#[target_feature(enable = "neon")]
#[inline]
fn finish(first: int16x8_t, second: int16x8_t) -> uint8x16_t {
    vqrshrun_high_n_s16::<7>(vqrshrun_n_s16::<7>(first), second)
}
