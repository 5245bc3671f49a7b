//! The patch's loops for AVX2: a row of sixteen pixels is one register. The same bits as the plain loops.
//!
//! Nothing overflows: each of a register's eight sums, over sixteen rows, stays below 2^31 for the largest values there are
//! (differences 4080, descent images 4095, gradients 4080, values 2048 from mid-grey). So does all of a patch where [`totals`] are
//! taken; elsewhere it may need more than 32 bits.

use std::arch::x86_64::*;

use super::{Compared, EIGHTH, HALF, MIDDLE, Moments, Projection, STEEPEST, Slopes, Window};

/// The patch's side.
pub(super) const SIDE: usize = 16;
const AREA: usize = SIDE * SIDE;

/// Sixteen bytes of each of `count` rows from `column` on are there to be read.
#[inline(always)]
fn check(window: Window<'_>, rows: usize, columns: usize) {
    assert!(window.samples.len() >= (rows - 1) * window.stride + columns, "a window of a patch is whole");
}

/// Sixteen samples, 1/128 grey level.
///
/// # Safety
/// There are sixteen bytes at `at`.
#[target_feature(enable = "avx2")]
#[inline]
unsafe fn load(at: *const u8) -> __m256i {
    // SAFETY: the caller's promise.
    _mm256_slli_epi16::<7>(_mm256_cvtepu8_epi16(unsafe { _mm_loadu_si128(at.cast()) }))
}

/// Sixteen numbers of a row.
#[target_feature(enable = "avx2")]
#[inline]
fn numbers(row: &[i16; SIDE]) -> __m256i {
    // SAFETY: there are sixteen of them.
    unsafe { _mm256_loadu_si256(row.as_ptr().cast()) }
}

#[target_feature(enable = "avx2")]
#[inline]
fn store(to: &mut [i16; SIDE], numbers: __m256i) {
    // SAFETY: there is room for sixteen.
    unsafe { _mm256_storeu_si256(to.as_mut_ptr().cast(), numbers) }
}

/// `from` and a share of the way to `to`.
#[target_feature(enable = "avx2")]
#[inline]
fn between(from: __m256i, to: __m256i, share: __m256i) -> __m256i {
    _mm256_add_epi16(from, _mm256_mulhrs_epi16(_mm256_sub_epi16(to, from), share))
}

/// Adds the products of two rows to sums.
#[target_feature(enable = "avx2")]
#[inline]
fn add(sums: &mut __m256i, a: __m256i, b: __m256i) {
    *sums = _mm256_add_epi32(*sums, _mm256_madd_epi16(a, b));
}

/// The totals of four registers of sums.
#[target_feature(enable = "avx2")]
#[inline]
fn totals([a, b, c, d]: [__m256i; 4]) -> [i64; 4] {
    let pairs = _mm256_hadd_epi32(_mm256_hadd_epi32(a, b), _mm256_hadd_epi32(c, d));
    let sums = _mm_add_epi32(_mm256_castsi256_si128(pairs), _mm256_extracti128_si256::<1>(pairs));
    [_mm_extract_epi32::<0>(sums), _mm_extract_epi32::<1>(sums), _mm_extract_epi32::<2>(sums), _mm_extract_epi32::<3>(sums)]
        .map(i64::from)
}

/// The rows of a patch.
#[inline(always)]
fn rows(numbers: &[i16]) -> &[[i16; SIDE]] {
    debug_assert_eq!(numbers.len(), AREA);
    &numbers.as_chunks().0[..SIDE]
}

#[inline(always)]
fn rows_mut(numbers: &mut [i16]) -> &mut [[i16; SIDE]] {
    debug_assert_eq!(numbers.len(), AREA);
    &mut numbers.as_chunks_mut().0[..SIDE]
}

/// As [`super::scalar::sample`].
#[target_feature(enable = "avx2")]
pub(super) fn sample(window: Window<'_>, value: &mut [i16], dx: &mut [i16], dy: &mut [i16]) -> Moments {
    check(window, SIDE + 3, SIDE + 3);
    let (value, dx, dy) = (rows_mut(value), rows_mut(dx), rows_mut(dy));
    let (fx, fy) = (_mm256_set1_epi16(window.x), _mm256_set1_epi16(window.y));
    let (eighth, middle, ones) = (_mm256_set1_epi16(EIGHTH), _mm256_set1_epi16(MIDDLE), _mm256_set1_epi16(1));
    // columns left of, at, and right of the patch's, between samples
    let across = |y: usize| {
        // SAFETY: `check` said that there are so many samples in so many rows.
        let at = |column: usize| unsafe { load(window.samples.as_ptr().add(y * window.stride + column)) };
        let [a, b, c, d] = [at(0), at(1), at(2), at(3)];
        [between(a, b, fx), between(b, c, fx), between(c, d, fx)]
    };
    let down = |from: &[__m256i; 3], to: &[__m256i; 3]| {
        [between(from[0], to[0], fy), between(from[1], to[1], fy), between(from[2], to[2], fy)]
    };
    let zero = _mm256_setzero_si256();
    let [mut values, mut squares, mut gradient_x, mut gradient_y, mut product_x, mut product_y] = [zero; 6];
    let (first, second, mut samples) = (across(0), across(1), across(2));
    let mut above = down(&first, &second)[1];
    let mut here = down(&second, &samples);
    for y in 0..SIDE {
        let next = across(y + 3);
        let below = down(&samples, &next);
        let [left, at, right] = here;
        let slope_x = _mm256_mulhrs_epi16(_mm256_sub_epi16(right, left), eighth);
        let slope_y = _mm256_mulhrs_epi16(_mm256_sub_epi16(below[1], above), eighth);
        store(&mut value[y], at);
        store(&mut dx[y], slope_x);
        store(&mut dy[y], slope_y);
        let less = _mm256_mulhrs_epi16(_mm256_sub_epi16(at, middle), eighth);
        add(&mut values, less, ones);
        add(&mut squares, less, less);
        add(&mut gradient_x, slope_x, ones);
        add(&mut gradient_y, slope_y, ones);
        add(&mut product_x, less, slope_x);
        add(&mut product_y, less, slope_y);
        (samples, above, here) = (next, at, below);
    }
    let [value, square, product_x, product_y] = totals([values, squares, product_x, product_y]);
    let [gradient_x, gradient_y, ..] = totals([gradient_x, gradient_y, zero, zero]);
    Moments { value, square, gradient: [gradient_x, gradient_y], product: [product_x, product_y] }
}

/// As [`super::scalar::project`].
#[target_feature(enable = "avx2")]
pub(super) fn project(projection: Projection, value: &[i16], dx: &mut [i16], dy: &mut [i16]) -> Slopes {
    let (value, dx, dy) = (rows(value), rows_mut(dx), rows_mut(dy));
    let mean_value = _mm256_set1_epi16(projection.value);
    let [mean_x, mean_y] = projection.mean.map(|mean| _mm256_set1_epi16(mean));
    let [along_x, along_y] = projection.along.map(|along| _mm256_set1_epi16(along));
    let (most, least) = (_mm256_set1_epi16(STEEPEST), _mm256_set1_epi16(-STEEPEST));
    let (half, ones) = (_mm256_set1_epi16(HALF), _mm256_set1_epi16(1));
    let columns = _mm256_setr_epi16(-8, -7, -6, -5, -4, -3, -2, -1, 0, 1, 2, 3, 4, 5, 6, 7);
    let zero = _mm256_setzero_si256();
    let [mut sum_x, mut sum_y, mut xx, mut xy, mut yy, mut moment_x, mut moment_y] = [zero; 7];
    for y in 0..SIDE {
        let less = _mm256_subs_epi16(numbers(&value[y]), mean_value);
        let rest = |slopes: &[i16; SIDE], mean: __m256i, along: __m256i| {
            let rest = _mm256_subs_epi16(_mm256_subs_epi16(numbers(slopes), mean), _mm256_mulhrs_epi16(less, along));
            _mm256_max_epi16(_mm256_min_epi16(rest, most), least)
        };
        let (rest_x, rest_y) = (rest(&dx[y], mean_x, along_x), rest(&dy[y], mean_y, along_y));
        store(&mut dx[y], rest_x);
        store(&mut dy[y], rest_y);
        add(&mut sum_x, rest_x, ones);
        add(&mut sum_y, rest_y, ones);
        let (half_x, half_y) = (_mm256_mulhrs_epi16(rest_x, half), _mm256_mulhrs_epi16(rest_y, half));
        add(&mut xx, half_x, half_x);
        add(&mut xy, half_x, half_y);
        add(&mut yy, half_y, half_y);
        let row = _mm256_set1_epi16(y as i16 - SIDE as i16 / 2);
        for half in [half_x, half_y] {
            add(&mut moment_x, half, _mm256_mullo_epi16(half, columns));
            add(&mut moment_y, half, _mm256_mullo_epi16(half, row));
        }
    }
    let [sum_x, sum_y, xy, _] = totals([sum_x, sum_y, xy, zero]);
    let [xx, yy, ..] = totals([xx, yy, zero, zero]);
    Slopes { sum: [sum_x, sum_y], product: [xx, xy, yy], moment: wide_totals([moment_x, moment_y]) }
}

/// The totals of two registers of sums, which may need more than 32 bits.
#[target_feature(enable = "avx2")]
#[inline]
fn wide_totals(sums: [__m256i; 2]) -> [i64; 2] {
    let [a, b] = sums.map(|sums| {
        let (low, high) = (_mm256_castsi256_si128(sums), _mm256_extracti128_si256::<1>(sums));
        _mm256_add_epi64(_mm256_cvtepi32_epi64(low), _mm256_cvtepi32_epi64(high))
    });
    let four = _mm256_add_epi64(_mm256_unpacklo_epi64(a, b), _mm256_unpackhi_epi64(a, b));
    let two = _mm_add_epi64(_mm256_castsi256_si128(four), _mm256_extracti128_si256::<1>(four));
    [_mm_extract_epi64::<0>(two), _mm_extract_epi64::<1>(two)]
}

/// As [`super::scalar::compare`].
#[target_feature(enable = "avx2")]
pub(super) fn compare(window: Window<'_>, value: &[i16], dx: &[i16], dy: &[i16]) -> Compared {
    check(window, SIDE + 1, SIDE + 1);
    let (value, dx, dy) = (rows(value), rows(dx), rows(dy));
    let (fx, fy) = (_mm256_set1_epi16(window.x), _mm256_set1_epi16(window.y));
    let (eighth, ones) = (_mm256_set1_epi16(EIGHTH), _mm256_set1_epi16(1));
    let across = |y: usize| {
        // SAFETY: `check` said that there are so many samples in so many rows.
        let at = |column: usize| unsafe { load(window.samples.as_ptr().add(y * window.stride + column)) };
        between(at(0), at(1), fx)
    };
    let zero = _mm256_setzero_si256();
    let [mut rhs_x, mut rhs_y, mut sum, mut square] = [zero; 4];
    let mut above = across(0);
    for y in 0..SIDE {
        let below = across(y + 1);
        let here = between(above, below, fy);
        let difference = _mm256_mulhrs_epi16(_mm256_sub_epi16(here, numbers(&value[y])), eighth);
        add(&mut rhs_x, difference, numbers(&dx[y]));
        add(&mut rhs_y, difference, numbers(&dy[y]));
        add(&mut sum, difference, ones);
        add(&mut square, difference, difference);
        above = below;
    }
    let [sum, square] = wide_totals([sum, square]);
    Compared { rhs: wide_totals([rhs_x, rhs_y]), sum, square }
}
