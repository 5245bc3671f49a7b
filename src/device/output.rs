//! Bytes to a file or standard output.

use super::input::STANDARD_STREAM;
use super::{DeviceError, private};
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::os::fd::AsFd;
use std::path::{Path, PathBuf};

const BUFFER: usize = 1 << 16;

/// A file or standard output being written. What is still buffered is written when it is dropped; [`Output::flush`] says
/// whether that worked.
pub struct Output {
    path: PathBuf,
    writer: BufWriter<Box<dyn Write + Send>>,
}

impl std::fmt::Debug for Output {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Output").field("path", &self.path).finish_non_exhaustive()
    }
}

impl Output {
    /// Makes a file as [`private::create`] does, or takes standard output for `-`.
    ///
    /// # Errors
    /// [`DeviceError::Io`] where the system refuses.
    pub fn create(path: &Path) -> Result<Self, DeviceError> {
        let (path, file) = if path.as_os_str() == STANDARD_STREAM {
            (PathBuf::from("standard output"), io::stdout().as_fd().try_clone_to_owned().map(File::from))
        } else {
            (path.into(), private::create(path))
        };
        match file {
            Ok(file) => Ok(Self::from_writer(path, Box::new(file))),
            Err(error) => Err(DeviceError::io(path, "create", error)),
        }
    }

    /// Wraps any writer, known under `path`.
    pub fn from_writer(path: PathBuf, writer: Box<dyn Write + Send>) -> Self {
        Self { path, writer: BufWriter::with_capacity(BUFFER, writer) }
    }

    /// Writes `bytes`, buffered.
    ///
    /// # Errors
    /// [`DeviceError::Io`], as where the disk is full.
    pub fn write(&mut self, bytes: &[u8]) -> Result<(), DeviceError> {
        self.writer.write_all(bytes).map_err(|error| DeviceError::io(&self.path, "write", error))
    }

    /// Hands what is buffered to the system.
    ///
    /// # Errors
    /// As [`Self::write`].
    pub fn flush(&mut self) -> Result<(), DeviceError> {
        self.writer.flush().map_err(|error| DeviceError::io(&self.path, "write", error))
    }

    /// A [`DeviceError::Format`] about this output.
    pub(super) fn format_error(&self, what: impl Into<String>) -> DeviceError {
        DeviceError::format(&self.path, what)
    }
}
