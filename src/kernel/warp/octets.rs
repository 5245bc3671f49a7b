//! Rows by octets, for the instruction sets that draw eight pixels at once: which lines allow it, and where their octets lie.
//!
//! Eight neighbours on a line that is not much longer than they are lie within sixteen bytes of each row, and, where the line is not
//! too steep, within three rows (bicubic: five). So nothing is gathered: each octet loads its own sixteen bytes of each row, and
//! pixels are shuffled out of them.
//!
//! All here is compiled for the instruction set that calls it: it is inlined into functions that have been told of it.

use std::ops::Range;

use super::{Cells, Filter, HALF_STEP, MARGIN, is_inside, scalar};
use crate::image::PlaneRef;

/// Pixels of a block: two octets.
pub(super) const BLOCK: usize = 16;
/// Pixels of an octet.
pub(super) const OCTET: usize = 8;
/// The largest step along x, bilinear and bicubic: eight pixels then span no more than fifteen bytes, their neighbours included.
const LONGEST: [i32; 2] = [7 << 14, 6 << 14];
/// The largest step along y, either way: eight pixels then lie between three rows at most.
const STEEPEST: i32 = (1 << 16) / 8;
/// Bytes that are loaded of each row of an octet.
const LOAD: usize = 16;
/// Rows that are loaded of an octet at most: four, and one more where it is steep.
const MAX_ROWS: i64 = 5;
/// Cells whose octets are found at a time.
pub(super) const CHUNK: usize = 32;

/// Cells of these that are looked at in one go: a chunk need not be full.
const GROUP: usize = 16;

/// An instruction set that draws octets.
pub(super) trait Draw: Sized {
    /// Calls [`cells_of`], compiled for these instructions.
    ///
    /// # Safety
    /// The processor has them.
    unsafe fn cells<const BLOCKS: usize, const CUBIC: bool, const N: usize>(
        planes: [PlaneRef<'_>; N],
        cells: Cells<'_>,
        outs: [&mut [u8]; N],
    );

    /// Calls [`Octets::drawn`], compiled for these instructions.
    ///
    /// # Safety
    /// The processor has them. The planes are [alike](super::alike).
    unsafe fn drawn<const BLOCKS: usize, const CUBIC: bool, const N: usize>(
        octets: &mut Octets<BLOCKS, CUBIC>,
        planes: [PlaneRef<'_>; N],
        cells: Cells<'_>,
        lines: &Lines,
        outs: [&mut [u8]; N],
    ) -> bool;

    /// Draws the cells.
    ///
    /// # Safety
    /// The processor has these instructions. The planes are [alike](super::alike). The octets are those of these lines, which [fit](Lines::fit) the first
    /// plane; [`furthest`](Octets::furthest) lies in its samples.
    unsafe fn draw<const BLOCKS: usize, const CUBIC: bool, const N: usize>(
        octets: &Octets<BLOCKS, CUBIC>,
        planes: [PlaneRef<'_>; N],
        lines: &Lines,
        outs: [&mut [u8]; N],
    );
}

/// Draws rows as [`super::rows`] does. Planes and rows are alike; the rows are no longer than the cells.
///
/// # Safety
/// The processor has the instructions of `D`. The planes are [alike](super::alike).
pub(super) unsafe fn rows<D: Draw, const N: usize>(planes: [PlaneRef<'_>; N], cells: Cells<'_>, outs: [&mut [u8]; N]) {
    // SAFETY: the caller's promise.
    unsafe {
        match (cells.wide, cells.filter) {
            (16, Filter::Bilinear) => D::cells::<1, false, N>(planes, cells, outs),
            (32, Filter::Bilinear) => D::cells::<2, false, N>(planes, cells, outs),
            (64, Filter::Bilinear) => D::cells::<4, false, N>(planes, cells, outs),
            (16, Filter::Bicubic) => D::cells::<1, true, N>(planes, cells, outs),
            (32, Filter::Bicubic) => D::cells::<2, true, N>(planes, cells, outs),
            (64, Filter::Bicubic) => D::cells::<4, true, N>(planes, cells, outs),
            _ => planes.into_iter().zip(outs).for_each(|(plane, out)| super::row_scalar(plane, cells, out)),
        }
    }
}

/// As [`rows`], for cells of `BLOCKS` blocks.
///
/// # Safety
/// As [`rows`].
#[inline(always)]
pub(super) unsafe fn cells_of<D: Draw, const BLOCKS: usize, const CUBIC: bool, const N: usize>(
    planes: [PlaneRef<'_>; N],
    cells: Cells<'_>,
    mut outs: [&mut [u8]; N],
) {
    let mut octets = Octets::<BLOCKS, CUBIC>::new();
    let len = outs.first().map_or(0, |out| out.len());
    let count = len.div_ceil(cells.wide);
    for n in (0..count).step_by(CHUNK) {
        let next = count.min(n + CHUNK);
        // SAFETY: the caller's promise; so below.
        let mut drawn = |range: Range<usize>, outs: [&mut [u8]; N]| unsafe {
            D::drawn(&mut octets, planes, cells, &Lines::of(cells, range), outs)
        };
        if drawn(n..next, part(&mut outs, n * cells.wide..len.min(next * cells.wide))) {
            continue;
        }
        for i in n..next {
            let pixels = i * cells.wide..len.min((i + 1) * cells.wide);
            if !drawn(i..i + 1, part(&mut outs, pixels.clone())) {
                let outs = part(&mut outs, pixels);
                planes.into_iter().zip(outs).for_each(|(plane, out)| scalar(plane, cells.line(i), cells, out));
            }
        }
    }
}

/// The same part of each row.
#[inline(always)]
fn part<'a, const N: usize>(outs: &'a mut [&mut [u8]; N], pixels: Range<usize>) -> [&'a mut [u8]; N] {
    outs.each_mut().map(|out| &mut out[pixels.clone()])
}

/// The lines of some cells; those beyond `count` repeat the last.
pub(super) struct Lines {
    count: usize,
    start: [[i32; CHUNK]; 2],
    /// Steps (x, y) of each cell's line.
    pub(super) step: [[i32; CHUNK]; 2],
}

impl Lines {
    /// The lines of at most [`CHUNK`] cells, at least one.
    #[inline(always)]
    fn of(cells: Cells<'_>, range: Range<usize>) -> Self {
        let last = cells.line(range.end - 1);
        let mut lines = Self { count: range.len(), start: last.start.map(|x| [x; CHUNK]), step: last.step.map(|x| [x; CHUNK]) };
        for axis in 0..2 {
            lines.start[axis][..range.len()].copy_from_slice(&cells.start[axis][range.clone()]);
            lines.step[axis][..range.len()].copy_from_slice(&cells.step[axis][range.clone()]);
        }
        lines
    }

    /// Cells that are to be drawn.
    #[inline(always)]
    pub(super) fn count(&self) -> usize {
        self.count
    }

    /// Lines up to the end of the last group.
    #[inline(always)]
    fn padded(&self) -> usize {
        self.count.next_multiple_of(GROUP).min(CHUNK)
    }

    /// The least and the greatest of the starts, of the steps and of the ends of lines of `wide` pixels, along an axis.
    #[inline(always)]
    fn ranges(&self, axis: usize, wide: usize) -> [[i32; 2]; 3] {
        let (mut starts, mut steps, mut ends) = ([i32::MAX, i32::MIN], [i32::MAX, i32::MIN], [i32::MAX, i32::MIN]);
        let padded = self.padded();
        for (&start, &step) in self.start[axis][..padded].iter().zip(&self.step[axis][..padded]) {
            let end = start.wrapping_add(step.wrapping_mul(wide as i32 - 1));
            starts = [starts[0].min(start), starts[1].max(start)];
            steps = [steps[0].min(step), steps[1].max(step)];
            ends = [ends[0].min(end), ends[1].max(end)];
        }
        [starts, steps, ends]
    }

    /// Where every pixel of these cells, with its neighbours, lies inside the plane, their lines are as short and flat as octets need, and
    /// what [`Octets::find`] computes fits its 32 bits: how many of the plane's samples their octets load from at most, counted from its
    /// first.
    #[inline(always)]
    fn fit(&self, plane: PlaneRef<'_>, cells: Cells<'_>) -> Option<usize> {
        let (wide, longest) = (cells.wide, LONGEST[cells.filter.reach() as usize]);
        let [xs, dxs, x_ends] = self.ranges(0, wide);
        let [ys, dys, y_ends] = self.ranges(1, wide);
        // steps this short and starts this near cannot have overflowed on their way to the ends
        let near = xs[0].min(ys[0]) >= MARGIN && xs[1].max(ys[1]) < 1 << 30;
        if !(near && dxs[0] >= 0 && dxs[1] <= longest && dys[0] >= -STEEPEST && dys[1] <= STEEPEST) {
            return None;
        }
        let low = [xs[0].min(x_ends[0]), ys[0].min(y_ends[0])].map(i64::from);
        let high = [xs[1].max(x_ends[1]), ys[1].max(y_ends[1])].map(i64::from);
        let rows = ((high[1] >> 16) + MAX_ROWS).saturating_mul(plane.stride() as i64);
        let furthest = rows.saturating_add(high[0] >> 16).saturating_add(2 * LOAD as i64);
        // a point's own row and the column it is rounded to, the rows after it, the bytes of an octet
        (is_inside(plane, cells.filter, [low, high]) && furthest < i64::from(i32::MAX)).then_some(furthest as usize)
    }
}

/// Where the octets of some cells begin: by block, by half of a block, by cell.
pub(super) struct Octets<const BLOCKS: usize, const CUBIC: bool> {
    /// Sample of the leftmost column in the uppermost row.
    pub(super) at: [[[u32; CHUNK]; 2]; BLOCKS],
    /// The first pixel's place from there on (bicubic: from a column and a row further): x in the low half, y in the high one, 1/4096.
    pub(super) place: [[[u32; CHUNK]; 2]; BLOCKS],
    /// Not 0 where the octet touches one row more.
    pub(super) steep: [[[i32; CHUNK]; 2]; BLOCKS],
}

impl<const BLOCKS: usize, const CUBIC: bool> Octets<BLOCKS, CUBIC> {
    /// Rows that are loaded of a block of flat octets; of one with a steep octet, one more.
    const ROWS: usize = if CUBIC { 4 } else { 2 };

    fn new() -> Self {
        Self { at: [[[0; CHUNK]; 2]; BLOCKS], place: [[[0; CHUNK]; 2]; BLOCKS], steep: [[[0; CHUNK]; 2]; BLOCKS] }
    }

    /// Draws the cells of `lines` into `outs`, unless octets cannot: then these are as they were, and `false` is returned.
    ///
    /// # Safety
    /// The processor has the instructions of `D`. The planes are [alike](super::alike).
    #[inline(always)]
    pub(super) unsafe fn drawn<D: Draw, const N: usize>(
        &mut self,
        planes: [PlaneRef<'_>; N],
        cells: Cells<'_>,
        lines: &Lines,
        outs: [&mut [u8]; N],
    ) -> bool {
        let Some(&plane) = planes.first() else { return true };
        if outs.iter().any(|out| out.len() != lines.count * cells.wide) {
            return false;
        }
        let Some(most) = lines.fit(plane, cells) else { return false };
        self.find(plane.stride(), lines);
        // octet by octet only near the plane's end
        let there_are = plane.samples().len();
        if most > there_are && self.furthest(plane.stride(), lines) > there_are {
            return false;
        }
        // SAFETY: the caller's promise; and all that `draw` loads ends at `furthest` at the latest, which is no more than `most`, and one of
        // both lies in the plane's samples.
        unsafe { D::draw(self, planes, lines, outs) };
        true
    }

    /// The end of the furthest of the samples that [`Draw::draw`] loads, counted from the plane's first.
    #[inline(always)]
    fn furthest(&self, stride: usize, lines: &Lines) -> usize {
        let mut furthest = 0;
        for ([first, second], [steep, other]) in self.at.iter().zip(&self.steep) {
            for i in 0..lines.count {
                // one steep octet makes its whole block load a row more; `fit` saw to it that nothing overflows
                let more = if steep[i] | other[i] == 0 { 0 } else { stride as u32 };
                furthest = furthest.max(first[i].max(second[i]) + more);
            }
        }
        furthest as usize + (Self::ROWS - 1) * stride + LOAD
    }

    /// Finds the octets of lines that [fit](Lines::fit).
    #[inline(always)]
    fn find(&mut self, stride: usize, lines: &Lines) {
        let ([xs, ys], [dxs, dys]) = (&lines.start, &lines.step);
        let first_sample = i32::from(CUBIC) * (stride as i32 + 1);
        let padded = lines.padded();
        for b in 0..BLOCKS {
            for half in 0..2 {
                let (at, place, steep) = (&mut self.at[b][half], &mut self.place[b][half], &mut self.steep[b][half]);
                let first = (BLOCK * b + OCTET * half) as i32;
                for i in 0..padded {
                    let x = xs[i] + first * dxs[i] + HALF_STEP;
                    let y = (ys[i] + first * dys[i]) & !15;
                    let end = y + (OCTET as i32 - 1) * (dys[i] & !15);
                    let row = y.min(end) >> 16;
                    at[i] = (row * stride as i32 + (x >> 16) - first_sample) as u32;
                    place[i] = ((x & 0xffff) >> 4 | (y - (row << 16)) >> 4 << 16) as u32;
                    steep[i] = (y.max(end) >> 16) - row;
                }
            }
        }
    }
}
