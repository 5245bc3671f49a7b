//! Reads recorded frames in sequence.

use super::record::{self, HEAD, HEADER, Header, KIND_FORMAT, KIND_FRAME, LONGEST_UNKNOWN};
use crate::device::{DeviceError, FrameSource, Input, Lent, RawFrame, StreamFormat};
use crate::frame::{FrameFlags, Stamp};
use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::Path;

/// A recording, from a file or standard input. Holds one frame in memory, however long the recording; memory grows only with the
/// bytes that come, whatever a header says.
///
/// A damaged or truncated recording gives all frames before the damage first, then a [`DeviceError::Format`] that says where,
/// then the end.
#[derive(Debug)]
pub struct RecordingSource {
    input: Input,
    format: StreamFormat,
    device: String,
    longest: usize,
    frames: Option<u64>,
    bytes: Vec<u8>,
    given: u64,
    ended: bool,
}

/// What a record turned out to be.
enum Found {
    Format,
    Frame(Stamp, usize),
    Unknown,
    End,
}

impl RecordingSource {
    /// Opens a file, or standard input for `-`.
    ///
    /// # Errors
    /// [`DeviceError::Io`], and [`DeviceError::Format`] where it is no recording, one of another version, or its first format
    /// damaged.
    pub fn open(path: &Path) -> Result<Self, DeviceError> {
        let mut source = Self::new(Input::open(path)?)?;
        source.frames = source.input.len().and_then(|len| count_frames(path, len));
        Ok(source)
    }

    /// Reads the head and the first format of `input`.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn new(mut input: Input) -> Result<Self, DeviceError> {
        let mut head = [0; HEAD];
        let found = input.read(&mut head)?;
        let head = if found == HEAD { record::check_head(&head) } else { Err(format!("it ends at byte {found}")) };
        head.map_err(|what| input.format_error(format!("not a recording that gimbald reads: {what}")))?;
        let nothing = StreamFormat::tight(1, 1, crate::image::PixelFormat::Grey, (0, 1));
        let (device, bytes) = (String::new(), Vec::new());
        let mut source = Self { input, format: nothing, device, longest: 0, frames: None, bytes, given: 0, ended: false };
        loop {
            match source.read_record()? {
                Found::Format => return Ok(source),
                Found::Unknown => {}
                Found::Frame(..) | Found::End => {
                    return Err(source.input.format_error("a recording without a format: nothing in it can be read"));
                }
            }
        }
    }

    /// The name of the device that was recorded.
    pub fn device(&self) -> &str {
        &self.device
    }

    /// Bytes of memory that it holds for frames.
    #[cfg(test)]
    pub(super) fn bytes_held(&self) -> usize {
        self.bytes.capacity()
    }

    /// Reads one record; a frame's bytes are then the first of `self.bytes`.
    fn read_record(&mut self) -> Result<Found, DeviceError> {
        let start = self.input.position();
        let mut bytes = [0; HEADER];
        let found = self.input.read(&mut bytes)?;
        if found == 0 {
            return Ok(Found::End);
        }
        if found < HEADER {
            return Err(self.cut(start, "a record's header", found, HEADER));
        }
        let Some(Header { kind, len, stamp, payload_crc }) = Header::from_bytes(&bytes) else {
            return Err(self.damage(start, "a record's header fails its check"));
        };
        let len = len as usize;
        let longest = match kind {
            KIND_FRAME if self.longest > 0 => self.longest,
            KIND_FRAME => return Err(self.damage(start, "a frame comes before the first format")),
            _ => LONGEST_UNKNOWN,
        };
        if len > longest {
            return Err(self.damage(start, &format!("a record claims {len} bytes, its kind has at most {longest}")));
        }
        let found = self.input.read_into(len, &mut self.bytes)?;
        let what = if kind == KIND_FRAME { "the frame" } else { "the record" };
        if found < len {
            return Err(self.cut(start, what, HEADER + found, HEADER + len));
        }
        let intact = crc32fast::hash(&self.bytes[..len]) == payload_crc;
        match kind {
            KIND_FRAME => {
                let damage = if intact { FrameFlags::default() } else { FrameFlags::ERROR };
                Ok(Found::Frame(Stamp { flags: stamp.flags.with(damage), ..stamp }, len))
            }
            KIND_FORMAT => {
                let format =
                    if intact { record::parse_format(&self.bytes[..len]) } else { Err("its format fails its check".into()) };
                let (format, device) = format.map_err(|what| self.damage(start, &what))?;
                self.longest = record::longest_frame(&format).map_err(|what| self.damage(start, &what))?;
                self.format = format;
                self.device = device;
                Ok(Found::Format)
            }
            _ => Ok(Found::Unknown),
        }
    }

    fn damage(&self, byte: u64, what: &str) -> DeviceError {
        self.input.format_error(format!("damaged at byte {byte}, after {} whole frames: {what}", self.given))
    }

    fn cut(&self, start: u64, what: &str, found: usize, whole: usize) -> DeviceError {
        self.input.format_error(format!(
            "truncated: ends at byte {}, within {what} that begins at byte {start} ({found} of {whole} bytes); \
             the {} frames before are whole",
            self.input.position(),
            self.given,
        ))
    }
}

/// Counts the whole frames of a recording by its headers, up to the first damage. `None` where the file cannot be read so.
fn count_frames(path: &Path, len: u64) -> Option<u64> {
    let file = File::open(path).ok()?;
    let (mut at, mut count) = (HEAD as u64, 0);
    let mut bytes = [0; HEADER];
    while file.read_exact_at(&mut bytes, at).is_ok() {
        let Some(header) = Header::from_bytes(&bytes) else { break };
        at += HEADER as u64 + u64::from(header.len);
        if at > len {
            break;
        }
        count += u64::from(header.kind == KIND_FRAME);
    }
    Some(count)
}

impl FrameSource for RecordingSource {
    fn format(&self) -> StreamFormat {
        self.format
    }

    /// Known for files opened by [`RecordingSource::open`]: counted by their headers.
    fn frames(&self) -> Option<u64> {
        self.frames
    }

    fn lend(&mut self) -> Result<Lent<'_>, DeviceError> {
        while !self.ended {
            match self.read_record() {
                Ok(Found::Frame(stamp, len)) => {
                    self.given += 1;
                    return Ok(Lent::Frame(RawFrame { format: self.format, bytes: &self.bytes[..len], stamp }));
                }
                Ok(Found::Format | Found::Unknown) => {}
                Ok(Found::End) => self.ended = true,
                Err(error) => {
                    self.ended = true;
                    return Err(error);
                }
            }
        }
        Ok(Lent::End)
    }
}
