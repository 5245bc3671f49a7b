//! JPEG pictures to planar 4:2:0, by libjpeg-turbo.
//!
//! A frame's bytes may lie in memory that other processes can write. They are copied into private memory once, before anything else, and
//! only the copy is looked at: what was checked is what is decoded.
//!
//! The decoder's own check compares only the size, not the chroma, and it trusts the caller for the rest: a 4:4:4 picture
//! decoded into memory for 4:2:0 would be written past its end. So each picture's header is read first and has to have a size that the
//! stream allows, and the memory it is decoded into is large enough for *every* kind of chroma.
//!
//! The way of a picture: [`markers::extract`] writes it out as the decoder is to see it; it is decoded; where the decoder complains,
//! [`scan::follow`] says whether samples are missing or whether there is only more than there should be.

mod canvas;
mod decoder;
mod markers;
mod scan;
mod standard;

use super::UnpackError;
use crate::image::{Picture, Range};
use crate::kernel::Level;
use canvas::{Canvas, Shape};
use decoder::{Decoder, Extent};
use markers::{Field, Header};

/// A header may exceed the stream's size by less than this, rows or columns: the picture is cropped. Encoders round up to whole blocks.
const MAX_PADDING: usize = 16;

/// The most that a picture grows when it is extracted: the standard tables, a colour transform, an end.
const ROOM_FOR_HEADERS: usize = 1024;

/// A whole picture adds this to the balance of whole and cut ones, a cut picture takes one away: where more than three in four are cut,
/// it is low.
const WHOLE: u8 = 3;
/// The balance goes up to this.
const MAX_WHOLE: u8 = 16;
/// A balance above this makes a cut picture an exception.
const MOSTLY_WHOLE: u8 = 8;

/// A decoder and the memory that it works in.
#[derive(Default)]
pub(super) struct Mjpeg {
    decoder: Decoder,
    /// The frame's bytes, our own.
    raw: Vec<u8>,
    /// The picture in them, as the decoder is to see it; where it is a field, the other one too.
    jpegs: [Vec<u8>; 2],
    /// The picture that is decoded, and the last one that was shown.
    canvases: [Canvas; 2],
    /// One field of an interlaced picture.
    field: Canvas,
    /// Goes up with each whole picture, down with each that is cut.
    balance: u8,
    cut: Option<UnpackError>,
}

impl std::fmt::Debug for Mjpeg {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Mjpeg").field("balance", &self.balance).field("cut", &self.cut).finish_non_exhaustive()
    }
}

impl Mjpeg {
    /// Decodes the picture in `bytes`, a frame of a stream whose pictures are to be `size` (width, height) large and have samples of
    /// `range`, into `into`. It takes that size, or the picture's own where that is another that the stream allows.
    ///
    /// Of a picture that is cut off, the rows that are there are shown with the last picture's below them, where nearly all pictures
    /// are cut or none came yet. Elsewhere it is an error: the picture before, shown once more, is hardly seen, while the seam
    /// between two pictures of a moving camera is.
    pub(super) fn decode(
        &mut self,
        level: Level,
        range: Range,
        size: (usize, usize),
        bytes: &[u8],
        into: &mut Picture,
    ) -> Result<(), UnpackError> {
        self.cut = None;
        self.take_copy(size, bytes);
        let extent = self.decode_frame(size)?;
        self.complete(extent)?;
        let [canvas, _] = &self.canvases;
        let shown = shown_size(canvas.shape().map_or(size, |shape| shape.size), size);
        canvas.show(level, range, shown, into)?;
        self.canvases.swap(0, 1);
        Ok(())
    }

    /// Why the last picture is not all of its frame, though it is shown.
    pub(super) fn cut(&self) -> Option<&UnpackError> {
        self.cut.as_ref()
    }

    /// Bytes of memory that it holds for a picture, at most.
    #[cfg(test)]
    pub(super) fn room(&self) -> usize {
        self.canvases.iter().chain([&self.field]).map(Canvas::room).max().unwrap_or(0)
    }

    /// Copies a frame's bytes into memory of our own: the only time that they are touched.
    fn take_copy(&mut self, size: (usize, usize), bytes: &[u8]) {
        // Frames differ in length. What most cameras' drivers give room for is reserved at once, so that a longer one than all before it
        // takes no memory then.
        let room = bytes.len().max(2 * size.0 * size.1) + ROOM_FOR_HEADERS;
        for buffer in [&mut self.raw, &mut self.jpegs[0]] {
            buffer.clear();
            buffer.reserve(room);
        }
        self.raw.extend_from_slice(bytes);
    }

    /// Decodes the frame into the first canvas: its picture, or both fields of it.
    fn decode_frame(&mut self, size: (usize, usize)) -> Result<Extent, UnpackError> {
        let [jpeg, other] = &mut self.jpegs;
        let mut header = markers::extract(&self.raw, 0, jpeg)?;
        if is_field(&header, size)
            && let Ok(mut second) = markers::extract(&self.raw, header.next, other)
            && second.size == header.size
        {
            let half = (size.0, size.1.div_ceil(2));
            header.resize_within_units(half, jpeg);
            second.resize_within_units(half, other);
            return self.decode_fields(&header, &second, size);
        }
        header.resize_within_units(size, jpeg);
        self.decoder.decode(jpeg, &header, size, &mut self.canvases[0])
    }

    /// Decodes both fields and lays their rows into each other.
    fn decode_fields(&mut self, first: &Header, second: &Header, size: (usize, usize)) -> Result<Extent, UnpackError> {
        let damaged = |what: &'static str| UnpackError::Damaged { what: what.into() };
        // Where neither says which it is, the first has the first row.
        let first_row = usize::from(first.field == Some(Field::Bottom) || second.field == Some(Field::Top));
        for (n, header) in [first, second].into_iter().enumerate() {
            if self.decoder.decode(&mut self.jpegs[n], header, size, &mut self.field)? != Extent::Whole {
                return Err(damaged("one of its two fields is cut off"));
            }
            let woven = self.field.shape().map(|shape| Shape { size: (shape.size.0, 2 * shape.size.1), ..shape });
            match woven {
                Some(shape) if n == 0 => {
                    self.canvases[0].prepare(shape);
                }
                woven if woven == self.canvases[0].shape() => {}
                _ => return Err(damaged("its two fields have different kinds of chroma")),
            }
            self.canvases[0].weave(&self.field, n ^ first_row);
        }
        Ok(Extent::Whole)
    }

    /// Sees to the rows that a decoded picture does not have, or refuses it.
    fn complete(&mut self, extent: Extent) -> Result<(), UnpackError> {
        let Extent::Rows(rows) = extent else {
            self.balance = (self.balance + WHOLE).min(MAX_WHOLE);
            return Ok(());
        };
        let is_exception = self.balance > MOSTLY_WHOLE;
        self.balance = self.balance.saturating_sub(1);
        let [canvas, last] = &mut self.canvases;
        let cut = UnpackError::Cut { rows, of: canvas.shape().map_or(0, |shape| shape.size.1) };
        if is_exception || rows == 0 {
            return Err(cut);
        }
        canvas.complete(rows, last);
        self.cut = Some(cut);
        Ok(())
    }
}

/// The size in which a picture of size `found` is shown in a stream of size `expected`: one that is a little larger is cropped.
fn shown_size(found: (usize, usize), expected: (usize, usize)) -> (usize, usize) {
    let is_padded = |found: usize, expected: usize| (expected..expected + MAX_PADDING).contains(&found);
    if is_padded(found.0, expected.0) && is_padded(found.1, expected.1) { expected } else { found }
}

/// Whether a picture may be one of two fields of a picture of size `expected`.
fn is_field(header: &Header, expected: (usize, usize)) -> bool {
    header.size.1 < expected.1 && shown_size((header.size.0, 2 * header.size.1), expected) == expected
}

#[cfg(test)]
mod tests;
