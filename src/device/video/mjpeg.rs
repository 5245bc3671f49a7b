//! A sink that writes MJPEG in AVI, without ffmpeg.

use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use super::Jpeg;
use super::avi::Avi;
use crate::device::{DeviceError, FrameSink, StreamFormat, private};
use crate::frame::Stamp;
use crate::image::{Picture, PictureMut, PixelFormat};

/// Of JPEG, 1 to 100: nothing is seen of the compression.
const QUALITY: i32 = 92;

/// Writes an AVI file of MJPEG. It has a fixed rate: before a frame that is late, the one before is shown for as long.
#[derive(Debug)]
pub struct MjpegSink {
    path: PathBuf,
    format: StreamFormat,
    canvas: Picture,
    jpeg: Jpeg,
    avi: Avi<BufWriter<File>>,
    first_ns: Option<i64>,
}

impl MjpegSink {
    /// Makes a file for pictures of frames of `format`.
    ///
    /// # Errors
    /// [`DeviceError::Io`], as where it cannot be created.
    pub fn create(path: &Path, format: &StreamFormat) -> Result<Self, DeviceError> {
        let file = private::create(path).map_err(|error| DeviceError::io(path, "create", error))?;
        let given = format.planar();
        let written = StreamFormat { pixel: PixelFormat::Mjpeg, ..given };
        let avi = Avi::new(BufWriter::new(file), &written).map_err(|error| DeviceError::io(path, "write", error))?;
        let jpeg = Jpeg::new(QUALITY).map_err(|error| DeviceError::format(path, format!("cannot write JPEG: {error}")))?;
        Ok(Self { path: path.into(), format: given, canvas: given.picture(), jpeg, avi, first_ns: None })
    }
}

impl FrameSink for MjpegSink {
    fn format(&self) -> StreamFormat {
        self.format
    }

    fn canvas(&mut self) -> Result<PictureMut<'_>, DeviceError> {
        Ok(self.canvas.as_mut())
    }

    fn submit(&mut self, stamp: &Stamp) -> Result<(), DeviceError> {
        let time_ns = stamp.time_ns.saturating_sub(*self.first_ns.get_or_insert(stamp.time_ns));
        let jpeg = self.jpeg.encode(self.canvas.as_ref());
        let jpeg = jpeg.map_err(|error| DeviceError::format(&self.path, format!("cannot write JPEG: {error}")))?;
        self.avi.add(jpeg, time_ns).map_err(|error| DeviceError::io(&self.path, "write", error))
    }

    fn finish(&mut self) -> Result<(), DeviceError> {
        self.avi.finish().map_err(|error| DeviceError::io(&self.path, "write", error))
    }
}
