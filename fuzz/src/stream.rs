//! Recorded streams: read to their end or their first fault.

use gimbald::device::recording::RecordingSource;
use gimbald::device::y4m::Y4mSource;
use gimbald::device::{DeviceError, FrameSource, Input, Lent};
use std::hint::black_box;
use std::io::Cursor;

/// A recording as it is: most inputs end at their first checksum.
pub fn recording(data: &[u8]) {
    drain(RecordingSource::new(input(data.to_vec())));
}

/// A recording whose checksums are made right, so that what lies behind them is reached.
pub fn mended_recording(data: &[u8]) {
    drain(RecordingSource::new(input(mended(data))));
}

/// A YUV4MPEG2 stream.
pub fn y4m(data: &[u8]) {
    drain(Y4mSource::new(input(data.to_vec())));
}

fn input(bytes: Vec<u8>) -> Input {
    let len = bytes.len() as u64;
    Input::from_reader("input".into(), Box::new(Cursor::new(bytes)), Some(len))
}

/// Reads a source through. Each frame can be looked at from its first byte to its last; after an error or the end nothing more comes.
fn drain(source: Result<impl FrameSource, DeviceError>) {
    let Ok(mut source) = source else { return };
    black_box(source.format().rate());
    for n in 0.. {
        match source.lend() {
            Ok(Lent::Frame(frame)) => {
                black_box((
                    frame.bytes.first(),
                    frame.bytes.last(),
                    frame.format.frame_bytes(),
                    frame.format.nominal_time_ns(n),
                ));
            }
            Ok(Lent::Idle) => panic!("a file is never idle"),
            Ok(Lent::End) => return,
            Err(error) => {
                assert!(!error.to_string().is_empty());
                assert!(matches!(source.lend(), Ok(Lent::End)), "a stream goes on after {error}");
                return;
            }
        }
    }
}

/// Bytes of a recording's head and of a record's header, of which the last four are a CRC-32 of those before.
const HEAD: usize = 16;
const HEADER: usize = 36;

/// `data` as a recording, with its head, and the checksums of each record and its payload, set right.
pub fn mended(data: &[u8]) -> Vec<u8> {
    let mut bytes = b"\x89GBR\r\n\x1a\n\x01\0\0\0\0\0\0\0".to_vec();
    bytes.extend_from_slice(data.get(HEAD..).unwrap_or_default());
    seal(&mut bytes[..HEAD]);
    let mut rest = &mut bytes[HEAD..];
    while rest.len() >= HEADER {
        let (header, behind) = rest.split_at_mut(HEADER);
        let claimed = u32::from_le_bytes([header[4], header[5], header[6], header[7]]) as usize;
        let (payload, next) = behind.split_at_mut(claimed.min(behind.len()));
        header[28..32].copy_from_slice(&crc32fast::hash(payload).to_le_bytes());
        seal(header);
        rest = next;
    }
    bytes
}

/// Sets the last four bytes to the CRC-32 of those before.
fn seal(bytes: &mut [u8]) {
    let (content, crc) = bytes.split_at_mut(bytes.len() - 4);
    crc.copy_from_slice(&crc32fast::hash(content).to_le_bytes());
}
