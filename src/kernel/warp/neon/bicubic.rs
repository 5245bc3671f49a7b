//! Sixteen pixels from four by four neighbours each, as two octets: [`super::super::cubic`], in the same steps.
//!
//! `vqrdmulh` is its rounded product of two numbers in 1/32768, but for -1 times -1, which does not come: no weight is that low.

use std::arch::aarch64::*;

use super::Pair;
use crate::kernel::warp::cubic::{ALONG, DOWN};

/// Weights of four neighbours for places `t` (1/32768, below 1) past the second; they sum up to `sum`.
#[target_feature(enable = "neon")]
#[inline]
fn weights(t: int16x8_t, sum: i32) -> [int16x8_t; 4] {
    let sum = vdupq_n_s16(sum as i16);
    let square = vqrdmulhq_s16(t, t);
    let cube = vqrdmulhq_s16(square, t);
    let bulge = vsubq_s16(square, cube);
    let first = vsubq_s16(square, vrhaddq_s16(t, cube));
    let halves = vaddq_s16(vshrq_n_s16::<1>(t), vshrq_n_s16::<1>(cube));
    let third = vqaddq_s16(halves, vaddq_s16(bulge, bulge));
    let fourth = vshrq_n_s16::<1>(vsubq_s16(cube, square));
    let [first, third, fourth] = [first, third, fourth].map(|weight| vqrdmulhq_s16(weight, sum));
    let second = vsubq_s16(vsubq_s16(sum, first), vaddq_s16(third, fourth));
    [first, second, third, fourth]
}

/// What a row shows at eight places (1/4096 of a column from the octet's second byte on), in 1/112 grey levels.
#[target_feature(enable = "neon")]
#[inline]
fn along(x: uint16x8_t) -> impl Fn(uint8x16_t) -> int16x8_t {
    let fraction = vandq_u16(vshrq_n_u16::<5>(x), vdupq_n_u16(127));
    let [first, second, third, fourth] = weights(vreinterpretq_s16_u16(vshlq_n_u16::<8>(fraction)), ALONG);
    // the outer ones are never above 0, the inner ones never below
    let bytes = |weight: int16x8_t| vmovn_u16(vreinterpretq_u16_s16(weight));
    let (second, third) = (bytes(second), bytes(third));
    let (first, fourth) = (bytes(vnegq_s16(first)), bytes(vnegq_s16(fourth)));
    let column = vmovn_u16(vshrq_n_u16::<12>(x));
    let columns = [0, 1, 2, 3].map(|n| vadd_u8(column, vdup_n_u8(n)));
    move |samples| {
        let [a, b, c, d] = columns.map(|column| vqtbl1_u8(samples, column));
        let sum = vmlal_u8(vmull_u8(b, second), c, third);
        vreinterpretq_s16_u16(vmlsl_u8(vmlsl_u8(sum, a, first), d, fourth))
    }
}

/// Mixes four rows of each plane; `y` in 1/4096 from the second to the third, below 4096.
#[target_feature(enable = "neon")]
#[inline]
pub(super) fn mix<const N: usize>(x: [uint16x8_t; 2], y: [int16x8_t; 2], planes: [[Pair; 4]; N]) -> [uint8x16_t; N] {
    let along = [along(x[0]), along(x[1])];
    let down = y.map(|y| weights(vshlq_n_s16::<3>(y), DOWN));
    planes.map(|rows| {
        let [first, second] = [0, 1].map(|o| mean(rows.map(|row| along[o](row[o])), down[o]));
        finish(first, second)
    })
}

/// Mixes the first four or the last four rows, as `y` says.
#[target_feature(enable = "neon")]
#[inline]
pub(super) fn mix_steep<const N: usize>(x: [uint16x8_t; 2], y: [int16x8_t; 2], planes: [[Pair; 5]; N]) -> [uint8x16_t; N] {
    let along = [along(x[0]), along(x[1])];
    let below = y.map(|y| vcgtq_s16(y, vdupq_n_s16(4095)));
    let down = y.map(|y| weights(vshlq_n_s16::<3>(vandq_s16(y, vdupq_n_s16(4095))), DOWN));
    planes.map(|rows| {
        let [first, second] = [0, 1].map(|o| {
            let [a, b, c, d, e] = rows.map(|row| along[o](row[o]));
            let either = |upper, lower| vbslq_s16(below[o], lower, upper);
            mean([either(a, b), either(b, c), either(c, d), either(d, e)], down[o])
        });
        finish(first, second)
    })
}

/// From four rows' values at each pixel's column to 64 times the grey level.
#[target_feature(enable = "neon")]
#[inline]
fn mean(rows: [int16x8_t; 4], down: [int16x8_t; 4]) -> int16x8_t {
    let [a, b, c, d] = std::array::from_fn(|i| vqrdmulhq_s16(rows[i], down[i]));
    vaddq_s16(vaddq_s16(a, b), vaddq_s16(c, d))
}

/// From 64 times the grey level to bytes.
#[target_feature(enable = "neon")]
#[inline]
fn finish(first: int16x8_t, second: int16x8_t) -> uint8x16_t {
    vqrshrun_high_n_s16::<6>(vqrshrun_n_s16::<6>(first), second)
}
