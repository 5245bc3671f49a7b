//! The warp's octets for NEON: one at a time, sixteen bits to a pixel.

mod bicubic;
mod bilinear;

use std::arch::aarch64::*;

use super::Cells;
use super::octets::{CHUNK, Draw, Lines, OCTET, Octets, cells_of};
use crate::image::PlaneRef;

/// The instruction set. Every aarch64 processor that Linux runs on has it, and the compiler uses it everywhere.
pub(super) enum Neon {}

impl Draw for Neon {
    unsafe fn cells<const BLOCKS: usize, const CUBIC: bool, const N: usize>(
        planes: [PlaneRef<'_>; N],
        cells: Cells<'_>,
        outs: [&mut [u8]; N],
    ) {
        // SAFETY: the caller's promise.
        unsafe { cells_of::<Self, BLOCKS, CUBIC, N>(planes, cells, outs) }
    }

    #[inline]
    unsafe fn drawn<const BLOCKS: usize, const CUBIC: bool, const N: usize>(
        octets: &mut Octets<BLOCKS, CUBIC>,
        planes: [PlaneRef<'_>; N],
        cells: Cells<'_>,
        lines: &Lines,
        outs: [&mut [u8]; N],
    ) -> bool {
        // SAFETY: the caller's promise.
        unsafe { octets.drawn::<Self, N>(planes, cells, lines, outs) }
    }

    #[target_feature(enable = "neon")]
    #[inline]
    unsafe fn draw<const BLOCKS: usize, const CUBIC: bool, const N: usize>(
        octets: &Octets<BLOCKS, CUBIC>,
        planes: [PlaneRef<'_>; N],
        lines: &Lines,
        outs: [&mut [u8]; N],
    ) {
        let stride = planes[0].stride();
        let samples = planes.map(|plane| plane.samples().as_ptr());
        // by cell, by block and by half of a block
        let outs = outs.map(|out| out.as_chunks_mut::<OCTET>().0.as_chunks_mut::<2>().0.as_chunks_mut::<BLOCKS>().0);
        let [dxs, dys] = &lines.step;
        // SAFETY: there are eight numbers.
        let n = unsafe { vld1q_s16([0, 1, 2, 3, 4, 5, 6, 7].as_ptr()) };
        for i in 0..lines.count().min(CHUNK) {
            let ways = [dxs[i], dys[i]].map(|step| vmulq_n_s16(n, (step >> 4) as i16));
            for o in 0..2 * BLOCKS {
                let (b, half) = (o / 2, o % 2);
                let (first, place) = (octets.at[b][half][i] as usize, octets.place[b][half][i]);
                let x = vreinterpretq_u16_s16(vaddq_s16(vdupq_n_s16(place as i16), ways[0]));
                let y = vaddq_s16(vdupq_n_s16((place >> 16) as i16), ways[1]);
                for p in 0..N {
                    // SAFETY: `LOAD` bytes, `down` rows below the octet's first; `furthest` counts as many rows as are asked for below.
                    let load = |down: usize| unsafe { vld1q_u8(samples[p].add(first + down * stride)) };
                    let bytes = match (CUBIC, octets.steep[b][half][i] == 0) {
                        (false, true) => bilinear::mix(x, y, [load(0), load(1)]),
                        (false, false) => bilinear::mix_steep(x, y, [load(0), load(1), load(2)]),
                        (true, true) => bicubic::mix(x, y, [load(0), load(1), load(2), load(3)]),
                        (true, false) => bicubic::mix_steep(x, y, [load(0), load(1), load(2), load(3), load(4)]),
                    };
                    // SAFETY: an octet has eight bytes.
                    unsafe { vst1_u8(outs[p][i][b][half].as_mut_ptr(), bytes) };
                }
            }
        }
    }
}
