//! Eight pixels from two by two neighbours each.

use std::arch::aarch64::*;

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

/// Mixes two rows; `y` in 1/4096 from the upper to the lower.
#[target_feature(enable = "neon")]
#[inline]
pub(super) fn mix(x: uint16x8_t, y: int16x8_t, rows: [uint8x16_t; 2]) -> uint8x8_t {
    let [top, bottom] = rows.map(along(x));
    finish(top, bottom, y)
}

/// Mixes the first and second or the second and third row, as `y` says.
#[target_feature(enable = "neon")]
#[inline]
pub(super) fn mix_steep(x: uint16x8_t, y: int16x8_t, rows: [uint8x16_t; 3]) -> uint8x8_t {
    let [upper, middle, lower] = rows.map(along(x));
    let below = vcgtq_s16(y, vdupq_n_s16(4095));
    finish(vbslq_s16(below, middle, upper), vbslq_s16(below, lower, middle), y)
}

/// From two rows' values at each pixel's column to bytes.
#[target_feature(enable = "neon")]
#[inline]
fn finish(top: int16x8_t, bottom: int16x8_t, y: int16x8_t) -> uint8x8_t {
    let part = vshlq_n_s16::<3>(vandq_s16(y, vdupq_n_s16(4095)));
    vqrshrun_n_s16::<7>(vaddq_s16(top, vqrdmulhq_s16(vsubq_s16(bottom, top), part)))
}
