//! Sixteen pixels from two by two neighbours each.

use std::arch::x86_64::*;

/// What a row shows at sixteen places (1/4096 of a column from each octet's first byte on), negated, in 1/128 grey levels: weights then fit
/// signed bytes, and samples need not.
#[target_feature(enable = "avx2")]
#[inline]
fn along(x: __m256i) -> impl Fn(__m256i) -> __m256i {
    let fraction = _mm256_and_si256(_mm256_srli_epi16::<5>(x), _mm256_set1_epi16(127));
    // bytes (fraction - 128, -fraction) of each pixel
    let weights = _mm256_sub_epi16(_mm256_set1_epi16(128), _mm256_mullo_epi16(fraction, _mm256_set1_epi16(255)));
    let pairs = super::pairs(x);
    move |samples| _mm256_maddubs_epi16(_mm256_shuffle_epi8(samples, pairs), weights)
}

/// Mixes two rows; `y` in 1/4096 from the upper to the lower, below 4096.
#[target_feature(enable = "avx2")]
#[inline]
pub(super) fn mix(x: __m256i, y: __m256i, rows: [__m256i; 2]) -> __m128i {
    let along = along(x);
    finish(along(rows[0]), along(rows[1]), y)
}

/// Mixes the first and second or the second and third row, as `y` says.
#[target_feature(enable = "avx2")]
#[inline]
pub(super) fn mix_steep(x: __m256i, y: __m256i, rows: [__m256i; 3]) -> __m128i {
    let along = along(x);
    let [upper, middle, lower] = [along(rows[0]), along(rows[1]), along(rows[2])];
    let below = _mm256_cmpgt_epi16(y, _mm256_set1_epi16(4095));
    let part = _mm256_and_si256(y, _mm256_set1_epi16(4095));
    finish(_mm256_blendv_epi8(upper, middle, below), _mm256_blendv_epi8(middle, lower, below), part)
}

/// From two rows' negated values at each pixel's column to bytes.
#[target_feature(enable = "avx2")]
#[inline]
fn finish(top: __m256i, bottom: __m256i, y: __m256i) -> __m128i {
    let down = _mm256_mulhrs_epi16(_mm256_sub_epi16(top, bottom), _mm256_slli_epi16::<3>(y));
    // the rounded product with 256 is the rounded 128th
    let rounded = _mm256_mulhrs_epi16(_mm256_sub_epi16(down, top), _mm256_set1_epi16(256));
    _mm_packus_epi16(_mm256_castsi256_si128(rounded), _mm256_extracti128_si256::<1>(rounded))
}
