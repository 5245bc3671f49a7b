//! The warp's octets for NEON: one at a time, sixteen bits to a pixel.

mod bicubic;
mod bilinear;

use std::arch::aarch64::*;

use super::Cells;
use super::octets::{BLOCK, CHUNK, Draw, Lines, OCTET, Octets, cells_of};
use crate::image::PlaneRef;

/// The instruction set. Every aarch64 processor that Linux runs on has it, and the compiler uses it everywhere.
pub(super) enum Neon {}

impl Draw for Neon {
    unsafe fn cells<const BLOCKS: usize, const CUBIC: bool>(plane: PlaneRef<'_>, cells: Cells<'_>, out: &mut [u8]) {
        // SAFETY: the caller's promise.
        unsafe { cells_of::<Self, BLOCKS, CUBIC>(plane, cells, out) }
    }

    #[inline]
    unsafe fn drawn<const BLOCKS: usize, const CUBIC: bool>(
        octets: &mut Octets<BLOCKS, CUBIC>,
        plane: PlaneRef<'_>,
        cells: Cells<'_>,
        lines: &Lines,
        out: &mut [u8],
    ) -> bool {
        // SAFETY: the caller's promise.
        unsafe { octets.drawn::<Self>(plane, cells, lines, out) }
    }

    #[target_feature(enable = "neon")]
    #[inline]
    unsafe fn draw<const BLOCKS: usize, const CUBIC: bool>(
        octets: &Octets<BLOCKS, CUBIC>,
        plane: PlaneRef<'_>,
        lines: &Lines,
        out: &mut [u8],
    ) {
        let (samples, stride) = (plane.samples().as_ptr(), plane.stride());
        let [dxs, dys] = &lines.step;
        // SAFETY: there are eight numbers.
        let n = unsafe { vld1q_s16([0, 1, 2, 3, 4, 5, 6, 7].as_ptr()) };
        for (i, out) in out.chunks_exact_mut(BLOCKS * BLOCK).enumerate().take(CHUNK) {
            let ways = [dxs[i], dys[i]].map(|step| vmulq_n_s16(n, (step >> 4) as i16));
            for (o, out) in out.chunks_exact_mut(OCTET).enumerate() {
                let (b, half) = (o / 2, o % 2);
                let (first, place) = (octets.at[b][half][i] as usize, octets.place[b][half][i]);
                let x = vreinterpretq_u16_s16(vaddq_s16(vdupq_n_s16(place as i16), ways[0]));
                let y = vaddq_s16(vdupq_n_s16((place >> 16) as i16), ways[1]);
                // SAFETY: `LOAD` bytes, `down` rows below the octet's first; `furthest` counts as many rows as are asked for below.
                let load = |down: usize| unsafe { vld1q_u8(samples.add(first + down * stride)) };
                let bytes = match (CUBIC, octets.steep[b][half][i] == 0) {
                    (false, true) => bilinear::mix(x, y, [load(0), load(1)]),
                    (false, false) => bilinear::mix_steep(x, y, [load(0), load(1), load(2)]),
                    (true, true) => bicubic::mix(x, y, [load(0), load(1), load(2), load(3)]),
                    (true, false) => bicubic::mix_steep(x, y, [load(0), load(1), load(2), load(3), load(4)]),
                };
                // SAFETY: `out` is a chunk of eight bytes.
                unsafe { vst1_u8(out.as_mut_ptr(), bytes) };
            }
        }
    }
}
