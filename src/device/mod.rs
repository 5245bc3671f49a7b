//! Where frames come from and where they go. Real cameras and synthetic ones implement the same two traits.
//!
//! A source *lends* frames: the bytes belong to the driver's buffer or the file's page and are returned when the borrow ends, so
//! memory that is being written again cannot be read. A sink lends its canvas, so the warp can write straight into it.

pub mod digest;
mod error;
mod input;
pub mod null;
mod output;
pub(crate) mod placeholder;
pub(crate) mod private;
pub mod recording;
pub mod rehearsal;
pub mod replay;
pub mod synthetic;
mod version;
pub(crate) mod video;
pub mod y4m;

pub mod v4l2;

pub use error::DeviceError;
pub use input::Input;
pub use output::Output;

use crate::frame::Stamp;
use crate::image::{Colour, Picture, PictureMut, PixelFormat, Sampling};

/// What a stream consists of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StreamFormat {
    /// Luma samples in a row.
    pub width: u32,
    /// Luma rows.
    pub height: u32,
    /// Layout of a frame's bytes.
    pub pixel: PixelFormat,
    /// Bytes from one row of the first plane to the next; 0 for compressed formats.
    pub stride: usize,
    /// Nominal time between frames, seconds, as a fraction (numerator, denominator).
    pub interval: (u32, u32),
    /// Shape of a sample (width, height); (1, 1) is square, (0, 0) unknown.
    pub aspect: (u32, u32),
    /// Meaning of the samples.
    pub colour: Colour,
}

impl StreamFormat {
    /// A format with rows that have no padding, square samples and nothing said of colour.
    pub fn tight(width: u32, height: u32, pixel: PixelFormat, interval: (u32, u32)) -> Self {
        Self { width, height, pixel, stride: pixel.tight_stride(width), interval, aspect: (1, 1), colour: Colour::default() }
    }

    /// Bytes of a frame; `None` for compressed formats.
    pub fn frame_bytes(&self) -> Option<usize> {
        self.pixel.frame_bytes(self.height, self.stride)
    }

    /// The form of picture in which frames of this format travel through the pipeline.
    ///
    /// Planar formats keep their chroma. What cameras send (packed 4:2:2, MJPEG, RGB) travels as 4:2:0, which is what every
    /// call app encodes in the end.
    pub fn sampling(&self) -> Sampling {
        match self.pixel {
            PixelFormat::Grey => Sampling::Mono,
            PixelFormat::I422 => Sampling::S422,
            PixelFormat::I444 => Sampling::S444,
            _ => Sampling::S420,
        }
    }

    /// The planar format of the pictures that frames of this format become (see [`Self::sampling`] and [`Colour::inside`]), rows without
    /// padding.
    pub fn planar(&self) -> Self {
        let pixel = match self.sampling() {
            Sampling::Mono => PixelFormat::Grey,
            Sampling::S420 => PixelFormat::I420,
            Sampling::S422 => PixelFormat::I422,
            Sampling::S444 => PixelFormat::I444,
        };
        let colour = self.colour.inside(self.pixel);
        Self { pixel, stride: pixel.tight_stride(self.width), colour, ..*self }
    }

    /// An empty picture of this format's size and [`Self::sampling`].
    pub fn picture(&self) -> Picture {
        Picture::new(self.sampling(), self.width as usize, self.height as usize)
    }

    /// Time of frame `n`, nanoseconds after frame 0, frames coming at the nominal interval.
    pub fn nominal_time_ns(&self, n: u64) -> i64 {
        let (numerator, denominator) = (i128::from(self.interval.0), i128::from(self.interval.1.max(1)));
        i64::try_from(i128::from(n) * 1_000_000_000 * numerator / denominator).unwrap_or(i64::MAX)
    }

    /// Frames a second; 0 where the interval is not known.
    pub fn rate(&self) -> f64 {
        if self.interval.0 == 0 { 0.0 } else { f64::from(self.interval.1) / f64::from(self.interval.0) }
    }
}

/// A frame as its source gave it, lent until the source is asked for the next.
#[derive(Clone, Copy, Debug)]
pub struct RawFrame<'a> {
    /// Its format; may differ from the frame before (a camera that was restarted in another mode).
    pub format: StreamFormat,
    /// Its bytes, cut to what the source says it filled.
    pub bytes: &'a [u8],
    /// When it was taken.
    pub stamp: Stamp,
}

/// What a source answers when asked for a frame.
#[derive(Debug)]
pub enum Lent<'a> {
    /// A frame.
    Frame(RawFrame<'a>),
    /// None came within the source's time limit, or a notification came: check for changes and ask again.
    Idle,
    /// There will be no more.
    End,
}

/// Gives frames.
pub trait FrameSource: Send {
    /// The format of the frames to come.
    fn format(&self) -> StreamFormat;

    /// How many frames there will be, where that is known.
    fn frames(&self) -> Option<u64> {
        None
    }

    /// Lends the next frame. The frame lent before goes home with this call.
    ///
    /// # Errors
    /// [`DeviceError`] where the device is gone or the file damaged beyond this point; a single damaged frame is no error but a
    /// frame with [`crate::frame::FrameFlags::ERROR`].
    fn lend(&mut self) -> Result<Lent<'_>, DeviceError>;

    /// Once the stream has ended: what was damaged in it and could be read all the same, for people; `None` where nothing was.
    fn complaint(&self) -> Option<&str> {
        None
    }
}

/// Takes pictures.
pub trait FrameSink: Send {
    /// The format in which frames leave.
    fn format(&self) -> StreamFormat;

    /// Lends a picture of [`FrameSink::format`]'s size to draw the next frame into. Its old content is unspecified.
    ///
    /// # Errors
    /// [`DeviceError`] where the device is gone.
    fn canvas(&mut self) -> Result<PictureMut<'_>, DeviceError>;

    /// Sends what was drawn into the canvas, taken at `stamp`.
    ///
    /// # Errors
    /// [`DeviceError`] where the device is gone or the disk full.
    fn submit(&mut self, stamp: &Stamp) -> Result<(), DeviceError>;

    /// Sends a picture of the sink's own, as of `stamp`, where there is none of the source's that could be shown: a stream that has
    /// given no usable frame, or none for a while. `false`, without having sent anything, where the sink has none; the caller then
    /// draws.
    ///
    /// # Errors
    /// As [`FrameSink::submit`].
    fn submit_placeholder(&mut self, stamp: &Stamp) -> Result<bool, DeviceError> {
        let _ = stamp;
        Ok(false)
    }

    /// Called from time to time while there is nothing to send: for sinks whose readers give up on a picture that does not change.
    ///
    /// # Errors
    /// As [`FrameSink::submit`].
    fn idle(&mut self) -> Result<(), DeviceError> {
        Ok(())
    }

    /// Sends what is still held back. Called once, at the end.
    ///
    /// # Errors
    /// As [`FrameSink::submit`].
    fn finish(&mut self) -> Result<(), DeviceError> {
        Ok(())
    }
}
