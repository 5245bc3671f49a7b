//! Raw bytes to a planar picture: unpacking, and decoding of MJPEG.

mod mjpeg;

use std::borrow::Cow;

use crate::image::{FromRgb, MAX_SIDE, Picture, PixelFormat, PlaneRef, Range, RawLayout, Sampling, ToLimited};
use crate::kernel::Level;
use crate::kernel::convert::{self, LumaFirst, NEUTRAL, RgbOrder};
use mjpeg::Mjpeg;

/// Why a frame could not be unpacked. The picture's samples are then unspecified.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum UnpackError {
    /// Fewer bytes than the format says.
    #[error("the {format} frame has {found} bytes, {needed} were expected")]
    Truncated {
        /// The format.
        format: PixelFormat,
        /// Bytes there are.
        found: usize,
        /// Bytes there should be at least.
        needed: usize,
    },
    /// The stream's size or stride makes no sense.
    #[error(
        "a {format} frame of {width}x{height} with rows of {stride} bytes is not possible (at most {MAX_SIDE}x{MAX_SIDE}, compressed 7680x4320)"
    )]
    Impossible {
        /// The format.
        format: PixelFormat,
        /// Width.
        width: u32,
        /// Height.
        height: u32,
        /// Stride.
        stride: usize,
    },
    /// A compressed picture is much larger than the stream.
    #[error("the JPEG picture is {}x{}, the stream {}x{}; at most four times as many pixels are decoded", found.0, found.1, expected.0, expected.1)]
    SizeMismatch {
        /// The picture's own (width, height).
        found: (usize, usize),
        /// The stream's.
        expected: (usize, usize),
    },
    /// A compressed picture of a kind that no camera sends.
    #[error("the JPEG picture is {what}, which gimbald does not decode")]
    Unsupported {
        /// The kind.
        what: &'static str,
    },
    /// A compressed picture ends before its last row.
    #[error("the JPEG picture is cut off: {rows} of its {of} rows are there")]
    Cut {
        /// Rows that are there, from the top.
        rows: usize,
        /// Rows that it says it has.
        of: usize,
    },
    /// A compressed picture is damaged.
    #[error("the JPEG picture is damaged: {what}")]
    Damaged {
        /// What is wrong, or the decoder's own words.
        what: Cow<'static, str>,
    },
}

/// Turns raw frames into planar pictures. Its memory is made with the first frame and kept.
#[derive(Debug)]
pub struct Unpack {
    level: Level,
    mjpeg: Mjpeg,
}

impl Default for Unpack {
    fn default() -> Self {
        Self::new()
    }
}

impl Unpack {
    /// An unpacker at this processor's best level.
    pub fn new() -> Self {
        Self::with_level(Level::detected())
    }

    /// An unpacker at `level`.
    pub fn with_level(level: Level) -> Self {
        Self { level, mjpeg: Mjpeg::default() }
    }

    /// The form of picture that comes of `format`: planar formats keep their chroma, all others become 4:2:0.
    pub fn sampling(format: PixelFormat) -> Sampling {
        match format {
            PixelFormat::Grey => Sampling::Mono,
            PixelFormat::I422 => Sampling::S422,
            PixelFormat::I444 => Sampling::S444,
            _ => Sampling::S420,
        }
    }

    /// Unpacks `bytes`, a frame of `width` x `height` whose first plane has rows `stride` bytes apart (ignored for MJPEG), into
    /// `into`, which takes that size and the form of [`Self::sampling`]; a JPEG picture of another size keeps its own. Bytes beyond
    /// the frame's end are ignored. `range` is what was said of the samples' range; those of the picture have the meaning that
    /// [`Colour::inside`](crate::image::Colour::inside) says.
    ///
    /// # Errors
    /// [`UnpackError`]; nothing in `bytes` makes it panic or allocate more than a picture of the stream's size needs.
    pub fn unpack(
        &mut self,
        format: PixelFormat,
        range: Range,
        (width, height): (u32, u32),
        stride: usize,
        bytes: &[u8],
        into: &mut Picture,
    ) -> Result<(), UnpackError> {
        let impossible = UnpackError::Impossible { format, width, height, stride };
        if width == 0 || height == 0 || width > MAX_SIDE || height > MAX_SIDE || format.is_too_large(width, height) {
            return Err(impossible);
        }
        let size = (width as usize, height as usize);
        if format.is_compressed() {
            return self.mjpeg.decode(self.level, range.of(format), size, bytes, into);
        }
        let layout = RawLayout::new(format, width, height, stride).ok_or(impossible)?;
        let truncated = UnpackError::Truncated { format, found: bytes.len(), needed: layout.least_bytes() };
        let planes = layout.planes(bytes).ok_or(truncated)?;
        into.reshape(Self::sampling(format), size.0, size.1);
        self.convert(format, range.of(format), planes, into);
        Ok(())
    }

    /// Why the last picture is less than its frame should hold, though it is shown: the end of a JPEG was missing, in a stream where
    /// that is usual, and there is the picture before in its place.
    pub fn shortfall(&self) -> Option<&UnpackError> {
        self.mjpeg.cut()
    }

    fn convert(&self, format: PixelFormat, range: Range, [first, second, third]: [PlaneRef<'_>; 3], into: &mut Picture) {
        let mut picture = into.as_mut();
        let is_full = range == Range::Full && !format.is_rgb();
        match format {
            PixelFormat::Yuyv => convert::packed_422(self.level, LumaFirst::Yes, first, picture),
            PixelFormat::Uyvy => convert::packed_422(self.level, LumaFirst::No, first, picture),
            PixelFormat::Rgb24 => convert::rgb(self.level, RgbOrder::Rgb, FromRgb::new(range), first, picture),
            PixelFormat::Bgr24 => convert::rgb(self.level, RgbOrder::Bgr, FromRgb::new(range), first, picture),
            PixelFormat::Nv12 => {
                let [y, u, v] = &mut picture.planes;
                y.copy_from(first);
                convert::interleaved(self.level, second, u.reborrow(), v.reborrow());
            }
            PixelFormat::I420 | PixelFormat::I422 | PixelFormat::I444 | PixelFormat::Grey => {
                for (plane, from) in picture.planes.iter_mut().zip([first, second, third]) {
                    plane.copy_from(from);
                }
            }
            // Decoded elsewhere; a picture of grey rather than a panic should that ever change.
            PixelFormat::Mjpeg => picture.planes.iter_mut().for_each(|plane| plane.fill(NEUTRAL)),
        }
        if is_full {
            // Rare: cameras' planar and packed samples are nearly always of limited range.
            let maps = [ToLimited::LUMA, ToLimited::CHROMA, ToLimited::CHROMA];
            for (plane, map) in into.as_mut().planes.into_iter().zip(maps) {
                convert::to_limited_in_place(self.level, map, plane);
            }
        }
    }
}

#[cfg(test)]
mod tests;
