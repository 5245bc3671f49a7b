//! The warp's loop for AVX2: eight pixels at a time, their neighbours gathered. The same bits as the scalar loop.

use std::arch::x86_64::*;

use super::Line;
use crate::image::PlaneRef;

/// Draws whole eights of `out` along `line`, which must lie inside the plane; gives how many pixels were drawn. What is left, and
/// a line that comes too near to the plane's last sample for gathering four bytes at a time, is the scalar loop's.
#[target_feature(enable = "avx2")]
#[inline]
pub fn inside(plane: PlaneRef<'_>, line: Line, out: &mut [u8]) -> usize {
    let (samples, stride) = (plane.samples(), plane.stride());
    let count = out.len() & !7;
    if count == 0 || stride > i32::MAX as usize || samples.len() > i32::MAX as usize {
        return 0;
    }
    // the furthest sample that either end of the line touches, and with it every point between
    let end = |start: i32, step: i32| (i64::from(start).max(i64::from(start) + i64::from(step) * (out.len() as i64 - 1))) >> 16;
    let furthest = (end(line.start[1], line.step[1]) as usize + 1) * stride + end(line.start[0], line.step[0]) as usize + 4;
    if furthest > samples.len() {
        return 0;
    }
    let lanes = _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7);
    let along =
        |start: i32, step: i32| _mm256_add_epi32(_mm256_set1_epi32(start), _mm256_mullo_epi32(lanes, _mm256_set1_epi32(step)));
    let (mut x, mut y) = (along(line.start[0], line.step[0]), along(line.start[1], line.step[1]));
    let (eight_x, eight_y) = (_mm256_set1_epi32(line.step[0].wrapping_mul(8)), _mm256_set1_epi32(line.step[1].wrapping_mul(8)));
    let (stride_lanes, byte) = (_mm256_set1_epi32(stride as i32), _mm256_set1_epi32(255));
    let (one, half) = (_mm256_set1_epi32(256), _mm256_set1_epi32(1 << 15));
    // byte 0 of each lane to its low half, byte 1 to its high half
    let spread = _mm256_setr_epi8(
        0, -1, 1, -1, 4, -1, 5, -1, 8, -1, 9, -1, 12, -1, 13, -1, 0, -1, 1, -1, 4, -1, 5, -1, 8, -1, 9, -1, 12, -1, 13, -1,
    );
    for eight in out[..count].chunks_exact_mut(8) {
        let at = _mm256_add_epi32(_mm256_mullo_epi32(_mm256_srai_epi32(y, 16), stride_lanes), _mm256_srai_epi32(x, 16));
        // SAFETY: the caller's line lies inside the plane, so every `at` is at least 0; the check above says that four bytes from
        // the largest `at` on, one row further down, still lie in `samples`.
        let (above, below) = unsafe {
            (
                _mm256_i32gather_epi32::<1>(samples.as_ptr().cast(), at),
                _mm256_i32gather_epi32::<1>(samples.as_ptr().add(stride).cast(), at),
            )
        };
        let fx = _mm256_and_si256(_mm256_srai_epi32(x, 8), byte);
        let fy = _mm256_and_si256(_mm256_srai_epi32(y, 8), byte);
        let weights = _mm256_or_si256(_mm256_sub_epi32(one, fx), _mm256_slli_epi32(fx, 16));
        let top = _mm256_madd_epi16(_mm256_shuffle_epi8(above, spread), weights);
        let bottom = _mm256_madd_epi16(_mm256_shuffle_epi8(below, spread), weights);
        let mixed = _mm256_add_epi32(_mm256_slli_epi32(top, 8), _mm256_mullo_epi32(_mm256_sub_epi32(bottom, top), fy));
        let rounded = _mm256_srai_epi32(_mm256_add_epi32(mixed, half), 16);
        let words = _mm256_packus_epi32(rounded, rounded);
        let bytes = _mm256_packus_epi16(words, words);
        let low = _mm_cvtsi128_si32(_mm256_castsi256_si128(bytes));
        let high = _mm_cvtsi128_si32(_mm256_extracti128_si256::<1>(bytes));
        eight[..4].copy_from_slice(&low.to_le_bytes());
        eight[4..].copy_from_slice(&high.to_le_bytes());
        x = _mm256_add_epi32(x, eight_x);
        y = _mm256_add_epi32(y, eight_y);
    }
    count
}
