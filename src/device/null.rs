//! A sink that counts.

use super::{DeviceError, FrameSink, StreamFormat};
use crate::frame::Stamp;
use crate::image::{Picture, PictureMut};

/// Takes pictures and keeps none.
#[derive(Debug)]
pub struct NullSink {
    format: StreamFormat,
    canvas: Picture,
    submitted: u64,
}

impl NullSink {
    /// For pictures of frames of `format`.
    pub fn new(format: &StreamFormat) -> Self {
        Self { format: format.planar(), canvas: format.picture(), submitted: 0 }
    }

    /// Pictures taken so far.
    pub fn submitted(&self) -> u64 {
        self.submitted
    }
}

impl FrameSink for NullSink {
    fn format(&self) -> StreamFormat {
        self.format
    }

    fn canvas(&mut self) -> Result<PictureMut<'_>, DeviceError> {
        Ok(self.canvas.as_mut())
    }

    fn submit(&mut self, _: &Stamp) -> Result<(), DeviceError> {
        self.submitted += 1;
        Ok(())
    }
}
