//! Sixteen pixels from four by four neighbours each: [`super::super::cubic`], in the same steps.

use std::arch::x86_64::*;

use crate::kernel::warp::cubic::{ALONG, DOWN};

/// Weights of four neighbours (16 bits each) for places `t` (1/32768, below 1) past the second; they sum up to `sum`.
#[target_feature(enable = "avx2")]
#[inline]
fn weights(t: __m256i, sum: i32) -> [__m256i; 4] {
    let sum = _mm256_set1_epi16(sum as i16);
    let square = _mm256_mulhrs_epi16(t, t);
    let cube = _mm256_mulhrs_epi16(square, t);
    let bulge = _mm256_sub_epi16(square, cube);
    let first = _mm256_sub_epi16(square, _mm256_avg_epu16(t, cube));
    let halves = _mm256_add_epi16(_mm256_srli_epi16::<1>(t), _mm256_srli_epi16::<1>(cube));
    let third = _mm256_adds_epi16(halves, _mm256_add_epi16(bulge, bulge));
    let fourth = _mm256_srai_epi16::<1>(_mm256_sub_epi16(cube, square));
    let [first, third, fourth] = [first, third, fourth].map(|weight| _mm256_mulhrs_epi16(weight, sum));
    let second = _mm256_sub_epi16(_mm256_sub_epi16(sum, first), _mm256_add_epi16(third, fourth));
    [first, second, third, fourth]
}

/// What a row shows at sixteen places (1/4096 of a column from each octet's second byte on), in 1/112 grey levels.
#[target_feature(enable = "avx2")]
#[inline]
fn along(x: __m256i) -> impl Fn(__m256i) -> __m256i {
    let fraction = _mm256_and_si256(_mm256_srli_epi16::<5>(x), _mm256_set1_epi16(127));
    let [first, second, third, fourth] = weights(_mm256_slli_epi16::<8>(fraction), ALONG);
    // two weights to a pixel's two bytes
    let bytes = |low: __m256i, high: __m256i| {
        _mm256_or_si256(_mm256_and_si256(low, _mm256_set1_epi16(0xff)), _mm256_slli_epi16::<8>(high))
    };
    let (left, right) = (bytes(first, second), bytes(third, fourth));
    // the two bytes after the first two
    let pairs = super::pairs(x);
    let others = _mm256_add_epi16(pairs, _mm256_set1_epi16(0x0202));
    move |samples| {
        let left = _mm256_maddubs_epi16(_mm256_shuffle_epi8(samples, pairs), left);
        _mm256_add_epi16(left, _mm256_maddubs_epi16(_mm256_shuffle_epi8(samples, others), right))
    }
}

/// Mixes four rows; `y` in 1/4096 from the second to the third, below 4096.
#[target_feature(enable = "avx2")]
#[inline]
pub(super) fn mix(x: __m256i, y: __m256i, rows: [__m256i; 4]) -> __m128i {
    let along = along(x);
    finish(rows.map(along), y)
}

/// Mixes the first four or the last four rows, as `y` says.
#[target_feature(enable = "avx2")]
#[inline]
pub(super) fn mix_steep(x: __m256i, y: __m256i, rows: [__m256i; 5]) -> __m128i {
    let along = along(x);
    let [a, b, c, d, e] = rows.map(along);
    let below = _mm256_cmpgt_epi16(y, _mm256_set1_epi16(4095));
    let either = |upper: __m256i, lower: __m256i| _mm256_blendv_epi8(upper, lower, below);
    let part = _mm256_and_si256(y, _mm256_set1_epi16(4095));
    finish([either(a, b), either(b, c), either(c, d), either(d, e)], part)
}

/// From four rows' values at each pixel's column to bytes.
#[target_feature(enable = "avx2")]
#[inline]
fn finish(rows: [__m256i; 4], y: __m256i) -> __m128i {
    let down = weights(_mm256_slli_epi16::<3>(y), DOWN);
    let [a, b, c, d] = std::array::from_fn(|i| _mm256_mulhrs_epi16(rows[i], down[i]));
    let mean = _mm256_add_epi16(_mm256_add_epi16(a, b), _mm256_add_epi16(c, d));
    // the rounded product with 512 is the rounded 64th
    let rounded = _mm256_mulhrs_epi16(mean, _mm256_set1_epi16(512));
    _mm_packus_epi16(_mm256_castsi256_si128(rounded), _mm256_extracti128_si256::<1>(rounded))
}
