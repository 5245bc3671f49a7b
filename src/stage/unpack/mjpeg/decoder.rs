//! libjpeg-turbo, and the meaning of its warnings.

use std::borrow::Cow;

use super::super::UnpackError;
use super::canvas::{Canvas, Samples, Shape};
use super::markers::Header;
use super::scan::{self, Codes, Strays};
use super::shown_size;
use turbojpeg::{Colorspace, Decompressor, Image, PixelFormat, Subsamp, YuvImage};

/// Progressive pictures may not have more scans than this; each costs a pass over the picture, however few its bytes.
const MAX_SCANS: u32 = 64;

/// Pictures of another size than the stream's may have at most this many times its pixels.
const MAX_TIMES_LARGER: usize = 4;

/// Rows above the last one that is there which chroma of the missing ones may have reached, where the decoder spreads chroma itself.
const CHROMA_REACH: usize = 2;

/// How much of a picture was decoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Extent {
    Whole,
    /// So many rows from the top.
    Rows(usize),
}

/// The decoder, and what it is spared.
#[derive(Default)]
pub(super) struct Decoder {
    /// Made with the first picture; made again after a failure, which can leave it in the midst of a header.
    turbo: Option<Decompressor>,
    strays: Strays,
    /// The last picture had bytes without meaning in it. So will the next: they are removed before the decoder reports them, since
    /// a complaint costs a decoding and is a text in memory.
    expects_strays: bool,
}

impl Decoder {
    /// Decodes `jpeg`, which [`super::markers::extract`] wrote with `header`, into `canvas`; `stream` is the size that pictures are to
    /// have. May take bytes without meaning out of `jpeg`.
    pub(super) fn decode(
        &mut self,
        jpeg: &mut Vec<u8>,
        header: &Header,
        stream: (usize, usize),
        canvas: &mut Canvas,
    ) -> Result<Extent, UnpackError> {
        if self.expects_strays && header.sequential && scan::follow(jpeg, header.ended, &mut self.strays) == Codes::Whole {
            self.expects_strays = !self.strays.is_empty();
            scan::remove(jpeg, &self.strays);
        }
        let Err(mut complaint) = self.try_to_decode(jpeg, stream, canvas) else { return Ok(Extent::Whole) };
        if !header.sequential || !matches!(complaint, UnpackError::Damaged { .. }) {
            return Err(complaint);
        }
        match scan::follow(jpeg, header.ended, &mut self.strays) {
            Codes::Whole if !self.strays.is_empty() => {
                self.expects_strays = true;
                scan::remove(jpeg, &self.strays);
                self.try_to_decode(jpeg, stream, canvas).map(|()| Extent::Whole)
            }
            Codes::Cut { rows } => {
                if !self.strays.is_empty() {
                    scan::remove(jpeg, &self.strays);
                    complaint = self.try_to_decode(jpeg, stream, canvas).err().unwrap_or(complaint);
                }
                if !is_warning(&complaint) {
                    return Err(complaint);
                }
                let reach = if canvas.shape().is_some_and(|shape| shape.samples == Samples::Rgb) { CHROMA_REACH } else { 0 };
                Ok(Extent::Rows(rows.saturating_sub(reach)))
            }
            _ => Err(complaint),
        }
    }

    /// Decodes a picture that is to leave the decoder nothing to complain of.
    fn try_to_decode(&mut self, jpeg: &[u8], stream: (usize, usize), canvas: &mut Canvas) -> Result<(), UnpackError> {
        let turbo = match &mut self.turbo {
            Some(turbo) => turbo,
            none => {
                let mut turbo = Decompressor::new().map_err(damaged)?;
                turbo.set_scan_limit(MAX_SCANS).map_err(damaged)?;
                none.insert(turbo)
            }
        };
        let outcome = shape(turbo, jpeg, stream).and_then(|shape| decode_into(turbo, jpeg, shape, canvas));
        if outcome.is_err() {
            self.turbo = None;
        }
        outcome
    }
}

/// What a picture will be decoded as; an error where it is nothing for a stream of size `stream`.
fn shape(turbo: &mut Decompressor, jpeg: &[u8], stream: (usize, usize)) -> Result<Shape, UnpackError> {
    let header = turbo.read_header(jpeg).map_err(damaged)?;
    let size = (header.width, header.height);
    let shown = shown_size(size, stream);
    if shown.0 * shown.1 > MAX_TIMES_LARGER * stream.0 * stream.1 {
        return Err(UnpackError::SizeMismatch { found: size, expected: stream });
    }
    if header.is_lossless {
        return Err(UnpackError::Unsupported { what: "lossless" });
    }
    let samples = match header.colorspace {
        Colorspace::YCbCr | Colorspace::Gray if header.subsamp != Subsamp::Unknown => Samples::Planes(header.subsamp),
        Colorspace::YCbCr | Colorspace::Gray | Colorspace::RGB => Samples::Rgb,
        Colorspace::CMYK | Colorspace::YCCK => return Err(UnpackError::Unsupported { what: "stored as CMYK" }),
    };
    Ok(Shape { size, samples })
}

fn decode_into(turbo: &mut Decompressor, jpeg: &[u8], shape: Shape, canvas: &mut Canvas) -> Result<(), UnpackError> {
    let (width, height) = shape.size;
    let pixels = canvas.prepare(shape);
    match shape.samples {
        Samples::Planes(subsamp) => turbo.decompress_to_yuv(jpeg, YuvImage { pixels, width, align: 1, height, subsamp }),
        Samples::Rgb => turbo.decompress(jpeg, Image { pixels, width, pitch: 3 * width, height, format: PixelFormat::RGB }),
    }
    .map_err(damaged)
}

/// Whether the decoder went on after what it complains of, so that there are samples of all codes before it.
fn is_warning(complaint: &UnpackError) -> bool {
    let UnpackError::Damaged { what } = complaint else { return false };
    what.starts_with("Corrupt JPEG data") || what.starts_with("Premature end")
}

fn damaged(error: turbojpeg::Error) -> UnpackError {
    let what = match error {
        turbojpeg::Error::TurboJpegError(what) => what,
        other => other.to_string(),
    };
    UnpackError::Damaged { what: Cow::Owned(what) }
}
