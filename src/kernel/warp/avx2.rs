//! The warp's loop for AVX2: sixteen pixels at a time, shuffled out of the two or three rows that they touch.
//!
//! Eight neighbours on a line that is not much longer than they are lie within sixteen bytes of each row, and, where the line is not
//! too steep, within three rows (bicubic: five). So nothing is gathered: each half of a register, an octet, loads its own sixteen bytes.

mod bicubic;
mod bilinear;

use std::arch::x86_64::*;
use std::ops::Range;

use super::{Cells, Filter, HALF_STEP, MARGIN, is_inside, scalar};
use crate::image::PlaneRef;

/// Pixels at a time: two octets.
const BLOCK: usize = 16;
/// The largest step along x, bilinear and bicubic: eight pixels then span no more than fifteen bytes, their neighbours included.
const LONGEST: [i32; 2] = [7 << 14, 6 << 14];
/// The largest step along y, either way: eight pixels then lie between three rows at most.
const STEEPEST: i32 = (1 << 16) / 8;
/// Bytes that are loaded of each row of an octet.
const LOAD: usize = 16;
/// Rows that are loaded of an octet at most: four, and one more where it is steep.
const MOST_ROWS: i64 = 5;
/// Cells whose octets are found at a time.
const CHUNK: usize = 32;

/// Draws a row as [`super::row`] does; `out` is no longer than the cells.
#[target_feature(enable = "avx2")]
pub fn row(plane: PlaneRef<'_>, cells: Cells<'_>, out: &mut [u8]) {
    match (cells.wide, cells.filter) {
        (16, Filter::Bilinear) => row_of::<1, false>(plane, cells, out),
        (32, Filter::Bilinear) => row_of::<2, false>(plane, cells, out),
        (64, Filter::Bilinear) => row_of::<4, false>(plane, cells, out),
        (16, Filter::Bicubic) => row_of::<1, true>(plane, cells, out),
        (32, Filter::Bicubic) => row_of::<2, true>(plane, cells, out),
        (64, Filter::Bicubic) => row_of::<4, true>(plane, cells, out),
        _ => super::row_scalar(plane, cells, out),
    }
}

/// As [`row`], for cells of `BLOCKS` blocks.
#[target_feature(enable = "avx2")]
#[inline]
fn row_of<const BLOCKS: usize, const CUBIC: bool>(plane: PlaneRef<'_>, cells: Cells<'_>, out: &mut [u8]) {
    let mut octets = Octets::<BLOCKS, CUBIC>::new();
    let count = out.len().div_ceil(cells.wide);
    for (n, out) in (0..count).step_by(CHUNK).zip(out.chunks_mut(CHUNK * cells.wide)) {
        if octets.drawn(plane, cells, &Lines::of(cells, n..count.min(n + CHUNK)), out) {
            continue;
        }
        for (i, out) in out.chunks_mut(cells.wide).enumerate() {
            if !octets.drawn(plane, cells, &Lines::of(cells, n + i..n + i + 1), out) {
                scalar(plane, cells.line(n + i), cells, out);
            }
        }
    }
}

/// The lines of some cells; those beyond `count` repeat the last.
struct Lines {
    count: usize,
    start: [[i32; CHUNK]; 2],
    step: [[i32; CHUNK]; 2],
}

impl Lines {
    /// The lines of at most [`CHUNK`] cells, at least one.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn of(cells: Cells<'_>, range: Range<usize>) -> Self {
        let last = cells.line(range.end - 1);
        let mut lines = Self { count: range.len(), start: last.start.map(|x| [x; CHUNK]), step: last.step.map(|x| [x; CHUNK]) };
        for axis in 0..2 {
            lines.start[axis][..range.len()].copy_from_slice(&cells.start[axis][range.clone()]);
            lines.step[axis][..range.len()].copy_from_slice(&cells.step[axis][range.clone()]);
        }
        lines
    }

    /// Whether every pixel of these cells, with its neighbours, lies inside the plane, their lines are as short and flat as octets
    /// need, and what [`Octets::find`] computes fits its 32 bits.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn fit(&self, plane: PlaneRef<'_>, cells: Cells<'_>) -> bool {
        let (wide, longest) = (cells.wide, LONGEST[cells.filter.reach() as usize]);
        let range = |axis: usize| {
            let (mut starts, mut steps, mut ends) = ([i32::MAX, i32::MIN], [i32::MAX, i32::MIN], [i32::MAX, i32::MIN]);
            for (&start, &step) in self.start[axis].iter().zip(&self.step[axis]) {
                let end = start.wrapping_add(step.wrapping_mul(wide as i32 - 1));
                starts = [starts[0].min(start), starts[1].max(start)];
                steps = [steps[0].min(step), steps[1].max(step)];
                ends = [ends[0].min(end), ends[1].max(end)];
            }
            (starts, steps, ends)
        };
        let (xs, dxs, x_ends) = range(0);
        let (ys, dys, y_ends) = range(1);
        // steps this short and starts this near cannot have overflowed on their way to the ends
        let near = |starts: [i32; 2]| starts[0] >= MARGIN && starts[1] < 1 << 30;
        if !(near(xs) && near(ys) && dxs[0] >= 0 && dxs[1] <= longest && dys[0] >= -STEEPEST && dys[1] <= STEEPEST) {
            return false;
        }
        let low = [xs[0].min(x_ends[0]), ys[0].min(y_ends[0])].map(i64::from);
        let high = [xs[1].max(x_ends[1]), ys[1].max(y_ends[1])].map(i64::from);
        let rows = ((high[1] >> 16) + MOST_ROWS).saturating_mul(plane.stride() as i64);
        let furthest = rows.saturating_add(high[0] >> 16).saturating_add(2 * LOAD as i64);
        is_inside(plane, cells.filter, [low, high]) && furthest < i64::from(i32::MAX)
    }
}

/// Where the octets of some cells begin: by block, by half of a block, by cell.
struct Octets<const BLOCKS: usize, const CUBIC: bool> {
    /// Sample of the leftmost column in the uppermost row.
    at: [[[u32; CHUNK]; 2]; BLOCKS],
    /// The first pixel's place from there on (bicubic: from a column and a row further): x in the low half, y in the high one, 1/4096.
    place: [[[u32; CHUNK]; 2]; BLOCKS],
    /// Not 0 where the octet touches one row more.
    steep: [[[i32; CHUNK]; 2]; BLOCKS],
}

impl<const BLOCKS: usize, const CUBIC: bool> Octets<BLOCKS, CUBIC> {
    /// Rows that are loaded of a block of flat octets; of one with a steep octet, one more.
    const ROWS: usize = if CUBIC { 4 } else { 2 };

    fn new() -> Self {
        Self { at: [[[0; CHUNK]; 2]; BLOCKS], place: [[[0; CHUNK]; 2]; BLOCKS], steep: [[[0; CHUNK]; 2]; BLOCKS] }
    }

    /// Draws the cells of `lines` into `out`, unless octets cannot: then `out` is as it was, and `false` is returned.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn drawn(&mut self, plane: PlaneRef<'_>, cells: Cells<'_>, lines: &Lines, out: &mut [u8]) -> bool {
        if out.len() != lines.count * cells.wide || !lines.fit(plane, cells) {
            return false;
        }
        self.find(plane.stride(), lines);
        if self.furthest(plane.stride()) > plane.samples().len() {
            return false;
        }
        // SAFETY: all that `draw` loads ends at `furthest` at the latest, which lies in the plane's samples.
        unsafe { self.draw(plane, lines, out) };
        true
    }

    /// The end of the furthest of the samples that [`draw`](Self::draw) loads, counted from the plane's first.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn furthest(&self, stride: usize) -> usize {
        let mut furthest = 0;
        for ([first, second], [steep, other]) in self.at.iter().zip(&self.steep) {
            for i in 0..CHUNK {
                // one steep octet makes its whole block load a row more; `fit` saw to it that nothing overflows
                let more = if steep[i] | other[i] == 0 { 0 } else { stride as u32 };
                furthest = furthest.max(first[i].max(second[i]) + more);
            }
        }
        furthest as usize + (Self::ROWS - 1) * stride + LOAD
    }

    /// Finds the octets of lines that [fit](Lines::fit).
    #[target_feature(enable = "avx2")]
    #[inline]
    fn find(&mut self, stride: usize, lines: &Lines) {
        let ([xs, ys], [dxs, dys]) = (&lines.start, &lines.step);
        let first_sample = i32::from(CUBIC) * (stride as i32 + 1);
        for b in 0..BLOCKS {
            for half in 0..2 {
                let (at, place, steep) = (&mut self.at[b][half], &mut self.place[b][half], &mut self.steep[b][half]);
                let first = (BLOCK * b + 8 * half) as i32;
                for i in 0..CHUNK {
                    let x = xs[i] + first * dxs[i] + HALF_STEP;
                    let y = (ys[i] + first * dys[i]) & !15;
                    let end = y + 7 * (dys[i] & !15);
                    let row = y.min(end) >> 16;
                    at[i] = (row * stride as i32 + (x >> 16) - first_sample) as u32;
                    place[i] = ((x & 0xffff) >> 4 | (y - (row << 16)) >> 4 << 16) as u32;
                    steep[i] = (y.max(end) >> 16) - row;
                }
            }
        }
    }

    /// Draws the cells.
    ///
    /// # Safety
    /// The octets are those of these lines, which [fit](Lines::fit); [`furthest`](Self::furthest) lies in the plane's samples.
    #[target_feature(enable = "avx2")]
    #[inline]
    unsafe fn draw(&self, plane: PlaneRef<'_>, lines: &Lines, out: &mut [u8]) {
        let (samples, stride) = (plane.samples().as_ptr(), plane.stride());
        let [dxs, dys] = &lines.step;
        let n = _mm256_setr_epi16(0, 1, 2, 3, 4, 5, 6, 7, 0, 1, 2, 3, 4, 5, 6, 7);
        // bytes 0 and 1 (x), or 2 and 3 (y), to all
        let [spread_x, spread_y] = [_mm256_set1_epi16(0x0100), _mm256_set1_epi16(0x0302)];
        for (i, out) in out.chunks_exact_mut(BLOCKS * BLOCK).enumerate().take(CHUNK) {
            let ways = [dxs[i], dys[i]].map(|step| _mm256_mullo_epi16(n, _mm256_set1_epi16((step >> 4) as i16)));
            for (b, out) in out.chunks_exact_mut(BLOCK).enumerate() {
                let [first, second] = [0, 1].map(|half| self.at[b][half][i]);
                let [low, high] = [0, 1].map(|half| _mm_set1_epi32(self.place[b][half][i] as i32));
                let places = _mm256_set_m128i(high, low);
                let x = _mm256_add_epi16(_mm256_shuffle_epi8(places, spread_x), ways[0]);
                let y = _mm256_add_epi16(_mm256_shuffle_epi8(places, spread_y), ways[1]);
                // SAFETY: `LOAD` bytes, `down` rows below the octet's first; `furthest` counts as many rows as are asked for below.
                let load = |down: usize| unsafe {
                    let half = |at: u32| _mm_loadu_si128(samples.add(at as usize + down * stride).cast());
                    _mm256_set_m128i(half(second), half(first))
                };
                let flat = self.steep[b][0][i] | self.steep[b][1][i] == 0;
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
