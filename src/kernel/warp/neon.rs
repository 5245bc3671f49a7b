//! The warp's octets for NEON: two at a time, one register of sixteen bits to a pixel each. What both planes of chroma have in common is
//! computed once.

mod bicubic;
mod bilinear;

use std::arch::aarch64::*;

use super::Cells;
use super::octets::{BLOCK, CHUNK, Draw, Lines, Octets, cells_of};
use crate::image::PlaneRef;

/// A row's sixteen bytes for each of two octets.
type Pair = [uint8x16_t; 2];

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
        // by cell and by block
        let mut outs = outs.map(|out| out.as_chunks_mut::<BLOCK>().0.as_chunks_mut::<BLOCKS>().0);
        let [dxs, dys] = &lines.step;
        // SAFETY: there are eight numbers.
        let n = unsafe { vld1q_s16([0, 1, 2, 3, 4, 5, 6, 7].as_ptr()) };
        for i in 0..lines.count().min(CHUNK) {
            let ways = [dxs[i], dys[i]].map(|step| vmulq_n_s16(n, (step >> 4) as i16));
            for b in 0..BLOCKS {
                let firsts = [0, 1].map(|half| octets.at[b][half][i] as usize);
                let places = [0, 1].map(|half| vreinterpret_s16_u32(vdup_n_u32(octets.place[b][half][i])));
                let x = places.map(|place| vreinterpretq_u16_s16(vaddq_s16(vdupq_lane_s16::<0>(place), ways[0])));
                let y = places.map(|place| vaddq_s16(vdupq_lane_s16::<1>(place), ways[1]));
                let flat = octets.steep[b][0][i] | octets.steep[b][1][i] == 0;
                // SAFETY: `LOAD` bytes, `down` rows below each octet's first; `furthest` counts as many rows as are asked for below.
                let load = |p: usize, down: usize| unsafe { firsts.map(|at| vld1q_u8(samples[p].add(at + down * stride))) };
                let bytes = match (CUBIC, flat) {
                    (false, true) => bilinear::mix(x, y, load_rows::<2, N>(load)),
                    (false, false) => bilinear::mix_steep(x, y, load_rows::<3, N>(load)),
                    (true, true) => bicubic::mix(x, y, load_rows::<4, N>(load)),
                    (true, false) => bicubic::mix_steep(x, y, load_rows::<5, N>(load)),
                };
                for (out, bytes) in outs.iter_mut().zip(bytes) {
                    // SAFETY: a block has sixteen bytes.
                    unsafe { vst1q_u8(out[i][b].as_mut_ptr(), bytes) };
                }
            }
        }
    }
}

/// The rows of each plane's two octets.
#[inline(always)]
fn load_rows<const ROWS: usize, const N: usize>(load: impl Fn(usize, usize) -> Pair) -> [[Pair; ROWS]; N] {
    std::array::from_fn(|plane| std::array::from_fn(|row| load(plane, row)))
}
