//! y4m frames, one after the other.

use super::header::{self, Header};
use crate::device::{DeviceError, FrameSource, Input, Lent, RawFrame, StreamFormat};
use crate::frame::{FrameFlags, Stamp};
use crate::image::{PlaneMut, PlaneRef};
use crate::kernel::convert;
use std::path::Path;

/// No header line is longer than this; what ffmpeg writes has some 70 bytes.
const LONGEST_LINE: usize = 2048;

/// What each frame begins with.
const FRAME: &[u8] = b"FRAME";

/// A y4m stream from a file or standard input. Holds one frame in memory, however long the stream (4:1:1: two).
/// However large a header says frames are, memory grows only with the bytes that come.
///
/// Frame `n` is stamped `n` intervals after 0. A stream that ends within a frame gives all whole frames first, then a
/// [`DeviceError::Format`] that says where, then the end.
#[derive(Debug)]
pub struct Y4mSource {
    input: Input,
    header: Header,
    frames: Option<u64>,
    /// Bytes of a frame in the stream, and those of the one read last.
    frame_bytes: usize,
    bytes: Vec<u8>,
    /// A frame of 4:1:1 as 4:2:2.
    widened: Vec<u8>,
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
        let header = match line.split_last() {
            Some((b'\n', words)) => header::parse(words),
            _ if line.len() == LONGEST_LINE => Err(format!("its header line is longer than {LONGEST_LINE} bytes")),
            _ => Err("it ends within its header line".into()),
        };
        let header = header.map_err(|what| input.format_error(format!("not a y4m stream that gimbald reads: {what}")))?;
        let too_large = || input.format_error("a frame is larger than this machine's memory can be");
        let frame_bytes = match header.is_411 {
            true => Some(layout_411(&header.format)[3]),
            false => header.format.frame_bytes(),
        };
        let frame_bytes = frame_bytes.ok_or_else(too_large)?;
        let per_frame = frame_bytes as u64 + FRAME.len() as u64 + 1;
        let frames = input.len().map(|len| len.saturating_sub(input.position()) / per_frame);
        let (bytes, widened) = (Vec::new(), Vec::new());
        Ok(Self { input, header, frames, frame_bytes, bytes, widened, line, next: 0, ended: false })
    }

    /// Reads the next frame, whose bytes [`Self::bytes`] then has; `false` at the end.
    ///
    /// # Errors
    /// As [`FrameSource::lend`].
    pub(in crate::device) fn read_frame(&mut self) -> Result<bool, DeviceError> {
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
            let what = match () {
                () if cut => "the stream ends within a frame's header",
                () if n > 0 && !self.header.names_chroma => {
                    "expected the word FRAME, found other bytes; the header has no chroma format (C), so 4:2:0 was assumed"
                }
                () => "expected the word FRAME, found other bytes",
            };
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
        if self.header.is_411 {
            self.widen();
        }
        Ok(true)
    }

    /// The bytes of the frame that was read last.
    pub(in crate::device) fn bytes(&self) -> &[u8] {
        if self.header.is_411 { &self.widened } else { &self.bytes[..self.frame_bytes] }
    }

    /// Makes 4:2:2 of the 4:1:1 frame that was read.
    fn widen(&mut self) {
        let format = &self.header.format;
        let [luma, width, chroma, _] = layout_411(format);
        let (height, half) = (format.height as usize, (format.width as usize).div_ceil(2));
        self.widened.resize(luma + 2 * half * height, 0);
        self.widened[..luma].copy_from_slice(&self.bytes[..luma]);
        let from = self.bytes[luma..self.frame_bytes].chunks_exact(chroma);
        for (from, into) in from.zip(self.widened[luma..].chunks_exact_mut(half * height)) {
            let from = PlaneRef::new(from, width, height, width);
            let into = PlaneMut::new(into, half, height, half);
            if let (Some(from), Some(into)) = (from, into) {
                convert::widen(from, into);
            }
        }
    }
}

/// Of a 4:1:1 frame that becomes one of `format`: bytes of luma, of a row of chroma, of a plane of it, and of the whole frame.
fn layout_411(format: &StreamFormat) -> [usize; 4] {
    let (width, height) = (format.width as usize, format.height as usize);
    let (luma, row) = (width * height, width.div_ceil(4));
    [luma, row, row * height, luma + 2 * row * height]
}

impl FrameSource for Y4mSource {
    fn format(&self) -> StreamFormat {
        self.header.format
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
        let format = self.header.format;
        let stamp = Stamp { time_ns: format.nominal_time_ns(self.next), sequence: self.next, flags: FrameFlags::default() };
        self.next += 1;
        Ok(Lent::Frame(RawFrame { format, bytes: self.bytes(), stamp }))
    }
}
