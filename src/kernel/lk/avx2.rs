//! A patch's rows for AVX2: one register each.

use std::arch::x86_64::*;

use super::wide::{self, SIDE, Wide};
use super::{Compared, Moments, Projection, Slopes, Window};
use crate::kernel::Level;

/// The instruction set: made only where the processor was found to have it.
#[derive(Clone, Copy)]
pub(super) struct Avx2(());

impl Avx2 {
    /// Where `level` says so.
    #[inline(always)]
    pub(super) fn of(level: Level) -> Option<Self> {
        level.has_avx2().then_some(Self(()))
    }

    /// As [`super::scalar::sample`].
    #[inline(always)]
    pub(super) fn sample(self, window: Window<'_>, value: &mut [i16], dx: &mut [i16], dy: &mut [i16]) -> Moments {
        #[target_feature(enable = "avx2")]
        fn sample(avx2: Avx2, window: Window<'_>, value: &mut [i16], dx: &mut [i16], dy: &mut [i16]) -> Moments {
            wide::sample(avx2, window, value, dx, dy)
        }
        // SAFETY: an `Avx2` is made only where the processor was found to have it; so for all of this file.
        unsafe { sample(self, window, value, dx, dy) }
    }

    /// As [`super::scalar::project`].
    #[inline(always)]
    pub(super) fn project(self, projection: Projection, value: &[i16], dx: &mut [i16], dy: &mut [i16]) -> Slopes {
        #[target_feature(enable = "avx2")]
        fn project(avx2: Avx2, projection: Projection, value: &[i16], dx: &mut [i16], dy: &mut [i16]) -> Slopes {
            wide::project(avx2, projection, value, dx, dy)
        }
        // SAFETY: `self` is the proof.
        unsafe { project(self, projection, value, dx, dy) }
    }

    /// As [`super::scalar::compare`].
    #[inline(always)]
    pub(super) fn compare(self, window: Window<'_>, value: &[i16], dx: &[i16], dy: &[i16]) -> Compared {
        #[target_feature(enable = "avx2")]
        fn compare(avx2: Avx2, window: Window<'_>, value: &[i16], dx: &[i16], dy: &[i16]) -> Compared {
            wide::compare(avx2, window, value, dx, dy)
        }
        // SAFETY: `self` is the proof.
        unsafe { compare(self, window, value, dx, dy) }
    }
}

impl Wide for Avx2 {
    type Row = __m256i;
    type Sums = __m256i;

    #[inline(always)]
    fn all(self, number: i16) -> __m256i {
        // SAFETY: `self` is the proof of AVX2.
        unsafe { _mm256_set1_epi16(number) }
    }

    #[inline(always)]
    fn load(self, numbers: &[i16; SIDE]) -> __m256i {
        // SAFETY: `self` is the proof of AVX2; there are sixteen numbers.
        unsafe { _mm256_loadu_si256(numbers.as_ptr().cast()) }
    }

    #[inline(always)]
    fn store(self, row: __m256i, to: &mut [i16; SIDE]) {
        // SAFETY: `self` is the proof of AVX2; there is room for sixteen numbers.
        unsafe { _mm256_storeu_si256(to.as_mut_ptr().cast(), row) }
    }

    #[inline(always)]
    unsafe fn samples(self, at: *const u8) -> __m256i {
        // SAFETY: `self` is the proof of AVX2; of the bytes, the caller's promise.
        unsafe { _mm256_slli_epi16::<7>(_mm256_cvtepu8_epi16(_mm_loadu_si128(at.cast()))) }
    }

    #[inline(always)]
    fn plus(self, a: __m256i, b: __m256i) -> __m256i {
        // SAFETY: `self` is the proof of AVX2.
        unsafe { _mm256_add_epi16(a, b) }
    }

    #[inline(always)]
    fn less(self, a: __m256i, b: __m256i) -> __m256i {
        // SAFETY: `self` is the proof of AVX2.
        unsafe { _mm256_sub_epi16(a, b) }
    }

    #[inline(always)]
    fn less_saturating(self, a: __m256i, b: __m256i) -> __m256i {
        // SAFETY: `self` is the proof of AVX2.
        unsafe { _mm256_subs_epi16(a, b) }
    }

    #[inline(always)]
    fn share(self, a: __m256i, b: __m256i) -> __m256i {
        // SAFETY: `self` is the proof of AVX2.
        unsafe { _mm256_mulhrs_epi16(a, b) }
    }

    #[inline(always)]
    fn times(self, a: __m256i, b: __m256i) -> __m256i {
        // SAFETY: `self` is the proof of AVX2.
        unsafe { _mm256_mullo_epi16(a, b) }
    }

    #[inline(always)]
    fn clamp(self, row: __m256i, least: __m256i, most: __m256i) -> __m256i {
        // SAFETY: `self` is the proof of AVX2.
        unsafe { _mm256_max_epi16(_mm256_min_epi16(row, most), least) }
    }

    #[inline(always)]
    fn none(self) -> __m256i {
        // SAFETY: `self` is the proof of AVX2.
        unsafe { _mm256_setzero_si256() }
    }

    #[inline(always)]
    fn add(self, sums: &mut __m256i, a: __m256i, b: __m256i) {
        // SAFETY: `self` is the proof of AVX2.
        *sums = unsafe { _mm256_add_epi32(*sums, _mm256_madd_epi16(a, b)) };
    }

    #[inline(always)]
    fn add_row(self, sums: &mut __m256i, row: __m256i) {
        self.add(sums, row, self.all(1));
    }

    #[inline(always)]
    fn totals(self, [a, b, c, d]: [__m256i; 4]) -> [i64; 4] {
        // SAFETY: `self` is the proof of AVX2.
        unsafe {
            let pairs = _mm256_hadd_epi32(_mm256_hadd_epi32(a, b), _mm256_hadd_epi32(c, d));
            let sums = _mm_add_epi32(_mm256_castsi256_si128(pairs), _mm256_extracti128_si256::<1>(pairs));
            let [low, high] = [_mm_cvtsi128_si64(sums), _mm_extract_epi64::<1>(sums)];
            [i64::from(low as i32), low >> 32, i64::from(high as i32), high >> 32]
        }
    }

    #[inline(always)]
    fn wide_totals(self, [a, b]: [__m256i; 2]) -> [i64; 2] {
        // SAFETY: `self` is the proof of AVX2.
        unsafe {
            let (a, b) = (widened(a), widened(b));
            let four = _mm256_add_epi64(_mm256_unpacklo_epi64(a, b), _mm256_unpackhi_epi64(a, b));
            let two = _mm_add_epi64(_mm256_castsi256_si128(four), _mm256_extracti128_si256::<1>(four));
            [_mm_cvtsi128_si64(two), _mm_extract_epi64::<1>(two)]
        }
    }
}

/// Eight sums as four of 64 bits.
#[target_feature(enable = "avx2")]
#[inline]
fn widened(sums: __m256i) -> __m256i {
    let (low, high) = (_mm256_castsi256_si128(sums), _mm256_extracti128_si256::<1>(sums));
    _mm256_add_epi64(_mm256_cvtepi32_epi64(low), _mm256_cvtepi32_epi64(high))
}
