//! A decoded picture in the decoder's layout: where its planes and rows lie, and the way from there to planar 4:2:0
//! of limited range.

use super::super::UnpackError;
use crate::image::{FromRgb, Picture, PlaneRef, Range, Sampling, ToLimited};
use crate::kernel::Level;
use crate::kernel::convert::{self, NEUTRAL, RgbOrder};
use turbojpeg::Subsamp;

/// The most that a kind of chroma rounds a size up to, luma samples.
const LARGEST_STEP: usize = 4;

/// What the samples of a decoded picture are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Samples {
    /// Planes of luma and, unless it is grey, two of chroma, one after the other.
    Planes(Subsamp),
    /// R G B. For chroma that the decoder gives no other way.
    Rgb,
}

/// Size and layout of a decoded picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Shape {
    /// Luma samples across and down.
    pub(super) size: (usize, usize),
    pub(super) samples: Samples,
}

/// One plane in the decoder's memory.
#[derive(Clone, Copy)]
struct Lines {
    offset: usize,
    /// Bytes of a row; rows have no padding.
    bytes: usize,
    rows: usize,
    /// Luma rows to one of these.
    step: usize,
}

impl Shape {
    /// Bytes that a picture of this size needs, whatever its samples are.
    fn room(self) -> usize {
        3 * self.size.0.next_multiple_of(LARGEST_STEP) * self.size.1.next_multiple_of(LARGEST_STEP)
    }

    fn planes(self) -> impl Iterator<Item = Lines> {
        let (width, height) = self.size;
        let (count, (x, y)) = match self.samples {
            Samples::Rgb => (1, (1, 1)),
            Samples::Planes(Subsamp::Gray) => (1, (1, 1)),
            Samples::Planes(subsampling) => (3, subsampling.size()),
        };
        let (luma, rows) = (width.next_multiple_of(x), height.next_multiple_of(y));
        let first = Lines { offset: 0, bytes: if self.samples == Samples::Rgb { 3 * width } else { luma }, rows, step: 1 };
        let (bytes, chroma_rows) = (luma / x, rows / y);
        let chroma = move |n| Lines { offset: luma * rows + n * bytes * chroma_rows, bytes, rows: chroma_rows, step: y };
        [first, chroma(0), chroma(1)].into_iter().take(count)
    }
}

/// Memory for a decoded picture, and the picture that it holds.
#[derive(Default)]
pub(super) struct Canvas {
    memory: Vec<u8>,
    shape: Option<Shape>,
}

impl Canvas {
    /// Memory for a picture of `shape`, to decode into.
    pub(super) fn prepare(&mut self, shape: Shape) -> &mut [u8] {
        if self.memory.len() < shape.room() {
            self.memory.resize(shape.room(), 0);
        }
        self.shape = Some(shape);
        &mut self.memory
    }

    /// The picture that it holds.
    pub(super) fn shape(&self) -> Option<Shape> {
        self.shape
    }

    /// Bytes that it has.
    #[cfg(test)]
    pub(super) fn room(&self) -> usize {
        self.memory.capacity()
    }

    /// Writes `field`'s rows into every other row, from row `first` on; this canvas is prepared for twice its height.
    pub(super) fn weave(&mut self, field: &Self, first: usize) {
        let (Some(own), Some(from)) = (self.shape, field.shape) else { return };
        for (to, from) in own.planes().zip(from.planes()) {
            let rows = field.memory[from.offset..].chunks_exact(from.bytes).take(from.rows);
            let lines = self.memory[to.offset..].chunks_exact_mut(to.bytes).take(to.rows).skip(first).step_by(2);
            lines.zip(rows).for_each(|(line, row)| line.copy_from_slice(row));
        }
    }

    /// Takes all that lies below `rows` luma rows from `other`, a picture of the same shape; where that is another, repeats the last row.
    pub(super) fn complete(&mut self, rows: usize, other: &Self) {
        let Some(shape) = self.shape else { return };
        let same = other.shape == self.shape;
        for lines in shape.planes() {
            let (from, end) = (lines.offset + rows / lines.step * lines.bytes, lines.offset + lines.rows * lines.bytes);
            if same {
                self.memory[from..end].copy_from_slice(&other.memory[from..end]);
            } else if let Some(last) = from.checked_sub(lines.bytes).filter(|&last| last >= lines.offset) {
                for to in (from..end).step_by(lines.bytes) {
                    self.memory.copy_within(last..from, to);
                }
            }
        }
    }

    /// Copies the picture's top left, `width` x `height` luma samples, into `into`, from samples of `range`.
    pub(super) fn show(
        &self,
        level: Level,
        range: Range,
        (width, height): (usize, usize),
        into: &mut Picture,
    ) -> Result<(), UnpackError> {
        let lost = || UnpackError::Damaged { what: "its planes do not fit".into() };
        let shape = self.shape.ok_or_else(lost)?;
        into.reshape(Sampling::S420, width, height);
        let plane = |lines: Lines, width: usize, height: usize| {
            self.memory.get(lines.offset..).and_then(|samples| PlaneRef::new(samples, width, height, lines.bytes))
        };
        let mut planes = shape.planes();
        let first = planes.next().ok_or_else(lost)?;
        let subsampling = match shape.samples {
            Samples::Rgb => {
                let from = plane(first, 3 * width, height).ok_or_else(lost)?;
                convert::rgb(level, RgbOrder::Rgb, FromRgb::new(range), from, into.as_mut());
                return Ok(());
            }
            Samples::Planes(subsampling) => subsampling,
        };
        let [mut luma, u, v] = into.as_mut().planes;
        let from = plane(first, width, height).ok_or_else(lost)?;
        match range {
            Range::Full => convert::to_limited(level, ToLimited::LUMA, from, luma),
            _ => luma.copy_from(from),
        }
        let (x, y) = subsampling.size();
        for mut out in [u, v] {
            match planes.next() {
                None => out.fill(NEUTRAL),
                Some(lines) => {
                    let from = plane(lines, width.div_ceil(x), height.div_ceil(y)).ok_or_else(lost)?;
                    convert::to_420(level, (x, y), from, out.reborrow());
                    if range == Range::Full {
                        convert::to_limited_in_place(level, ToLimited::CHROMA, out);
                    }
                }
            }
        }
        Ok(())
    }
}
