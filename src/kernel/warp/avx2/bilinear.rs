//! Sixteen pixels from two by two neighbours each.

use std::arch::x86_64::*;

/// What a row shows at sixteen places (1/4096 of a column from each octet's first byte on), less 128, in 1/128 grey levels.
#[target_feature(enable = "avx2")]
#[inline]
fn along(x: __m256i) -> impl Fn(__m256i) -> __m256i {
    let fraction = _mm256_and_si256(_mm256_srli_epi16::<5>(x), _mm256_set1_epi16(127));
    // bytes (128 - fraction, fraction) of each pixel
    let weights = _mm256_add_epi16(_mm256_mullo_epi16(fraction, _mm256_set1_epi16(255)), _mm256_set1_epi16(128));
    // bytes (column, column + 1) of each pixel
    let column = _mm256_mullo_epi16(_mm256_srli_epi16::<12>(x), _mm256_set1_epi16(257));
    let pairs = _mm256_add_epi16(column, _mm256_set1_epi16(256));
    let sign = _mm256_set1_epi8(-128);
    move |samples| _mm256_maddubs_epi16(weights, _mm256_xor_si256(_mm256_shuffle_epi8(samples, pairs), sign))
}

/// Mixes two rows; `y` in 1/4096 from the upper to the lower.
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
    finish(_mm256_blendv_epi8(upper, middle, below), _mm256_blendv_epi8(middle, lower, below), y)
}

/// From two rows' values at each pixel's column to bytes.
#[target_feature(enable = "avx2")]
#[inline]
fn finish(top: __m256i, bottom: __m256i, y: __m256i) -> __m128i {
    let part = _mm256_slli_epi16::<3>(_mm256_and_si256(y, _mm256_set1_epi16(4095)));
    let mixed = _mm256_add_epi16(top, _mm256_mulhrs_epi16(_mm256_sub_epi16(bottom, top), part));
    let rounded = _mm256_srai_epi16::<7>(_mm256_add_epi16(mixed, _mm256_set1_epi16(64)));
    let bytes = _mm_packs_epi16(_mm256_castsi256_si128(rounded), _mm256_extracti128_si256::<1>(rounded));
    _mm_xor_si128(bytes, _mm_set1_epi8(-128))
}
