//! JPEG pictures to planar 4:2:0, by libjpeg-turbo.
//!
//! The decoder's own check compares only the size, not the chroma, and it trusts the caller for the rest: a 4:4:4 picture
//! decoded into memory for 4:2:0 would be written past its end. So each picture's header is read first and has to have the
//! stream's size and a known kind of chroma, and the memory it is decoded into is large enough for *every* kind.

use super::UnpackError;
use crate::image::{Picture, PlaneRef, Sampling};
use crate::kernel::Level;
use crate::kernel::convert::{self, NEUTRAL};
use turbojpeg::{Colorspace, DecompressHeader, Decompressor, Subsamp, YuvImage};

/// The most that a kind of chroma rounds a size up to, luma samples.
const LARGEST_STEP: usize = 4;

/// Progressive pictures may not have more scans than this; each costs a pass over the picture, however few its bytes.
const MOST_SCANS: u32 = 64;

/// A decoder and the memory that it decodes into.
#[derive(Default)]
pub(super) struct Mjpeg {
    /// Made with the first picture; made anew after a failure, which can leave it in the midst of a header.
    decoder: Option<Decompressor>,
    /// Planes as the picture has them, one after the other, room for 4:4:4.
    planes: Vec<u8>,
}

impl std::fmt::Debug for Mjpeg {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Mjpeg").field("planes", &self.planes.len()).finish_non_exhaustive()
    }
}

impl Mjpeg {
    /// Decodes the picture in `bytes`, which is to be `size` (width, height) large, into `into`.
    pub(super) fn decode(
        &mut self,
        level: Level,
        size: (usize, usize),
        bytes: &[u8],
        into: &mut Picture,
    ) -> Result<(), UnpackError> {
        let outcome = self.decode_planes(size, bytes);
        if outcome.is_err() {
            self.decoder = None;
        }
        let subsampling = outcome?;
        into.reshape(Sampling::S420, size.0, size.1);
        self.copy(level, size, subsampling, into)
    }

    /// Bytes of memory that it holds.
    #[cfg(test)]
    pub(super) fn room(&self) -> usize {
        self.planes.capacity()
    }

    /// Decodes into `self.planes`; says what chroma there is.
    fn decode_planes(&mut self, size: (usize, usize), bytes: &[u8]) -> Result<Subsamp, UnpackError> {
        let decoder = match &mut self.decoder {
            Some(decoder) => decoder,
            none => {
                let mut decoder = Decompressor::new().map_err(damaged)?;
                decoder.set_scan_limit(MOST_SCANS).map_err(damaged)?;
                none.insert(decoder)
            }
        };
        if bytes.is_empty() {
            return Err(UnpackError::Damaged { what: "it has no bytes".into() });
        }
        let header = decoder.read_header(bytes).map_err(damaged)?;
        check(&header, size)?;
        let room = 3 * size.0.next_multiple_of(LARGEST_STEP) * size.1.next_multiple_of(LARGEST_STEP);
        if self.planes.len() < room {
            self.planes.resize(room, 0);
        }
        let output =
            YuvImage { pixels: &mut self.planes[..], width: size.0, align: 1, height: size.1, subsamp: header.subsamp };
        match decoder.decompress_to_yuv(bytes, output) {
            Ok(()) => Ok(header.subsamp),
            Err(error) if is_harmless(&error) && has_end(bytes) => Ok(header.subsamp),
            Err(error) => Err(damaged(error)),
        }
    }

    /// Copies the decoded planes into the picture.
    fn copy(&self, level: Level, size: (usize, usize), subsampling: Subsamp, into: &mut Picture) -> Result<(), UnpackError> {
        let (x, y) = subsampling.size();
        let (luma_width, luma_rows) = (size.0.next_multiple_of(x), size.1.next_multiple_of(y));
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

/// Whether a picture with this header may be decoded as one of the stream's.
fn check(header: &DecompressHeader, expected: (usize, usize)) -> Result<(), UnpackError> {
    let found = (header.width, header.height);
    if found != expected {
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

/// Stray bytes before the end that are forgiven; what is left over of a picture that lost its way is more.
const MOST_STRAY: u32 = 16;

/// Whether the picture's last bytes are its end marker, but for the zeros that cameras fill their buffers up with.
fn has_end(bytes: &[u8]) -> bool {
    let last = bytes.iter().rposition(|&byte| byte != 0).map_or(0, |at| at + 1);
    bytes[..last].ends_with(&[0xff, 0xd9])
}

/// Whether the decoder only complains of what many cameras do in every frame, the picture being whole: a few stray bytes before
/// the end marker (the samples before them were read without complaint, or that would be the message), or a scan header that
/// names no sequential scan (the decoder then ignores it; but as it tells only of its first complaint, smaller damage within such
/// a picture goes unnoticed; a missing end does not, see [`has_end`]).
fn is_harmless(error: &turbojpeg::Error) -> bool {
    let turbojpeg::Error::TurboJpegError(what) = error else { return false };
    if what.contains("Invalid SOS parameters for sequential JPEG") {
        return true;
    }
    let count =
        what.strip_prefix("Corrupt JPEG data: ").and_then(|rest| rest.strip_suffix(" extraneous bytes before marker 0xd9"));
    count.and_then(|count| count.parse().ok()).is_some_and(|count: u32| count <= MOST_STRAY)
}

fn damaged(error: turbojpeg::Error) -> UnpackError {
    let what = match error {
        turbojpeg::Error::TurboJpegError(what) => what,
        other => other.to_string(),
    };
    UnpackError::Damaged { what }
}
