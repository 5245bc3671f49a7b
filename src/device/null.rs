//! A sink that only counts frames.

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

/// A sink with a picture of its own, which counts how often it was to show it.
#[cfg(test)]
pub(crate) struct WithPlaceholder {
    pub inner: NullSink,
    pub placeholders: u64,
}

#[cfg(test)]
impl WithPlaceholder {
    pub fn new(format: &StreamFormat) -> Self {
        Self { inner: NullSink::new(format), placeholders: 0 }
    }
}

#[cfg(test)]
impl FrameSink for WithPlaceholder {
    fn format(&self) -> StreamFormat {
        self.inner.format()
    }

    fn canvas(&mut self) -> Result<PictureMut<'_>, DeviceError> {
        self.inner.canvas()
    }

    fn submit(&mut self, stamp: &Stamp) -> Result<(), DeviceError> {
        self.inner.submit(stamp)
    }

    fn submit_placeholder(&mut self, _: &Stamp) -> Result<bool, DeviceError> {
        self.placeholders += 1;
        Ok(true)
    }
}
