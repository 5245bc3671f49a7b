//! Halving for AVX2: sums of four neighbours of a row, sixteen at a time, each row's once. The same bits as the plain loop.

use std::arch::x86_64::*;

use crate::image::{PlaneMut, PlaneRef};

/// Output columns at a time.
const STEP: usize = 16;
/// Output columns whose sums are kept for the next row.
const BLOCK: usize = 512;

/// Halves columns 1 .. `columns` (which is as far as there are whole steps) of all rows but the first and the last, as
/// [`super::halve`] does; gives `columns`. What is left is the plain loop's.
#[target_feature(enable = "avx2")]
pub(super) fn inner(from: PlaneRef<'_>, to: &mut PlaneMut<'_>) -> usize {
    let (rows, columns) = ((from.height() / 2).min(to.height()), (from.width() / 2).min(to.width()));
    // the last step reads one byte past its own 32
    let steps = (from.width().saturating_sub(2) / 2).min(columns).saturating_sub(1) / STEP;
    let columns = 1 + steps * STEP;
    if steps == 0 || rows < 3 {
        return 1;
    }
    let mut sums = [[0u16; BLOCK]; 4];
    for first in (1..columns).step_by(BLOCK) {
        let count = BLOCK.min(columns - first);
        let take = |y: usize, sums: &mut [u16; BLOCK]| {
            let row = &from.row(y)[2 * first - 1..][..2 * count + 2];
            for (n, sums) in sums[..count].as_chunks_mut::<STEP>().0.iter_mut().enumerate() {
                // SAFETY: of the row's 2 count + 2 bytes, 34 from byte 32 n on are read.
                unsafe { _mm256_storeu_si256(sums.as_mut_ptr().cast(), across(row.as_ptr().add(2 * STEP * n))) };
            }
        };
        for (k, sums) in sums[..2].iter_mut().enumerate() {
            take(1 + k, sums);
        }
        for y in 1..rows - 1 {
            let [a, b, c, d] = [0, 1, 2, 3].map(|k| (2 * y + 2 + k) % 4);
            take(2 * y + 1, &mut sums[c]);
            take(2 * y + 2, &mut sums[d]);
            let out = &mut to.row_mut(y)[first..][..count];
            for (n, out) in out.as_chunks_mut::<STEP>().0.iter_mut().enumerate() {
                // SAFETY: each row of sums has `count` of them, sixteen from 16 n on.
                let at = |row: usize| unsafe { _mm256_loadu_si256(sums[row].as_ptr().add(STEP * n).cast()) };
                let bytes = down([at(a), at(b), at(c), at(d)]);
                // SAFETY: `out` has sixteen bytes.
                unsafe { _mm_storeu_si128(out.as_mut_ptr().cast(), bytes) };
            }
        }
    }
    columns
}

/// Sums (1 3 3 1) of sixteen times four bytes, two bytes apart, from `at` on.
///
/// # Safety
/// There are 34 bytes at `at`.
#[target_feature(enable = "avx2")]
#[inline]
unsafe fn across(at: *const u8) -> __m256i {
    // SAFETY: the caller's promise.
    let [left, middle, right] = [0, 1, 2].map(|n| unsafe { _mm256_loadu_si256(at.add(n).cast()) });
    let outer = _mm256_add_epi16(_mm256_and_si256(left, _mm256_set1_epi16(255)), _mm256_srli_epi16::<8>(right));
    _mm256_add_epi16(outer, _mm256_maddubs_epi16(middle, _mm256_set1_epi8(3)))
}

/// Bytes of four rows of sums.
#[target_feature(enable = "avx2")]
#[inline]
fn down([a, b, c, d]: [__m256i; 4]) -> __m128i {
    let inner = _mm256_add_epi16(b, c);
    let three = _mm256_add_epi16(inner, _mm256_slli_epi16::<1>(inner));
    let sum = _mm256_add_epi16(_mm256_add_epi16(a, d), _mm256_add_epi16(three, _mm256_set1_epi16(32)));
    let words = _mm256_srli_epi16::<6>(sum);
    _mm_packus_epi16(_mm256_castsi256_si128(words), _mm256_extracti128_si256::<1>(words))
}
