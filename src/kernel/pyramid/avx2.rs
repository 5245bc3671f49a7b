//! [`super::wide`] for AVX2.

use std::arch::x86_64::*;

use super::wide::{self, Wide};
use crate::image::{PlaneMut, PlaneRef};
use crate::kernel::Level;

/// The instruction set: made only where the processor was found to have it.
#[derive(Clone, Copy)]
pub(super) struct Avx2(());

impl Avx2 {
    /// Where `level` says so.
    pub(super) fn of(level: Level) -> Option<Self> {
        level.has_avx2().then_some(Self(()))
    }

    /// As [`wide::inner`].
    pub(super) fn inner(self, from: PlaneRef<'_>, to: &mut PlaneMut<'_>) -> usize {
        #[target_feature(enable = "avx2")]
        fn inner(avx2: Avx2, from: PlaneRef<'_>, to: &mut PlaneMut<'_>) -> usize {
            wide::inner(avx2, from, to)
        }
        // SAFETY: an `Avx2` is made only where the processor was found to have it; so for all of this file.
        unsafe { inner(self, from, to) }
    }
}

impl Wide for Avx2 {
    type Sums = __m256i;

    #[inline(always)]
    fn none(self) -> __m256i {
        // SAFETY: `self` is the proof of AVX2.
        unsafe { _mm256_setzero_si256() }
    }

    #[inline(always)]
    unsafe fn across(self, at: *const u8) -> __m256i {
        // SAFETY: `self` is the proof of AVX2; of the bytes, the caller's promise.
        unsafe {
            let [left, middle, right] = [at, at.add(1), at.add(2)].map(|at| _mm256_loadu_si256(at.cast()));
            let outer = _mm256_add_epi16(_mm256_and_si256(left, _mm256_set1_epi16(255)), _mm256_srli_epi16::<8>(right));
            _mm256_add_epi16(outer, _mm256_maddubs_epi16(middle, _mm256_set1_epi8(3)))
        }
    }

    #[inline(always)]
    unsafe fn down(self, [a, b, c, d]: [__m256i; 4], to: *mut u8) {
        // SAFETY: `self` is the proof of AVX2; of the room, the caller's promise.
        unsafe {
            let inner = _mm256_add_epi16(b, c);
            let three = _mm256_add_epi16(inner, _mm256_slli_epi16::<1>(inner));
            let sum = _mm256_add_epi16(_mm256_add_epi16(a, d), _mm256_add_epi16(three, _mm256_set1_epi16(32)));
            let words = _mm256_srli_epi16::<6>(sum);
            let bytes = _mm_packus_epi16(_mm256_castsi256_si128(words), _mm256_extracti128_si256::<1>(words));
            _mm_storeu_si128(to.cast(), bytes);
        }
    }
}
