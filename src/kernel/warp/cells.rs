//! A row of a plane as straight lines: from the nodes of the mesh above and below it, a line through the input for each cell.

use super::ONE;
use crate::kernel::{Level, dispatch};

/// Nodes lie between minus this and this (16.16 fixed point): their differences then fit, too.
pub const FURTHEST: i32 = (1 << 30) - 1;

/// How the samples of a plane lie among the pixels of luma, along one axis.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Axis {
    /// One sample to two pixels.
    pub halved: bool,
    /// Half a pixel further on than the pixels (halved planes only).
    pub between: bool,
}

/// The lines of a row's cells: cell after cell, first points (x, y) and steps from pixel to pixel, samples of the plane in 16.16
/// fixed point.
#[derive(Clone, Copy, Debug)]
pub struct Cells<'a> {
    /// First points.
    pub start: [&'a [i32]; 2],
    /// Steps.
    pub step: [&'a [i32]; 2],
    /// Pixels in a cell.
    pub wide: usize,
    /// What there is outside of the plane.
    pub outside: Outside,
    /// What there is between samples.
    pub filter: Filter,
}

/// How pixels that lie between samples are drawn.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Filter {
    /// From two by two neighbours.
    #[default]
    Bilinear,
    /// From four by four: sharper.
    Bicubic,
}

impl Filter {
    /// Neighbours that are looked at beyond the nearest two.
    pub(super) const fn reach(self) -> i32 {
        match self {
            Self::Bilinear => 0,
            Self::Bicubic => 1,
        }
    }
}

/// What is seen outside of a plane.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Outside {
    /// The plane mirrored at its edges, as often as it takes.
    #[default]
    Mirror,
    /// A sample's value.
    Value(u8),
}

/// A line: its first point and the step from pixel to pixel (x, y).
#[derive(Clone, Copy, Debug)]
pub(super) struct Line {
    pub(super) start: [i32; 2],
    pub(super) step: [i32; 2],
}

impl Cells<'_> {
    /// Cells that have all their numbers.
    #[inline(always)]
    pub(super) fn count(&self) -> usize {
        let of = |values: [&[i32]; 2]| values[0].len().min(values[1].len());
        of(self.start).min(of(self.step))
    }

    /// The line of cell `i`; no line where there is none.
    #[inline(always)]
    pub(super) fn line(&self, i: usize) -> Line {
        let of = |values: [&[i32]; 2]| values.map(|values| values.get(i).copied().unwrap_or(0));
        Line { start: of(self.start), step: of(self.step) }
    }
}

/// A row among the nodes: those above and those below it, luma pixels in 16.16 fixed point within [`FURTHEST`], and the way from
/// the ones to the others, `part` >> `part_bits` (at most 1).
#[derive(Clone, Copy, Debug)]
pub struct Between<'a> {
    /// Nodes above, one more than there are cells.
    pub above: &'a [i32],
    /// Nodes below.
    pub below: &'a [i32],
    /// Part of the way down.
    pub part: i32,
    /// Of which it is a part, as a power of two.
    pub part_bits: u32,
    /// Pixels of luma from node to node, as a power of two (at least 2).
    pub wide_bits: u32,
}

/// Finds one coordinate (`axis` says how the plane lies along it, `along_row` how it lies along rows) of a row's lines.
pub fn lines(level: Level, row: Between<'_>, axis: Axis, along_row: Axis, start: &mut [i32], step: &mut [i32]) {
    dispatch!(level, lines_body(row: Between<'_>, axis: Axis, along_row: Axis, start: &mut [i32], step: &mut [i32]))
}

#[inline(always)]
fn lines_body(row: Between<'_>, axis: Axis, along_row: Axis, start: &mut [i32], step: &mut [i32]) {
    let cells = start.len().min(step.len()).min(row.above.len().saturating_sub(1)).min(row.below.len().saturating_sub(1));
    let (start, step) = (&mut start[..cells], &mut step[..cells]);
    let (left, right) = ((&row.above[..cells], &row.below[..cells]), (&row.above[1..=cells], &row.below[1..=cells]));
    let (part, bits) = (row.part, row.part_bits);
    // the first sample of a cell lies half a pixel from its node, or on it
    let into = i32::from(along_row.between);
    let offset = if axis.between { ONE / 2 } else { 0 };
    let shrink = u32::from(axis.halved);
    let samples_bits = row.wide_bits - u32::from(along_row.halved) + shrink;
    for i in 0..cells {
        let from = left.0[i] + ((left.1[i] - left.0[i]) >> bits) * part;
        let to = right.0[i] + ((right.1[i] - right.0[i]) >> bits) * part;
        let way = to - from;
        start[i] = (from + (way >> (row.wide_bits + 1)) * into - offset) >> shrink;
        step[i] = way >> samples_bits;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Nodes at which a pixel (x, y) comes from (2 x + y / 2 + 3, x / 4 - y + 90), 16 rows from node to node.
    #[test]
    fn lines_go_where_a_linear_map_says() {
        let at = |x: f64, y: f64| [2.0 * x + 0.5 * y + 3.0, 0.25 * x - y + 90.0];
        let node = |y: f64, c: usize| [0, 32, 64].map(|x| (at(f64::from(x), y)[c] * f64::from(ONE)) as i32);
        let axes = [(false, false), (true, false), (true, true)].map(|(halved, between)| Axis { halved, between });
        for level in Level::all() {
            for (axis, along) in axes.into_iter().flat_map(|a| axes.map(|b| (a, b))) {
                for c in 0..2 {
                    let (above, below) = (node(32.0, c), node(48.0, c));
                    let row = Between { above: &above, below: &below, part: 5, part_bits: 5, wide_bits: 5 };
                    let (mut start, mut step) = ([0; 2], [0; 2]);
                    lines(level, row, axis, along, &mut start, &mut step);
                    for cell in 0..2 {
                        for k in 0..if along.halved { 16 } else { 32 } {
                            let scale = if along.halved { 2.0 } else { 1.0 };
                            let x = 32.0 * cell as f64 + scale * f64::from(k) + if along.between { 0.5 } else { 0.0 };
                            let wanted = at(x, 34.5)[c];
                            let wanted = (wanted - if axis.between { 0.5 } else { 0.0 }) / if axis.halved { 2.0 } else { 1.0 };
                            let found = f64::from(start[cell] + k * step[cell]) / f64::from(ONE);
                            assert!((found - wanted).abs() < 1e-3, "{axis:?} {along:?} {c}: {found} for {wanted}");
                        }
                    }
                }
            }
        }
    }
}
