//! The warp's loop for AVX2: sixteen pixels at a time, shuffled out of the two or three rows that they touch.
//!
//! Eight neighbours on a line that is not much longer than they are lie within sixteen bytes of each row, and, where the line is not
//! too steep, within three rows. So nothing is gathered: each half of a register loads its own sixteen bytes.

use std::arch::x86_64::*;

use super::{Cells, HALF_STEP, is_inside, scalar};
use crate::image::PlaneRef;

/// Pixels at a time.
const BLOCK: usize = 16;
/// The largest step along x: eight pixels then span no more than fifteen bytes, their right neighbours included.
const LONGEST: i32 = 7 << 14;
/// The largest step along y, either way: eight pixels then touch three rows at most.
const STEEPEST: i32 = (1 << 16) / 8;
/// Bytes that are loaded from the first one of eight pixels on.
const LOAD: i64 = 16;

/// Draws a row as [`super::row`] does.
#[target_feature(enable = "avx2")]
pub fn row(plane: PlaneRef<'_>, cells: Cells<'_>, out: &mut [u8]) {
    let Cells { start: [xs, ys], step: [dxs, dys], wide } = cells;
    let lines = xs.iter().zip(ys).zip(dxs.iter().zip(dys)).map(|((&x, &y), (&dx, &dy))| ([x, y], [dx, dy]));
    for ((start, step), out) in lines.zip(out.chunks_mut(wide)) {
        let whole = if fits(plane, start, step, out.len()) { out.len() / BLOCK * BLOCK } else { 0 };
        for (n, out) in out[..whole].as_chunks_mut::<BLOCK>().0.iter_mut().enumerate() {
            let from = |axis: usize| start[axis].wrapping_add(step[axis].wrapping_mul((n * BLOCK) as i32));
            // SAFETY: `fits` said that every pixel of the line lies inside the plane, that the line is as flat as `block` needs,
            // and that sixteen bytes from any of its pixels, up to two rows further down, lie in the plane's samples.
            unsafe { block(plane, [from(0).wrapping_add(HALF_STEP), from(1)], step, out) };
        }
        scalar(plane, start, step, out, whole);
    }
}

/// Whether a line of `count` pixels can be drawn in blocks.
#[inline(always)]
fn fits(plane: PlaneRef<'_>, start: [i32; 2], [dx, dy]: [i32; 2], count: usize) -> bool {
    if !(0..=LONGEST).contains(&dx) || dy.abs() > STEEPEST || !is_inside(plane, start, [dx, dy], count) {
        return false;
    }
    let end = |start: i32, step: i32| (i64::from(start) + i64::from(step) * (count as i64 - 1)) >> 16;
    let lowest = end(start[1], dy).max(i64::from(start[1] >> 16)) + 2;
    let rightmost = end(start[0].wrapping_add(HALF_STEP), dx);
    lowest * plane.stride() as i64 + rightmost + LOAD <= plane.samples().len() as i64
}

/// Draws sixteen pixels.
///
/// # Safety
/// All of them lie inside the plane; the steps are within [`LONGEST`] (and not negative) and [`STEEPEST`]; from each pixel, and
/// from the pixels one and two rows below it, [`LOAD`] bytes can be read.
#[target_feature(enable = "avx2")]
#[inline]
unsafe fn block(plane: PlaneRef<'_>, [x, y]: [i32; 2], [dx, dy]: [i32; 2], out: &mut [u8; BLOCK]) {
    let stride = plane.stride();
    // where each half begins: leftmost byte, upper row
    let (x8, y7, y8, y15) = (x + 8 * dx, y + 7 * dy, y + 8 * dy, y + 15 * dy);
    let rows = [y.min(y7) >> 16, y8.min(y15) >> 16];
    let level = y.max(y7) >> 16 == rows[0] && y8.max(y15) >> 16 == rows[1];
    let at = [rows[0] as usize * stride + (x >> 16) as usize, rows[1] as usize * stride + (x8 >> 16) as usize];
    // SAFETY: the caller's promise.
    let load = |down: usize| unsafe {
        let half = |i: usize| _mm_loadu_si128(plane.samples().as_ptr().add(at[i] + down * stride).cast());
        _mm256_set_m128i(half(1), half(0))
    };
    // an order that packing puts right
    let (first, second) = (_mm256_setr_epi32(0, 1, 2, 3, 8, 9, 10, 11), _mm256_setr_epi32(4, 5, 6, 7, 12, 13, 14, 15));
    let along = |start: i32, step: i32| {
        let (start, step) = (_mm256_set1_epi32(start), _mm256_set1_epi32(step));
        [first, second].map(|n| _mm256_add_epi32(start, _mm256_mullo_epi32(n, step)))
    };
    let [xa, xb] = along(x, dx);
    // columns from each half's first one on, 7 bits of fraction
    let origin = _mm256_slli_epi32::<16>(_mm256_srai_epi32::<16>(_mm256_shuffle_epi32::<0>(xa)));
    let place = |x: __m256i| _mm256_srai_epi32::<9>(_mm256_sub_epi32(x, origin));
    let columns = _mm256_packs_epi32(place(xa), place(xb));
    let fraction = _mm256_and_si256(columns, _mm256_set1_epi16(127));
    // bytes (128 - fraction, fraction) of each pixel
    let weights = _mm256_add_epi16(_mm256_sub_epi16(_mm256_slli_epi16::<8>(fraction), fraction), _mm256_set1_epi16(128));
    // bytes (column, column + 1) of each pixel
    let column = _mm256_srli_epi16::<7>(columns);
    let pairs = _mm256_add_epi16(_mm256_or_si256(column, _mm256_slli_epi16::<8>(column)), _mm256_set1_epi16(256));
    let sign = _mm256_set1_epi8(-128);
    let mix = |samples: __m256i| _mm256_maddubs_epi16(weights, _mm256_xor_si256(_mm256_shuffle_epi8(samples, pairs), sign));
    let [ya, yb] = along(y, dy);
    let part = |y: __m256i| _mm256_srli_epi32::<1>(_mm256_and_si256(y, _mm256_set1_epi32(0xffff)));
    let part = _mm256_packs_epi32(part(ya), part(yb));
    let (upper, middle) = (mix(load(0)), mix(load(1)));
    let (top, bottom) = if level {
        (upper, middle)
    } else {
        let lower = mix(load(2));
        let base = _mm256_set_m128i(_mm_set1_epi32(rows[1]), _mm_set1_epi32(rows[0]));
        let below = |y: __m256i| _mm256_cmpgt_epi32(_mm256_srai_epi32::<16>(y), base);
        let below = _mm256_packs_epi32(below(ya), below(yb));
        (_mm256_blendv_epi8(upper, middle, below), _mm256_blendv_epi8(middle, lower, below))
    };
    let mixed = _mm256_add_epi16(top, _mm256_mulhrs_epi16(_mm256_sub_epi16(bottom, top), part));
    let rounded = _mm256_srai_epi16::<7>(_mm256_add_epi16(mixed, _mm256_set1_epi16(64)));
    let bytes = _mm_packs_epi16(_mm256_castsi256_si128(rounded), _mm256_extracti128_si256::<1>(rounded));
    let bytes = _mm_xor_si128(bytes, _mm_set1_epi8(-128));
    // SAFETY: `out` has sixteen bytes.
    unsafe { _mm_storeu_si128(out.as_mut_ptr().cast(), bytes) };
}
