//! Pictures as y4m frames.

use super::header;
use crate::device::{DeviceError, FrameSink, Output, StreamFormat};
use crate::frame::Stamp;
use crate::image::{Picture, PictureMut};
use std::path::Path;

/// Writes a y4m stream. y4m has no timestamps: frames stand at the nominal rate.
#[derive(Debug)]
pub struct Y4mSink {
    output: Output,
    format: StreamFormat,
    canvas: Picture,
}

impl Y4mSink {
    /// Makes a file (or takes standard output for `-`) for pictures of frames of `format`, in its planar form, and writes
    /// the header.
    ///
    /// # Errors
    /// [`DeviceError::Io`].
    pub fn create(path: &Path, format: &StreamFormat) -> Result<Self, DeviceError> {
        Self::new(Output::create(path)?, format)
    }

    /// As [`Self::create`], into `output`.
    ///
    /// # Errors
    /// [`DeviceError::Io`].
    pub fn new(mut output: Output, format: &StreamFormat) -> Result<Self, DeviceError> {
        let format = format.planar();
        output.write(header::line(&format).as_bytes())?;
        Ok(Self { output, format, canvas: format.picture() })
    }
}

impl FrameSink for Y4mSink {
    fn format(&self) -> StreamFormat {
        self.format
    }

    fn canvas(&mut self) -> Result<PictureMut<'_>, DeviceError> {
        Ok(self.canvas.as_mut())
    }

    fn submit(&mut self, _: &Stamp) -> Result<(), DeviceError> {
        self.output.write(b"FRAME\n")?;
        for plane in self.canvas.as_ref().planes {
            for row in 0..plane.height() {
                self.output.write(plane.row(row))?;
            }
        }
        Ok(())
    }

    fn finish(&mut self) -> Result<(), DeviceError> {
        self.output.flush()
    }
}
