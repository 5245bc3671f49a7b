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
    unsafe fn cells<const BLOCKS: usize, const CUBIC: bool, const N: usize>(
        planes: [PlaneRef<'_>; N],
        cells: Cells<'_>,
        outs: [&mut [u8]; N],
    ) {
        // SAFETY: the caller's promise.
        unsafe { cells_of::<Self, BLOCKS, CUBIC, N>(planes, cells, outs) }
    }

    #[target_feature(enable = "avx2")]
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

    #[target_feature(enable = "avx2")]
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
        let outs = outs.map(|out| out.as_chunks_mut::<BLOCK>().0.as_chunks_mut::<BLOCKS>().0);
        let [dxs, dys] = &lines.step;
        let n = _mm256_setr_epi16(0, 1, 2, 3, 4, 5, 6, 7, 0, 1, 2, 3, 4, 5, 6, 7);
        // bytes 0 and 1 (x) or 2 and 3 (y) of the first octet's place to all of the lower half, those of the second's to the upper half
        let spread = |bytes: i16| _mm256_set_m128i(_mm_set1_epi16(bytes + 0x0404), _mm_set1_epi16(bytes));
        let [spread_x, spread_y] = [spread(0x0100), spread(0x0302)];
        for i in 0..lines.count().min(CHUNK) {
            let ways = [dxs[i], dys[i]].map(|step| _mm256_mullo_epi16(n, _mm256_set1_epi16((step >> 4) as i16)));
            for b in 0..BLOCKS {
                let [first, second] = [0, 1].map(|half| octets.at[b][half][i]);
                let [low, high] = [0, 1].map(|half| octets.place[b][half][i]);
                let places = _mm256_set1_epi64x((u64::from(high) << 32 | u64::from(low)) as i64);
                let x = _mm256_add_epi16(_mm256_shuffle_epi8(places, spread_x), ways[0]);
                let y = _mm256_add_epi16(_mm256_shuffle_epi8(places, spread_y), ways[1]);
                let flat = octets.steep[b][0][i] | octets.steep[b][1][i] == 0;
                for p in 0..N {
                    // SAFETY: `LOAD` bytes, `down` rows below the octet's first; `furthest` counts as many rows as are asked for below.
                    let load = |down: usize| unsafe {
                        let half = |at: u32| _mm_loadu_si128(samples[p].add(at as usize + down * stride).cast());
                        _mm256_set_m128i(half(second), half(first))
                    };
                    let bytes = match (CUBIC, flat) {
                        (false, true) => bilinear::mix(x, y, [load(0), load(1)]),
                        (false, false) => bilinear::mix_steep(x, y, [load(0), load(1), load(2)]),
                        (true, true) => bicubic::mix(x, y, [load(0), load(1), load(2), load(3)]),
                        (true, false) => bicubic::mix_steep(x, y, [load(0), load(1), load(2), load(3), load(4)]),
                    };
                    // SAFETY: a block has sixteen bytes.
                    unsafe { _mm_storeu_si128(outs[p][i][b].as_mut_ptr().cast(), bytes) };
                }
            }
        }
    }
}

/// Bytes (column, column + 1) of each of sixteen places (1/4096 of a column).
#[target_feature(enable = "avx2")]
#[inline]
fn pairs(x: __m256i) -> __m256i {
    let column = _mm256_srli_epi16::<12>(x);
    let twice = _mm256_setr_epi8(
        0, 0, 2, 2, 4, 4, 6, 6, 8, 8, 10, 10, 12, 12, 14, 14, 0, 0, 2, 2, 4, 4, 6, 6, 8, 8, 10, 10, 12, 12, 14, 14,
    );
    _mm256_add_epi16(_mm256_shuffle_epi8(column, twice), _mm256_set1_epi16(256))
}
