//! Sequential bytes from a file or standard input, with the position for error messages.

use super::DeviceError;
use std::fs::File;
use std::io::{self, BufRead, BufReader, ErrorKind, Read};
use std::os::fd::AsFd;
use std::path::{Path, PathBuf};

/// The path that means standard input or output.
pub const STANDARD_STREAM: &str = "-";

const BUFFER: usize = 1 << 16;

/// Step by which memory for long pieces grows.
const GROWTH: usize = 1 << 20;

/// A file or standard input being read.
pub struct Input {
    path: PathBuf,
    reader: BufReader<Box<dyn Read + Send>>,
    position: u64,
    len: Option<u64>,
}

impl std::fmt::Debug for Input {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Input").field("path", &self.path).field("position", &self.position).finish_non_exhaustive()
    }
}

impl Input {
    /// Opens a file, or standard input for `-`.
    ///
    /// # Errors
    /// [`DeviceError::Io`] where the system refuses.
    pub fn open(path: &Path) -> Result<Self, DeviceError> {
        if path.as_os_str() == STANDARD_STREAM {
            let path = PathBuf::from("standard input");
            let own = io::stdin().as_fd().try_clone_to_owned().map_err(|error| DeviceError::io(&path, "open", error))?;
            return Ok(Self::from_reader(path, Box::new(File::from(own)), None));
        }
        let file = File::open(path).map_err(|error| DeviceError::io(path, "open", error))?;
        let about = file.metadata().map_err(|error| DeviceError::io(path, "ask about", error))?;
        if about.is_dir() {
            return Err(DeviceError::io(path, "read", ErrorKind::IsADirectory.into()));
        }
        Ok(Self::from_reader(path.into(), Box::new(file), about.is_file().then_some(about.len())))
    }

    /// Wraps any reader, known under `path` and `len` bytes long where that is known.
    pub fn from_reader(path: PathBuf, reader: Box<dyn Read + Send>, len: Option<u64>) -> Self {
        Self { path, reader: BufReader::with_capacity(BUFFER, reader), position: 0, len }
    }

    /// The name for error messages.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Bytes read so far.
    pub fn position(&self) -> u64 {
        self.position
    }

    /// Bytes in all, where known.
    pub fn len(&self) -> Option<u64> {
        self.len
    }

    /// Whether there is nothing to read at all, where known.
    pub fn is_empty(&self) -> Option<bool> {
        self.len.map(|len| len == 0)
    }

    /// Some of the bytes to come, without taking them: at least one unless the end is reached.
    ///
    /// # Errors
    /// [`DeviceError::Io`].
    pub fn peek(&mut self) -> Result<&[u8], DeviceError> {
        loop {
            match self.reader.fill_buf() {
                Ok(_) => break,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return Err(DeviceError::io(&self.path, "read", error)),
            }
        }
        Ok(self.reader.buffer())
    }

    /// Fills `into` as far as there are bytes; says how many.
    ///
    /// # Errors
    /// [`DeviceError::Io`].
    pub fn read(&mut self, into: &mut [u8]) -> Result<usize, DeviceError> {
        let mut filled = 0;
        while filled < into.len() {
            match self.reader.read(&mut into[filled..]) {
                Ok(0) => break,
                Ok(more) => filled += more,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return Err(DeviceError::io(&self.path, "read", error)),
            }
        }
        self.position += filled as u64;
        Ok(filled)
    }

    /// Reads `len` bytes into the front of `buffer`, which grows with what is there to read, not with what is asked for; says how
    /// many there were. A buffer that was large enough before is not touched beyond them.
    ///
    /// # Errors
    /// [`DeviceError::Io`].
    pub fn read_into(&mut self, len: usize, buffer: &mut Vec<u8>) -> Result<usize, DeviceError> {
        let mut filled = 0;
        while filled < len {
            let end = len.min(buffer.len().max(filled + GROWTH));
            if buffer.len() < end {
                buffer.resize(end, 0);
            }
            let found = self.read(&mut buffer[filled..end])?;
            filled += found;
            if filled < end {
                break;
            }
        }
        Ok(filled)
    }

    /// Reads up to and with the next newline, at most `limit` bytes, into `line` (cleared first). The line has no newline at its
    /// end where the bytes or the limit ended first.
    ///
    /// # Errors
    /// [`DeviceError::Io`].
    pub fn read_line(&mut self, limit: usize, line: &mut Vec<u8>) -> Result<(), DeviceError> {
        line.clear();
        loop {
            let wanted = limit - line.len();
            let bytes = self.peek()?;
            let bytes = &bytes[..bytes.len().min(wanted)];
            let (taken, done) = match bytes.iter().position(|&b| b == b'\n') {
                Some(end) => (end + 1, true),
                None => (bytes.len(), bytes.is_empty()),
            };
            line.extend_from_slice(&bytes[..taken]);
            self.reader.consume(taken);
            self.position += taken as u64;
            if done || line.len() == limit {
                return Ok(());
            }
        }
    }

    /// A [`DeviceError::Format`] about this input.
    pub(super) fn format_error(&self, what: impl Into<String>) -> DeviceError {
        DeviceError::format(&self.path, what)
    }
}
