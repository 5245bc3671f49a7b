//! Halving by sixteen columns at a time, for the instruction sets that hold as many sums: each row's sums of four neighbours once. The same
//! bits as the plain loop.
//!
//! All here is compiled for the instruction set that calls it: it is inlined into functions that have been told of it. No closures:
//! those might stay functions of their own, without it.

use crate::image::{PlaneMut, PlaneRef};

/// Output columns at a time.
const STEP: usize = 16;
/// Steps whose sums are kept for the next row.
const BLOCK: usize = 32;

/// What halving needs of an instruction set. Holding a value is the proof that the processor has it.
pub(super) trait Wide: Copy {
    /// Sixteen numbers of 16 bits.
    type Sums: Copy;

    /// Sums of nothing.
    fn none(self) -> Self::Sums;
    /// Sums (1 3 3 1) of sixteen times four bytes, two bytes apart, from `at` on.
    ///
    /// # Safety
    /// There are 34 bytes at `at`.
    unsafe fn across(self, at: *const u8) -> Self::Sums;
    /// Writes the bytes of four rows of sums to `to`.
    ///
    /// # Safety
    /// There is room for sixteen bytes at `to`.
    unsafe fn down(self, rows: [Self::Sums; 4], to: *mut u8);
}

/// Halves the columns 1 .. `end` of all rows but the first and the last, as [`super::halve`] does, and gives `end`: those whose
/// neighbours all lie within `from`. Where there are fewer of them than a step has, none, and 1. What is left is the plain loop's.
#[inline(always)]
pub(super) fn inner<W: Wide>(wide: W, from: PlaneRef<'_>, to: &mut PlaneMut<'_>) -> usize {
    let (rows, columns) = ((from.height() / 2).min(to.height()), (from.width() / 2).min(to.width()));
    let end = columns.min(from.width().saturating_sub(1) / 2);
    let Some(last) = end.checked_sub(STEP).filter(|&last| last > 0 && rows >= 3) else { return 1 };
    // of the two rows above those that are read
    let mut sums = [[wide.none(); BLOCK]; 2];
    for first in (1..end).step_by(STEP * BLOCK) {
        let count = (end - first).div_ceil(STEP).min(BLOCK);
        for (sums, y) in sums.iter_mut().zip([1, 2]) {
            let row = &from.row(y)[..2 * end + 1];
            for (n, sum) in sums[..count].iter_mut().enumerate() {
                // SAFETY: 34 bytes from column 2 `last` - 1 on, at the latest, end where the row does; so below.
                *sum = unsafe { wide.across(row.as_ptr().add(2 * (first + STEP * n).min(last) - 1)) };
            }
        }
        let [above, before] = &mut sums;
        for y in 1..rows - 1 {
            let [next, below] = [&from.row(2 * y + 1)[..2 * end + 1], &from.row(2 * y + 2)[..2 * end + 1]];
            let out = &mut to.row_mut(y)[..end];
            for (n, (above, before)) in above[..count].iter_mut().zip(&mut before[..count]).enumerate() {
                // the last step repeats some columns of the one before
                let at = (first + STEP * n).min(last);
                // SAFETY: as above.
                let [c, d] =
                    unsafe { [wide.across(next.as_ptr().add(2 * at - 1)), wide.across(below.as_ptr().add(2 * at - 1))] };
                // SAFETY: there are STEP columns from `last` on, which none lies behind.
                unsafe { wide.down([*above, *before, c, d], out.as_mut_ptr().add(at)) };
                (*above, *before) = (c, d);
            }
        }
    }
    end
}
