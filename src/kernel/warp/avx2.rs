//! The warp's octets for AVX2: two at a time, each in its half of a register.

mod bicubic;
mod bilinear;

use std::arch::x86_64::*;

use super::Cells;
use super::octets::{BLOCK, CHUNK, Draw, Lines, Octets, cells_of};
use crate::image::PlaneRef;

/// The instruction set.
pub(super) enum Avx2 {}

impl Draw for Avx2 {
    #[target_feature(enable = "avx2")]
    unsafe fn cells<const BLOCKS: usize, const CUBIC: bool>(plane: PlaneRef<'_>, cells: Cells<'_>, out: &mut [u8]) {
        // SAFETY: the caller's promise.
        unsafe { cells_of::<Self, BLOCKS, CUBIC>(plane, cells, out) }
    }

    #[target_feature(enable = "avx2")]
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

    #[target_feature(enable = "avx2")]
    #[inline]
    unsafe fn draw<const BLOCKS: usize, const CUBIC: bool>(
        octets: &Octets<BLOCKS, CUBIC>,
        plane: PlaneRef<'_>,
        lines: &Lines,
        out: &mut [u8],
    ) {
        let (samples, stride) = (plane.samples().as_ptr(), plane.stride());
        let [dxs, dys] = &lines.step;
        let n = _mm256_setr_epi16(0, 1, 2, 3, 4, 5, 6, 7, 0, 1, 2, 3, 4, 5, 6, 7);
        // bytes 0 and 1 (x), or 2 and 3 (y), to all
        let [spread_x, spread_y] = [_mm256_set1_epi16(0x0100), _mm256_set1_epi16(0x0302)];
        for (i, out) in out.chunks_exact_mut(BLOCKS * BLOCK).enumerate().take(CHUNK) {
            let ways = [dxs[i], dys[i]].map(|step| _mm256_mullo_epi16(n, _mm256_set1_epi16((step >> 4) as i16)));
            for (b, out) in out.chunks_exact_mut(BLOCK).enumerate() {
                let [first, second] = [0, 1].map(|half| octets.at[b][half][i]);
                let [low, high] = [0, 1].map(|half| _mm_set1_epi32(octets.place[b][half][i] as i32));
                let places = _mm256_set_m128i(high, low);
                let x = _mm256_add_epi16(_mm256_shuffle_epi8(places, spread_x), ways[0]);
                let y = _mm256_add_epi16(_mm256_shuffle_epi8(places, spread_y), ways[1]);
                // SAFETY: `LOAD` bytes, `down` rows below the octet's first; `furthest` counts as many rows as are asked for below.
                let load = |down: usize| unsafe {
                    let half = |at: u32| _mm_loadu_si128(samples.add(at as usize + down * stride).cast());
                    _mm256_set_m128i(half(second), half(first))
                };
                let flat = octets.steep[b][0][i] | octets.steep[b][1][i] == 0;
                let bytes = match (CUBIC, flat) {
                    (false, true) => bilinear::mix(x, y, [load(0), load(1)]),
                    (false, false) => bilinear::mix_steep(x, y, [load(0), load(1), load(2)]),
                    (true, true) => bicubic::mix(x, y, [load(0), load(1), load(2), load(3)]),
                    (true, false) => bicubic::mix_steep(x, y, [load(0), load(1), load(2), load(3), load(4)]),
                };
                // SAFETY: `out` is a chunk of sixteen bytes.
                unsafe { _mm_storeu_si128(out.as_mut_ptr().cast(), bytes) };
            }
        }
    }
}
