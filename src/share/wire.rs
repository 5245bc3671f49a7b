//! The messages between daemon and companion: one tag, then fields of fixed size, little-endian.

use std::path::PathBuf;

use super::lease::Kind;
use crate::image::MAX_SIDE;

/// Both ends are of one program and are updated together; another version ends the connection.
const VERSION: u32 = 1;

/// Bytes of the longest message.
pub(super) const LONGEST: usize = 32 + LONGEST_PATH;
/// Bytes of the longest name of a camera's node; `/dev/video63` has twelve.
const LONGEST_PATH: usize = 200;

/// What pictures the daemon makes, and of which camera.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Format {
    /// Pixels; even.
    pub width: u32,
    /// Pixels; even.
    pub height: u32,
    /// Nominal time between pictures (seconds, numerator and denominator).
    pub interval: (u32, u32),
    /// The camera's node, which a companion has to open for its proof; empty where there is no camera.
    pub camera: PathBuf,
}

impl Format {
    fn is_sane(&self) -> bool {
        bytes(self.width, self.height).is_some() && self.interval.0 > 0 && self.interval.1 > 0
    }
}

/// Bytes of a picture of that size; `None` where there can be no such picture.
pub(super) fn bytes(width: u32, height: u32) -> Option<usize> {
    let fits = |side: u32| side.is_multiple_of(2) && (2..=MAX_SIDE).contains(&side);
    (fits(width) && fits(height)).then(|| 2 * width as usize * height as usize)
}

/// Why a companion that is watched gets no pictures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refusal {
    /// It gave no descriptor of the camera's node, opened to read and write.
    Proof,
    /// Its readers hold another size.
    Size,
}

/// What the daemon says.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum FromDaemon {
    Format(Format),
    Frame { id: u64, time_ns: i64 },
    Refused(Refusal),
}

/// What a companion says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum FromCompanion {
    /// Whether a program watches, which pictures it wants, and the size of the node.
    Watch {
        wants: Option<Kind>,
        size: (u32, u32),
    },
    Lend {
        id: u64,
    },
    Free {
        id: u64,
    },
    Revoke {
        id: u64,
    },
}

/// A message's bytes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Packet {
    bytes: [u8; LONGEST],
    len: usize,
}

impl Packet {
    fn new(tag: u32) -> Self {
        Self { bytes: [0; LONGEST], len: 0 }.word(VERSION << 16 | tag)
    }

    fn word(self, word: u32) -> Self {
        self.append(&word.to_le_bytes())
    }

    fn long(self, long: u64) -> Self {
        self.append(&long.to_le_bytes())
    }

    fn append(mut self, bytes: &[u8]) -> Self {
        let end = self.len + bytes.len();
        self.bytes[self.len..end].copy_from_slice(bytes);
        self.len = end;
        self
    }

    pub(super) fn bytes(&self) -> &[u8] {
        &self.bytes[..self.len]
    }
}

/// Takes fields off a message's front.
struct Reader<'a>(&'a [u8]);

impl Reader<'_> {
    fn word(&mut self) -> Option<u32> {
        let (word, rest) = self.0.split_first_chunk()?;
        self.0 = rest;
        Some(u32::from_le_bytes(*word))
    }

    fn long(&mut self) -> Option<u64> {
        let (long, rest) = self.0.split_first_chunk()?;
        self.0 = rest;
        Some(u64::from_le_bytes(*long))
    }

    /// The tag of a message of this version.
    fn tag(&mut self) -> Option<u32> {
        let word = self.word()?;
        (word >> 16 == VERSION).then_some(word & 0xffff)
    }
}

impl FromDaemon {
    pub(super) fn packet(&self) -> Packet {
        match self {
            Self::Format(format) => {
                let path = format.camera.as_os_str().as_encoded_bytes();
                // A path that is too long is no camera's.
                let path = if path.len() > LONGEST_PATH { &[] } else { path };
                let (numerator, denominator) = format.interval;
                Packet::new(1).word(format.width).word(format.height).word(numerator).word(denominator).append(path)
            }
            Self::Frame { id, time_ns } => Packet::new(2).long(*id).long(time_ns.cast_unsigned()),
            Self::Refused(refusal) => Packet::new(3).word(*refusal as u32),
        }
    }

    /// `None` where it is no such message.
    pub(super) fn read(bytes: &[u8]) -> Option<Self> {
        use std::os::unix::ffi::OsStrExt as _;
        let mut reader = Reader(bytes);
        let message = match reader.tag()? {
            1 => {
                let (width, height) = (reader.word()?, reader.word()?);
                let interval = (reader.word()?, reader.word()?);
                let camera = PathBuf::from(std::ffi::OsStr::from_bytes(std::mem::take(&mut reader.0)));
                let format = Format { width, height, interval, camera };
                Self::Format(Some(format).filter(Format::is_sane)?)
            }
            2 => Self::Frame { id: reader.long()?, time_ns: reader.long()?.cast_signed() },
            3 => Self::Refused(match reader.word()? {
                0 => Refusal::Proof,
                1 => Refusal::Size,
                _ => return None,
            }),
            _ => return None,
        };
        reader.0.is_empty().then_some(message)
    }
}

impl FromCompanion {
    pub(super) fn packet(&self) -> Packet {
        match *self {
            Self::Watch { wants, size } => Packet::new(16).word(wants.map_or(0, |kind| kind as u32)).word(size.0).word(size.1),
            Self::Lend { id } => Packet::new(17).long(id),
            Self::Free { id } => Packet::new(18).long(id),
            Self::Revoke { id } => Packet::new(19).long(id),
        }
    }

    /// `None` where it is no such message.
    pub(super) fn read(bytes: &[u8]) -> Option<Self> {
        let mut reader = Reader(bytes);
        let message = match reader.tag()? {
            16 => {
                let wants = match reader.word()? {
                    0 => None,
                    1 => Some(Kind::Output),
                    2 => Some(Kind::Both),
                    _ => return None,
                };
                Self::Watch { wants, size: (reader.word()?, reader.word()?) }
            }
            17 => Self::Lend { id: reader.long()? },
            18 => Self::Free { id: reader.long()? },
            19 => Self::Revoke { id: reader.long()? },
            _ => return None,
        };
        reader.0.is_empty().then_some(message)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn format(camera: &str) -> Format {
        Format { width: 1280, height: 720, interval: (1, 30), camera: camera.into() }
    }

    #[test]
    fn messages_are_read_as_they_were_written() {
        let daemon = [
            FromDaemon::Format(format("/dev/video0")),
            FromDaemon::Format(format("")),
            FromDaemon::Frame { id: u64::MAX, time_ns: -5 },
            FromDaemon::Refused(Refusal::Proof),
            FromDaemon::Refused(Refusal::Size),
        ];
        for message in daemon {
            assert_eq!(FromDaemon::read(message.packet().bytes()), Some(message));
        }
        let companion = [
            FromCompanion::Watch { wants: Some(Kind::Output), size: (640, 480) },
            FromCompanion::Watch { wants: Some(Kind::Both), size: (640, 480) },
            FromCompanion::Watch { wants: None, size: (640, 480) },
            FromCompanion::Lend { id: 7 },
            FromCompanion::Free { id: 8 },
            FromCompanion::Revoke { id: 9 },
        ];
        for message in companion {
            assert_eq!(FromCompanion::read(message.packet().bytes()), Some(message));
        }
    }

    #[test]
    fn what_is_no_message_is_refused() {
        let watch = FromCompanion::Watch { wants: Some(Kind::Output), size: (2, 2) }.packet();
        for len in 0..watch.bytes().len() {
            assert_eq!(FromCompanion::read(&watch.bytes()[..len]), None, "cut to {len}");
        }
        let longer = [watch.bytes(), &[0]].concat();
        assert_eq!(FromCompanion::read(&longer), None);
        let mut other = watch.bytes().to_vec();
        other[2] = 9;
        assert_eq!(FromCompanion::read(&other), None, "another version");
        assert_eq!(FromCompanion::read(FromDaemon::Refused(Refusal::Size).packet().bytes()), None);
        for (width, height) in [(0, 720), (1281, 720), (1280, u32::MAX), (8194, 2)] {
            let message = FromDaemon::Format(Format { width, height, ..format("") });
            assert_eq!(FromDaemon::read(message.packet().bytes()), None, "{width}x{height}");
        }
        let long = format(&"x".repeat(LONGEST_PATH + 1));
        let read = FromDaemon::read(FromDaemon::Format(long).packet().bytes());
        assert_eq!(read, Some(FromDaemon::Format(format(""))), "a path that is too long is none");
    }
}
