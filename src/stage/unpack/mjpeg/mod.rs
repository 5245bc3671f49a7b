//! JPEG pictures to planar 4:2:0, by libjpeg-turbo.
//!
//! A frame's bytes may lie in memory that other processes can write. They are copied into private memory once, before anything else, and
//! only the copy is looked at: what was checked is what is decoded.
//!
//! The decoder's own check compares only the size, not the chroma, and it trusts the caller for the rest: a 4:4:4 picture
//! decoded into memory for 4:2:0 would be written past its end. So each picture's header is read first and has to have a size that the
//! stream allows and a known kind of chroma, and the memory it is decoded into is large enough for *every* kind.

mod markers;
mod standard;

use std::borrow::Cow;

use super::UnpackError;
use crate::image::{Picture, PlaneRef, Sampling};
use crate::kernel::Level;
use crate::kernel::convert::{self, NEUTRAL};
use turbojpeg::{Colorspace, DecompressHeader, Decompressor, Subsamp, YuvImage};

/// The most that a kind of chroma rounds a size up to, luma samples.
const LARGEST_STEP: usize = 4;

/// Progressive pictures may not have more scans than this; each costs a pass over the picture, however few its bytes.
const MOST_SCANS: u32 = 64;

/// A header may exceed the stream's size by less than this, rows or columns: the picture is cropped. Encoders round up to whole blocks.
const MOST_PADDING: usize = 16;

/// Pictures of another size than the stream's may have at most this many times its pixels.
const MOST_TIMES_LARGER: usize = 4;

/// A decoder and the memory that it works in.
#[derive(Default)]
pub(super) struct Mjpeg {
    /// Made with the first picture; made again after a failure, which can leave it in the midst of a header.
    decoder: Option<Decompressor>,
    /// The frame's bytes, our own.
    raw: Vec<u8>,
    /// The picture in them, as the decoder is to see it.
    jpeg: Vec<u8>,
    /// Planes as the picture has them, one after the other, room for 4:4:4.
    planes: Vec<u8>,
}

impl std::fmt::Debug for Mjpeg {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Mjpeg").field("planes", &self.planes.len()).finish_non_exhaustive()
    }
}

/// A picture in [`Mjpeg::planes`].
#[derive(Clone, Copy)]
struct Decoded {
    /// Luma samples across and down, as decoded.
    size: (usize, usize),
    subsampling: Subsamp,
}

impl Mjpeg {
    /// Decodes the picture in `bytes`, a frame of a stream whose pictures are to be `size` (width, height) large, into `into`. It takes
    /// that size, or the picture's own where that is another that the stream allows.
    pub(super) fn decode(
        &mut self,
        level: Level,
        size: (usize, usize),
        bytes: &[u8],
        into: &mut Picture,
    ) -> Result<(), UnpackError> {
        self.take_copy(size, bytes);
        let outcome = self.decode_planes(size);
        if outcome.is_err() {
            self.decoder = None;
        }
        let decoded = outcome?;
        let shown = shown_size(decoded.size, size);
        into.reshape(Sampling::S420, shown.0, shown.1);
        self.copy(level, decoded, into)
    }

    /// Bytes of memory that it holds for pictures.
    #[cfg(test)]
    pub(super) fn room(&self) -> usize {
        self.planes.capacity()
    }

    /// Copies a frame's bytes into memory of our own: the only time that they are touched.
    fn take_copy(&mut self, size: (usize, usize), bytes: &[u8]) {
        // Frames differ in length. What most cameras' drivers give room for is reserved at once, so that a longer one than all before it
        // takes no memory then.
        let room = bytes.len().max(2 * size.0 * size.1) + ROOM_FOR_HEADERS;
        for buffer in [&mut self.raw, &mut self.jpeg] {
            buffer.clear();
            buffer.reserve(room);
        }
        self.raw.extend_from_slice(bytes);
    }

    /// Decodes into `self.planes`; says what is there.
    fn decode_planes(&mut self, size: (usize, usize)) -> Result<Decoded, UnpackError> {
        let mut own = markers::extract(&self.raw, &mut self.jpeg)?;
        own.resize_within_units(size, &mut self.jpeg);
        let decoder = match &mut self.decoder {
            Some(decoder) => decoder,
            none => {
                let mut decoder = Decompressor::new().map_err(damaged)?;
                decoder.set_scan_limit(MOST_SCANS).map_err(damaged)?;
                none.insert(decoder)
            }
        };
        let header = decoder.read_header(&self.jpeg).map_err(damaged)?;
        check(&header, size)?;
        let found = (header.width, header.height);
        let room = 3 * found.0.next_multiple_of(LARGEST_STEP) * found.1.next_multiple_of(LARGEST_STEP);
        if self.planes.len() < room {
            self.planes.resize(room, 0);
        }
        let decoded = Decoded { size: found, subsampling: header.subsamp };
        let output =
            YuvImage { pixels: &mut self.planes[..], width: found.0, align: 1, height: found.1, subsamp: header.subsamp };
        match decoder.decompress_to_yuv(&self.jpeg, output) {
            Ok(()) if own.ended => Ok(decoded),
            Ok(()) => Err(UnpackError::Damaged { what: "it has no end marker".into() }),
            Err(error) if is_harmless(&error) && own.ended => Ok(decoded),
            Err(error) => Err(damaged(error)),
        }
    }

    /// Copies the decoded planes into the picture.
    fn copy(&self, level: Level, decoded: Decoded, into: &mut Picture) -> Result<(), UnpackError> {
        let Decoded { size, subsampling } = decoded;
        let (x, y) = subsampling.size();
        let (luma_width, luma_rows) = (size.0.next_multiple_of(x), size.1.next_multiple_of(y));
        let size = (into.width(), into.height());
        let (chroma_width, chroma_rows) = (luma_width / x, luma_rows / y);
        let plane = |offset: usize, (width, height): (usize, usize), stride: usize| {
            self.planes.get(offset..).and_then(|samples| PlaneRef::new(samples, width, height, stride))
        };
        let lost = || UnpackError::Damaged { what: "its planes do not fit".into() };
        let [mut luma, u, v] = into.as_mut().planes;
        luma.copy_from(plane(0, size, luma_width).ok_or_else(lost)?);
        let chroma = luma_width * luma_rows;
        for (n, mut out) in [u, v].into_iter().enumerate() {
            if subsampling == Subsamp::Gray {
                out.fill(NEUTRAL);
                continue;
            }
            let offset = chroma + n * chroma_width * chroma_rows;
            let from = plane(offset, (size.0.div_ceil(x), size.1.div_ceil(y)), chroma_width).ok_or_else(lost)?;
            convert::to_420(level, (x, y), from, out);
        }
        Ok(())
    }
}

/// The size in which a picture of size `found` is shown in a stream of size `expected`: one that is a little larger is cropped.
fn shown_size(found: (usize, usize), expected: (usize, usize)) -> (usize, usize) {
    let is_padded = |found: usize, expected: usize| (expected..expected + MOST_PADDING).contains(&found);
    if is_padded(found.0, expected.0) && is_padded(found.1, expected.1) { expected } else { found }
}

/// Whether a picture with this header may be decoded as one of a stream of size `expected`.
fn check(header: &DecompressHeader, expected: (usize, usize)) -> Result<(), UnpackError> {
    let found = (header.width, header.height);
    let shown = shown_size(found, expected);
    if shown.0 * shown.1 > MOST_TIMES_LARGER * expected.0 * expected.1 {
        return Err(UnpackError::SizeMismatch { found, expected });
    }
    let what = if header.is_lossless {
        "lossless"
    } else if header.subsamp == Subsamp::Unknown {
        "of an unknown kind of chroma"
    } else {
        match header.colorspace {
            Colorspace::YCbCr | Colorspace::Gray => return Ok(()),
            Colorspace::RGB => "stored as RGB",
            Colorspace::CMYK | Colorspace::YCCK => "stored as CMYK",
        }
    };
    Err(UnpackError::Unsupported { what })
}

/// The most that a picture grows when it is extracted: the standard tables, a colour transform, an end.
const ROOM_FOR_HEADERS: usize = 1024;

/// Stray bytes before the end that are forgiven; what is left over of a picture that lost its way is more.
const MOST_STRAY: u32 = 16;

/// Whether the decoder only complains of what many cameras do in every frame, the picture being whole: a few stray bytes before
/// the end marker (the samples before them were read without complaint, or that would be the message).
fn is_harmless(error: &turbojpeg::Error) -> bool {
    let turbojpeg::Error::TurboJpegError(what) = error else { return false };
    let count =
        what.strip_prefix("Corrupt JPEG data: ").and_then(|rest| rest.strip_suffix(" extraneous bytes before marker 0xd9"));
    count.and_then(|count| count.parse().ok()).is_some_and(|count: u32| count <= MOST_STRAY)
}

fn damaged(error: turbojpeg::Error) -> UnpackError {
    let what = match error {
        turbojpeg::Error::TurboJpegError(what) => what,
        other => other.to_string(),
    };
    UnpackError::Damaged { what: Cow::Owned(what) }
}

#[cfg(test)]
mod tests;
