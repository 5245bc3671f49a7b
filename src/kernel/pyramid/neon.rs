//! [`super::wide`] for NEON.

use std::arch::aarch64::*;

use super::wide::{self, Wide};
use crate::image::{PlaneMut, PlaneRef};
use crate::kernel::Level;

/// The instruction set, which every aarch64 processor has.
#[derive(Clone, Copy)]
pub(super) struct Neon(());

impl Neon {
    /// Where `level` says so.
    pub(super) fn of(level: Level) -> Option<Self> {
        level.has_neon().then_some(Self(()))
    }

    /// As [`wide::inner`].
    pub(super) fn inner(self, from: PlaneRef<'_>, to: &mut PlaneMut<'_>) -> usize {
        wide::inner(self, from, to)
    }
}

impl Wide for Neon {
    type Sums = [uint16x8_t; 2];

    #[inline(always)]
    fn none(self) -> [uint16x8_t; 2] {
        // SAFETY: the processor has NEON.
        unsafe { [vdupq_n_u16(0); 2] }
    }

    #[inline(always)]
    unsafe fn across(self, at: *const u8) -> [uint16x8_t; 2] {
        // SAFETY: the processor has NEON; of the bytes, the caller's promise.
        unsafe {
            let (uint8x16x2_t(a, b), uint8x16x2_t(c, d)) = (vld2q_u8(at), vld2q_u8(at.add(2)));
            let outer = [vaddl_u8(vget_low_u8(a), vget_low_u8(d)), vaddl_high_u8(a, d)];
            let inner = [vaddl_u8(vget_low_u8(b), vget_low_u8(c)), vaddl_high_u8(b, c)];
            [vmlaq_n_u16(outer[0], inner[0], 3), vmlaq_n_u16(outer[1], inner[1], 3)]
        }
    }

    #[inline(always)]
    unsafe fn down(self, [a, b, c, d]: [[uint16x8_t; 2]; 4], to: *mut u8) {
        // SAFETY: the processor has NEON; of the room, the caller's promise.
        unsafe {
            let sums = [0, 1].map(|half| {
                let (outer, inner) = (vaddq_u16(a[half], d[half]), vaddq_u16(b[half], c[half]));
                vmlaq_n_u16(outer, inner, 3)
            });
            vst1q_u8(to, vrshrn_high_n_u16::<6>(vrshrn_n_u16::<6>(sums[0]), sums[1]));
        }
    }
}
