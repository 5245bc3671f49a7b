//! A patch's rows for NEON: two registers each.

use std::arch::aarch64::*;

use super::wide::{self, SIDE, Wide};
use super::{Compared, Moments, Projection, Slopes, Window};
use crate::kernel::Level;

/// The instruction set: every aarch64 processor that Linux runs on has it, and the compiler uses it everywhere.
#[derive(Clone, Copy)]
pub(super) struct Neon(());

impl Neon {
    /// Where `level` says so.
    #[inline(always)]
    pub(super) fn of(level: Level) -> Option<Self> {
        level.has_neon().then_some(Self(()))
    }

    /// As [`super::scalar::sample`].
    pub(super) fn sample(self, window: Window<'_>, value: &mut [i16], dx: &mut [i16], dy: &mut [i16]) -> Moments {
        wide::sample(self, window, value, dx, dy)
    }

    /// As [`super::scalar::project`].
    pub(super) fn project(self, projection: Projection, value: &[i16], dx: &mut [i16], dy: &mut [i16]) -> Slopes {
        wide::project(self, projection, value, dx, dy)
    }

    /// As [`super::scalar::compare`].
    pub(super) fn compare(self, window: Window<'_>, value: &[i16], dx: &[i16], dy: &[i16]) -> Compared {
        wide::compare(self, window, value, dx, dy)
    }
}

impl Wide for Neon {
    /// Columns 0 to 7, and 8 to 15.
    type Row = [int16x8_t; 2];
    type Sums = int32x4_t;

    #[inline(always)]
    fn all(self, number: i16) -> Self::Row {
        // SAFETY: `self` is the proof of NEON.
        unsafe { [vdupq_n_s16(number); 2] }
    }

    #[inline(always)]
    fn load(self, numbers: &[i16; SIDE]) -> Self::Row {
        // SAFETY: `self` is the proof of NEON; there are sixteen of them.
        unsafe { [vld1q_s16(numbers.as_ptr()), vld1q_s16(numbers.as_ptr().add(SIDE / 2))] }
    }

    #[inline(always)]
    fn store(self, row: Self::Row, to: &mut [i16; SIDE]) {
        // SAFETY: `self` is the proof of NEON; there is room for sixteen.
        unsafe {
            vst1q_s16(to.as_mut_ptr(), row[0]);
            vst1q_s16(to.as_mut_ptr().add(SIDE / 2), row[1]);
        }
    }

    #[inline(always)]
    unsafe fn samples(self, at: *const u8) -> Self::Row {
        // SAFETY: `self` is the proof of NEON; of the bytes, the caller's promise.
        unsafe {
            let bytes = vld1q_u8(at);
            [vreinterpretq_s16_u16(vshll_n_u8::<7>(vget_low_u8(bytes))), vreinterpretq_s16_u16(vshll_high_n_u8::<7>(bytes))]
        }
    }

    #[inline(always)]
    fn plus(self, a: Self::Row, b: Self::Row) -> Self::Row {
        // SAFETY: `self` is the proof of NEON.
        unsafe { [vaddq_s16(a[0], b[0]), vaddq_s16(a[1], b[1])] }
    }

    #[inline(always)]
    fn less(self, a: Self::Row, b: Self::Row) -> Self::Row {
        // SAFETY: `self` is the proof of NEON.
        unsafe { [vsubq_s16(a[0], b[0]), vsubq_s16(a[1], b[1])] }
    }

    #[inline(always)]
    fn less_saturating(self, a: Self::Row, b: Self::Row) -> Self::Row {
        // SAFETY: `self` is the proof of NEON.
        unsafe { [vqsubq_s16(a[0], b[0]), vqsubq_s16(a[1], b[1])] }
    }

    #[inline(always)]
    fn share(self, a: Self::Row, b: Self::Row) -> Self::Row {
        // SAFETY: `self` is the proof of NEON.
        unsafe { [vqrdmulhq_s16(a[0], b[0]), vqrdmulhq_s16(a[1], b[1])] }
    }

    #[inline(always)]
    fn times(self, a: Self::Row, b: Self::Row) -> Self::Row {
        // SAFETY: `self` is the proof of NEON.
        unsafe { [vmulq_s16(a[0], b[0]), vmulq_s16(a[1], b[1])] }
    }

    #[inline(always)]
    fn clamp(self, row: Self::Row, least: Self::Row, most: Self::Row) -> Self::Row {
        // SAFETY: `self` is the proof of NEON.
        unsafe { [vmaxq_s16(vminq_s16(row[0], most[0]), least[0]), vmaxq_s16(vminq_s16(row[1], most[1]), least[1])] }
    }

    #[inline(always)]
    fn none(self) -> Self::Sums {
        // SAFETY: `self` is the proof of NEON.
        unsafe { vdupq_n_s32(0) }
    }

    #[inline(always)]
    fn add(self, sums: &mut Self::Sums, a: Self::Row, b: Self::Row) {
        // SAFETY: `self` is the proof of NEON.
        unsafe {
            for i in 0..2 {
                *sums = vmlal_high_s16(vmlal_s16(*sums, vget_low_s16(a[i]), vget_low_s16(b[i])), a[i], b[i]);
            }
        }
    }

    #[inline(always)]
    fn add_row(self, sums: &mut Self::Sums, row: Self::Row) {
        // SAFETY: `self` is the proof of NEON.
        *sums = unsafe { vpadalq_s16(vpadalq_s16(*sums, row[0]), row[1]) };
    }

    #[inline(always)]
    fn totals(self, [a, b, c, d]: [Self::Sums; 4]) -> [i64; 4] {
        // SAFETY: `self` is the proof of NEON.
        unsafe { [vaddlvq_s32(a), vaddlvq_s32(b), vaddlvq_s32(c), vaddlvq_s32(d)] }
    }

    #[inline(always)]
    fn wide_totals(self, [a, b]: [Self::Sums; 2]) -> [i64; 2] {
        // SAFETY: `self` is the proof of NEON.
        unsafe { [vaddlvq_s32(a), vaddlvq_s32(b)] }
    }
}
