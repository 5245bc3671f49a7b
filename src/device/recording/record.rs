//! File header, record headers and formats as bytes, and back.

use super::MAGIC;
use crate::device::StreamFormat;
use crate::frame::{FrameFlags, Stamp};
use crate::image::{Colour, MAX_COMPRESSED_PIXELS, MAX_SIDE, PixelFormat, Range, RawLayout, Siting};

/// The version that is written, and the only one that is read.
const VERSION: u16 = 1;

/// Bytes of a head.
pub(super) const HEAD: usize = 16;

/// Bytes of a record's header.
pub(super) const HEADER: usize = 36;

/// Bytes of a format without the device's name.
const FORMAT: usize = 36;

/// The longest name of a device, bytes.
const LONGEST_NAME: usize = 255;

/// The longest payload of a record of an unknown kind.
pub(super) const LONGEST_UNKNOWN: usize = 1 << 20;

/// What frames may have beyond what their format needs.
const SLACK: usize = 1 << 16;

pub(super) const KIND_FORMAT: [u8; 4] = *b"FORM";
pub(super) const KIND_FRAME: [u8; 4] = *b"FRAM";

/// A record's header.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Header {
    pub(super) kind: [u8; 4],
    pub(super) len: u32,
    pub(super) stamp: Stamp,
    pub(super) payload_crc: u32,
}

/// Takes little-endian numbers off the front of a slice that was checked to be long enough; zero beyond its end.
struct Numbers<'a>(&'a [u8]);

impl Numbers<'_> {
    fn next_bytes<const N: usize>(&mut self) -> [u8; N] {
        match self.0.split_first_chunk() {
            Some((bytes, rest)) => {
                self.0 = rest;
                *bytes
            }
            None => [0; N],
        }
    }

    fn u32(&mut self) -> u32 {
        u32::from_le_bytes(self.next_bytes())
    }
}

/// A file's first bytes.
pub(super) fn head() -> [u8; HEAD] {
    let mut bytes = [0; HEAD];
    bytes[..8].copy_from_slice(MAGIC);
    bytes[8..10].copy_from_slice(&VERSION.to_le_bytes());
    let crc = crc32fast::hash(&bytes[..12]);
    bytes[12..].copy_from_slice(&crc.to_le_bytes());
    bytes
}

/// Whether a file with these first bytes can be read; a sentence if not.
pub(super) fn check_head(bytes: &[u8; HEAD]) -> Result<(), String> {
    if bytes[..8] != MAGIC[..] {
        return Err("it does not begin as a recording does".into());
    }
    let mut numbers = Numbers(&bytes[8..]);
    let (version, _, crc) = (u16::from_le_bytes(numbers.next_bytes()), numbers.next_bytes::<2>(), numbers.u32());
    if crc != crc32fast::hash(&bytes[..12]) {
        return Err("its head (bytes 0 to 15) is damaged".into());
    }
    if version != VERSION {
        return Err(format!("it is of version {version}, this gimbald reads version {VERSION}; a newer gimbald may read it"));
    }
    Ok(())
}

impl Header {
    pub(super) fn of_frame(stamp: Stamp, payload: &[u8]) -> Option<Self> {
        Some(Self { kind: KIND_FRAME, len: u32::try_from(payload.len()).ok()?, stamp, payload_crc: crc32fast::hash(payload) })
    }

    pub(super) fn of_format(payload: &[u8]) -> Option<Self> {
        Self::of_frame(Stamp::default(), payload).map(|header| Self { kind: KIND_FORMAT, ..header })
    }

    pub(super) fn to_bytes(self) -> [u8; HEADER] {
        let mut bytes = [0; HEADER];
        bytes[..4].copy_from_slice(&self.kind);
        bytes[4..8].copy_from_slice(&self.len.to_le_bytes());
        bytes[8..16].copy_from_slice(&self.stamp.time_ns.to_le_bytes());
        bytes[16..24].copy_from_slice(&self.stamp.sequence.to_le_bytes());
        bytes[24..28].copy_from_slice(&self.stamp.flags.0.to_le_bytes());
        bytes[28..32].copy_from_slice(&self.payload_crc.to_le_bytes());
        let crc = crc32fast::hash(&bytes[..32]);
        bytes[32..].copy_from_slice(&crc.to_le_bytes());
        bytes
    }

    /// `None` where the bytes are damaged.
    pub(super) fn from_bytes(bytes: &[u8; HEADER]) -> Option<Self> {
        let mut numbers = Numbers(bytes);
        let (kind, len) = (numbers.next_bytes(), numbers.u32());
        let stamp = Stamp {
            time_ns: i64::from_le_bytes(numbers.next_bytes()),
            sequence: u64::from_le_bytes(numbers.next_bytes()),
            flags: FrameFlags(numbers.u32()),
        };
        let payload_crc = numbers.u32();
        (numbers.u32() == crc32fast::hash(&bytes[..32])).then_some(Self { kind, len, stamp, payload_crc })
    }
}

/// A format record's payload. A name that is too long is cut.
pub(super) fn format_payload(format: &StreamFormat, device: &str) -> Vec<u8> {
    let mut end = device.len().min(LONGEST_NAME);
    while !device.is_char_boundary(end) {
        end -= 1;
    }
    let mut bytes = Vec::with_capacity(FORMAT + end);
    bytes.extend_from_slice(&format.pixel.fourcc());
    let stride = u32::try_from(format.stride).unwrap_or(u32::MAX);
    let (interval, aspect) = (format.interval, format.aspect);
    for number in [format.width, format.height, stride, interval.0, interval.1, aspect.0, aspect.1] {
        bytes.extend_from_slice(&number.to_le_bytes());
    }
    let range = match format.colour.range {
        Range::Unknown => 0,
        Range::Limited => 1,
        Range::Full => 2,
    };
    let siting = match format.colour.siting {
        Siting::Centre => 0,
        Siting::Left => 1,
        Siting::TopLeft => 2,
    };
    bytes.extend_from_slice(&[range, siting, end as u8, 0]);
    bytes.extend_from_slice(&device.as_bytes()[..end]);
    bytes
}

/// The format and the device's name in a format record's payload; a sentence where it makes no sense.
pub(super) fn parse_format(bytes: &[u8]) -> Result<(StreamFormat, String), String> {
    if bytes.len() < FORMAT || bytes.len() > FORMAT + LONGEST_NAME {
        return Err(format!("its format has {} bytes, expected {FORMAT} to {}", bytes.len(), FORMAT + LONGEST_NAME));
    }
    let mut numbers = Numbers(bytes);
    let code: [u8; 4] = numbers.next_bytes();
    let pixel = PixelFormat::from_fourcc(code)
        .ok_or_else(|| format!("its pixel format {:?} is not one that gimbald reads", String::from_utf8_lossy(&code)))?;
    let (width, height, stride) = (numbers.u32(), numbers.u32(), numbers.u32() as usize);
    let interval = (numbers.u32(), numbers.u32());
    let aspect = (numbers.u32(), numbers.u32());
    let [range, siting] = numbers.next_bytes();
    let name = bytes.get(FORMAT..FORMAT + usize::from(u16::from_le_bytes(numbers.next_bytes()))).unwrap_or_default();
    let colour = Colour {
        range: [Range::Unknown, Range::Limited, Range::Full].get(usize::from(range)).copied().unwrap_or_default(),
        siting: [Siting::Centre, Siting::Left, Siting::TopLeft].get(usize::from(siting)).copied().unwrap_or_default(),
    };
    let format = StreamFormat { width, height, pixel, stride, interval, aspect, colour };
    longest_frame(&format)?;
    Ok((format, String::from_utf8_lossy(name).into_owned()))
}

/// The most bytes that a frame of `format` may have; a sentence where the format makes no sense.
pub(super) fn longest_frame(format: &StreamFormat) -> Result<usize, String> {
    let StreamFormat { width, height, stride, pixel, .. } = *format;
    let sizes = 1..=MAX_SIDE;
    if !sizes.contains(&width) || !sizes.contains(&height) {
        return Err(format!("its pictures are {width}x{height}, expected 1x1 to {MAX_SIDE}x{MAX_SIDE}"));
    }
    if pixel.is_too_large(width, height) {
        return Err(format!(
            "its {pixel} pictures are {width}x{height}, expected at most {MAX_COMPRESSED_PIXELS} pixels (7680x4320) of a compressed format"
        ));
    }
    if pixel.is_compressed() {
        return Ok(4 * width as usize * height as usize + SLACK);
    }
    let widest = 8 * MAX_SIDE as usize;
    let bytes = RawLayout::new(pixel, width, height, stride).filter(|_| stride <= widest).and_then(|_| format.frame_bytes());
    let bytes = bytes.ok_or_else(|| {
        let least = pixel.tight_stride(width);
        format!("its rows are {stride} bytes apart, expected {least} to {widest} for {pixel} of width {width}")
    })?;
    Ok(2 * bytes + SLACK)
}
