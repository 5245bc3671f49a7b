//! Writes frames to a recording.

use super::record::{self, Header};
use crate::device::{DeviceError, FrameSink, Output, RawFrame, StreamFormat};
use crate::frame::Stamp;
use crate::image::{Picture, PictureMut};
use crate::kernel::{Level, convert};
use std::path::Path;

/// Writes raw frames exactly as they come. Each is handed to the system before the next is taken, so a recorder that is killed
/// leaves a file that is whole up to its last frame.
#[derive(Debug)]
pub struct RecordingWriter {
    output: Output,
    format: StreamFormat,
    device: String,
    longest: usize,
    written: u64,
}

impl RecordingWriter {
    /// Makes a file (or takes standard output for `-`) for frames of `format` from the device called `device`.
    ///
    /// # Errors
    /// [`DeviceError::Io`], and [`DeviceError::Format`] where the format makes no sense.
    pub fn create(path: &Path, format: &StreamFormat, device: &str) -> Result<Self, DeviceError> {
        Self::new(Output::create(path)?, format, device)
    }

    /// As [`Self::create`], into `output`.
    ///
    /// # Errors
    /// As [`Self::create`].
    pub fn new(mut output: Output, format: &StreamFormat, device: &str) -> Result<Self, DeviceError> {
        output.write(&record::head())?;
        let mut writer = Self { output, format: *format, device: device.into(), longest: 0, written: 0 };
        writer.write_format(format)?;
        writer.output.flush()?;
        Ok(writer)
    }

    /// Frames written so far.
    pub fn written(&self) -> u64 {
        self.written
    }

    /// Writes a frame; before it its format, where that is not the one before.
    ///
    /// # Errors
    /// [`DeviceError::Io`], as where the disk is full; [`DeviceError::Format`] where the frame has more bytes than its format
    /// can need (nothing is then written).
    pub fn write_raw(&mut self, frame: &RawFrame<'_>) -> Result<(), DeviceError> {
        if frame.format != self.format {
            self.write_format(&frame.format)?;
        }
        let fits = frame.bytes.len() <= self.longest;
        let Some(header) = Header::of_frame(frame.stamp, frame.bytes).filter(|_| fits) else {
            let (len, longest) = (frame.bytes.len(), self.longest);
            return Err(self
                .output
                .format_error(format!("cannot record a frame of {len} bytes, {longest} were expected at most")));
        };
        self.output.write(&header.to_bytes())?;
        self.output.write(frame.bytes)?;
        self.written += 1;
        self.output.flush()
    }

    /// Hands what is buffered to the system.
    ///
    /// # Errors
    /// [`DeviceError::Io`].
    pub fn finish(&mut self) -> Result<(), DeviceError> {
        self.output.flush()
    }

    fn write_format(&mut self, format: &StreamFormat) -> Result<(), DeviceError> {
        let refuse = |what: String| self.output.format_error(format!("cannot record this stream: {what}"));
        let longest = record::longest_frame(format).map_err(refuse)?;
        let payload = record::format_payload(format, &self.device);
        // A format has some 300 bytes at most.
        if let Some(header) = Header::of_format(&payload) {
            self.output.write(&header.to_bytes())?;
            self.output.write(&payload)?;
        }
        (self.format, self.longest) = (*format, longest);
        Ok(())
    }
}

/// Records pictures in their planar format, with their times.
#[derive(Debug)]
pub struct RecordingSink {
    writer: RecordingWriter,
    canvas: Picture,
    bytes: Vec<u8>,
    level: Level,
}

impl RecordingSink {
    /// Makes a file (or takes standard output for `-`) for pictures of frames of `format`.
    ///
    /// # Errors
    /// As [`RecordingWriter::create`].
    pub fn create(path: &Path, format: &StreamFormat) -> Result<Self, DeviceError> {
        Self::new(Output::create(path)?, format)
    }

    /// As [`Self::create`], into `output`.
    ///
    /// # Errors
    /// As [`RecordingWriter::create`].
    pub fn new(output: Output, format: &StreamFormat) -> Result<Self, DeviceError> {
        let planar = format.planar();
        let writer = RecordingWriter::new(output, &planar, "gimbald")?;
        let bytes = vec![0; planar.frame_bytes().unwrap_or(0)];
        Ok(Self { writer, canvas: format.picture(), bytes, level: Level::detected() })
    }
}

impl FrameSink for RecordingSink {
    fn format(&self) -> StreamFormat {
        self.writer.format
    }

    fn canvas(&mut self) -> Result<PictureMut<'_>, DeviceError> {
        Ok(self.canvas.as_mut())
    }

    fn submit(&mut self, stamp: &Stamp) -> Result<(), DeviceError> {
        let format = self.writer.format;
        convert::pack(self.level, self.canvas.as_ref(), format.pixel, format.stride, &mut self.bytes)
            .map_err(|error| self.writer.output.format_error(error.to_string()))?;
        self.writer.write_raw(&RawFrame { format, bytes: &self.bytes, stamp: *stamp })
    }

    fn finish(&mut self) -> Result<(), DeviceError> {
        self.writer.finish()
    }
}
