//! y4m frames, one after the other.

use super::header;
use crate::device::{DeviceError, FrameSource, Input, Lent, RawFrame, StreamFormat};
use crate::frame::{FrameFlags, Stamp};
use std::path::Path;

/// No header line is longer than this; what ffmpeg writes has some 70 bytes.
const LONGEST_LINE: usize = 2048;

/// What each frame begins with.
const FRAME: &[u8] = b"FRAME";

/// A y4m stream from a file or standard input. Holds one frame in memory, however long the stream.
/// However large a header says frames are, memory grows only with the bytes that come.
///
/// Frame `n` is stamped `n` intervals after 0. A stream that ends within a frame gives all whole frames first, then a
/// [`DeviceError::Format`] that says where, then the end.
#[derive(Debug)]
pub struct Y4mSource {
    input: Input,
    format: StreamFormat,
    frames: Option<u64>,
    frame_bytes: usize,
    bytes: Vec<u8>,
    line: Vec<u8>,
    next: u64,
    ended: bool,
}

impl Y4mSource {
    /// Opens a file, or standard input for `-`.
    ///
    /// # Errors
    /// [`DeviceError::Io`], and [`DeviceError::Format`] where the header is not one that gimbald reads.
    pub fn open(path: &Path) -> Result<Self, DeviceError> {
        Self::new(Input::open(path)?)
    }

    /// Reads the header of `input`.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn new(mut input: Input) -> Result<Self, DeviceError> {
        let mut line = Vec::with_capacity(LONGEST_LINE);
        input.read_line(LONGEST_LINE, &mut line)?;
        let format = match line.split_last() {
            Some((b'\n', words)) => header::parse(words),
            _ if line.len() == LONGEST_LINE => Err(format!("its header line is longer than {LONGEST_LINE} bytes")),
            _ => Err("it ends within its header line".into()),
        };
        let format = format.map_err(|what| input.format_error(format!("not a y4m stream that gimbald reads: {what}")))?;
        let too_large = || input.format_error("a frame is larger than this machine's memory can be");
        let frame_bytes = format.frame_bytes().ok_or_else(too_large)?;
        let per_frame = frame_bytes as u64 + FRAME.len() as u64 + 1;
        let frames = input.len().map(|len| len.saturating_sub(input.position()) / per_frame);
        Ok(Self { input, format, frames, frame_bytes, bytes: Vec::new(), line, next: 0, ended: false })
    }

    /// Reads the next frame into `self.bytes`; `false` at the end.
    fn read_frame(&mut self) -> Result<bool, DeviceError> {
        let start = self.input.position();
        self.input.read_line(LONGEST_LINE, &mut self.line)?;
        if self.line.is_empty() {
            return Ok(false);
        }
        let n = self.next;
        let whole = self.line.last() == Some(&b'\n');
        let begins = self.line.strip_prefix(FRAME).and_then(|rest| rest.first());
        if !matches!((whole, begins), (true, Some(b'\n' | b' ' | b'\r' | b'\t'))) {
            let cut = !whole && (self.line.starts_with(FRAME) || FRAME.starts_with(&self.line));
            let what =
                if cut { "the stream ends within a frame's header" } else { "expected the word FRAME, found other bytes" };
            return Err(self.input.format_error(format!("damaged at byte {start}, before frame {n}: {what}")));
        }
        let found = self.input.read_into(self.frame_bytes, &mut self.bytes)?;
        if found < self.frame_bytes {
            return Err(self.input.format_error(format!(
                "truncated: ends at byte {} within frame {n}, which begins at byte {start} and has {found} of {} bytes; \
                 the {n} frames before it are whole",
                self.input.position(),
                self.frame_bytes,
            )));
        }
        Ok(true)
    }
}

impl FrameSource for Y4mSource {
    fn format(&self) -> StreamFormat {
        self.format
    }

    /// From the file's length, unless it is a pipe; too many by a few where frames have parameters.
    fn frames(&self) -> Option<u64> {
        self.frames
    }

    fn lend(&mut self) -> Result<Lent<'_>, DeviceError> {
        if self.ended {
            return Ok(Lent::End);
        }
        let read = self.read_frame();
        if !matches!(read, Ok(true)) {
            self.ended = true;
            return read.map(|_| Lent::End);
        }
        let stamp =
            Stamp { time_ns: self.format.nominal_time_ns(self.next), sequence: self.next, flags: FrameFlags::default() };
        self.next += 1;
        Ok(Lent::Frame(RawFrame { format: self.format, bytes: &self.bytes[..self.frame_bytes], stamp }))
    }
}
