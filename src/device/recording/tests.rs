//! Recordings written, read back, cut and damaged.

use super::record::{self, HEAD, HEADER, Header};
use super::*;
use crate::device::{DeviceError, FrameSink, FrameSource, Input, Lent, Output, RawFrame, StreamFormat};
use crate::frame::{FrameFlags, Stamp};
use crate::image::{PixelFormat, Range, Siting};
use std::io::{self, Cursor, Write};
use std::sync::{Arc, Mutex};

/// Shared bytes, to see what a writer wrote.
#[derive(Clone, Default)]
struct Shared(Arc<Mutex<Vec<u8>>>);

impl Shared {
    fn output(&self) -> Output {
        Output::from_writer("out.gbr".into(), Box::new(self.clone()))
    }

    fn bytes(&self) -> Vec<u8> {
        self.0.lock().unwrap().clone()
    }
}

impl Write for Shared {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.lock().unwrap().write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

fn open(bytes: impl Into<Vec<u8>>) -> Result<RecordingSource, DeviceError> {
    RecordingSource::new(Input::from_reader("test.gbr".into(), Box::new(Cursor::new(bytes.into())), None))
}

/// Format, bytes and stamp of a frame.
type Recorded = (StreamFormat, Vec<u8>, Stamp);

/// Everything a recording gives, then the error if there was one.
fn drain(source: &mut RecordingSource) -> (Vec<Recorded>, Option<String>) {
    let mut frames = Vec::new();
    loop {
        match source.lend() {
            Ok(Lent::Frame(frame)) => frames.push((frame.format, frame.bytes.to_vec(), frame.stamp)),
            Ok(_) => return (frames, None),
            Err(error) => return (frames, Some(error.to_string())),
        }
    }
}

fn stamp(n: u64) -> Stamp {
    Stamp { time_ns: -5 + n as i64 * 33_333_333, sequence: 7 + n, flags: FrameFlags(n as u32 & 3) }
}

/// Two YUYV frames of 4 x 2 with padding, then three of MJPEG.
fn sample() -> (Vec<u8>, Vec<Recorded>) {
    let mut yuyv = StreamFormat::tight(4, 2, PixelFormat::Yuyv, (1001, 30000));
    yuyv.stride = 12;
    yuyv.colour.range = Range::Full;
    yuyv.colour.siting = Siting::Left;
    let mjpeg = StreamFormat { aspect: (4, 3), ..StreamFormat::tight(64, 48, PixelFormat::Mjpeg, (1, 30)) };
    let frames: Vec<_> = [(yuyv, 24), (yuyv, 13), (mjpeg, 100), (mjpeg, 0), (mjpeg, 31)]
        .into_iter()
        .enumerate()
        .map(|(n, (format, len))| (format, (0..len).map(|b| (b * 7 + n) as u8).collect::<Vec<u8>>(), stamp(n as u64)))
        .collect();
    let shared = Shared::default();
    let mut writer = RecordingWriter::new(shared.output(), &yuyv, "Kamera \u{e4}").unwrap();
    for (format, bytes, stamp) in &frames {
        writer.write_raw(&RawFrame { format: *format, bytes, stamp: *stamp }).unwrap();
    }
    writer.finish().unwrap();
    assert_eq!(writer.written(), 5);
    (shared.bytes(), frames)
}

#[test]
fn what_was_recorded_comes_back_exactly() {
    let (bytes, frames) = sample();
    let mut source = open(bytes).unwrap();
    assert_eq!((source.format(), source.device()), (frames[0].0, "Kamera \u{e4}"));
    assert_eq!(drain(&mut source), (frames.clone(), None));
    assert_eq!(source.format(), frames[4].0, "the format changed within");
}

#[test]
fn the_layout_is_the_documented_one() {
    let (bytes, frames) = sample();
    assert_eq!(&bytes[..10], b"\x89GBR\r\n\x1a\n\x01\0");
    assert_eq!(&bytes[16..20], b"FORM");
    let name = "Kamera \u{e4}".len();
    assert_eq!(bytes[20..24], (36 + name as u32).to_le_bytes());
    let payload = &bytes[16 + 36..][..36 + name];
    assert_eq!(&payload[..16], b"YUYV\x04\0\0\0\x02\0\0\0\x0c\0\0\0");
    assert_eq!((payload[32], payload[33], usize::from(payload[34])), (2, 1, name));
    let frame = &bytes[16 + 36 + 36 + name..];
    assert_eq!(&frame[..8], b"FRAM\x18\0\0\0");
    assert_eq!(frame[8..16], frames[0].2.time_ns.to_le_bytes());
    assert_eq!(frame[32..36], crc32fast::hash(&frame[..32]).to_le_bytes());
    assert_eq!(&frame[36..60], &frames[0].1[..]);
}

#[test]
fn a_recording_cut_anywhere_gives_what_is_whole_before() {
    let (bytes, frames) = sample();
    let mut whole_before = 0;
    for cut in 0..bytes.len() {
        let Ok(mut source) = open(&bytes[..cut]) else {
            assert!(cut < HEAD + HEADER + 36 + 9, "cut at {cut}");
            continue;
        };
        let (given, error) = drain(&mut source);
        assert_eq!(given[..], frames[..given.len()], "cut at {cut}");
        assert!(given.len() >= whole_before, "cut at {cut}");
        whole_before = given.len();
        if let Some(said) = error {
            assert!(said.contains(&format!("ends at byte {cut}")), "{said}");
            assert!(said.contains(&format!("the {} frames before are whole", given.len())), "{said}");
        }
        assert!(matches!(source.lend(), Ok(Lent::End)), "ended for good");
    }
    assert_eq!(whole_before, 4);
}

#[test]
fn a_changed_byte_is_noticed_wherever_it_is() {
    let (bytes, frames) = sample();
    for at in 0..bytes.len() {
        let mut bytes = bytes.clone();
        bytes[at] ^= 0x10;
        let Ok(mut source) = open(bytes) else { continue };
        let (given, error) = drain(&mut source);
        match error {
            // In a header or a format: everything before it came as it was.
            Some(said) => {
                assert!(said.contains("damaged at byte"), "byte {at}: {said}");
                assert_eq!(given[..], frames[..given.len()], "byte {at}");
            }
            // In a frame: it alone is marked.
            None => {
                assert_eq!(given.len(), 5);
                let marked: Vec<_> = (0..5).filter(|&n| given[n].1 != frames[n].1).collect();
                assert_eq!(marked.len(), 1, "byte {at}");
                assert!(given[marked[0]].2.flags.contains(FrameFlags::ERROR));
            }
        }
    }
}

#[test]
fn a_header_cannot_make_it_take_memory() {
    let mut bytes = record::head().to_vec();
    let huge = StreamFormat::tight(8192, 8192, PixelFormat::Rgb24, (1, 30));
    let payload = record::format_payload(&huge, "");
    bytes.extend(Header::of_format(&payload).unwrap().to_bytes());
    bytes.extend(payload);
    let mut claim = Header::of_frame(stamp(0), b"").unwrap();
    claim.len = 2 * 8192 * 8192 * 3;
    let mut allowed = bytes.clone();
    allowed.extend(claim.to_bytes());
    let mut source = open(allowed).unwrap();
    assert!(drain(&mut source).1.unwrap().contains("truncated"));
    assert!(source.bytes_held() <= 1 << 20, "{} bytes held", source.bytes_held());
    claim.len = u32::MAX;
    bytes.extend(claim.to_bytes());
    assert!(drain(&mut open(bytes).unwrap()).1.unwrap().contains("claims 4294967295 bytes"));
}

#[test]
fn unknown_records_are_skipped_and_unknown_versions_refused() {
    let (mut bytes, frames) = sample();
    let mut header = Header::of_frame(Stamp::default(), b"later").unwrap();
    header.kind = *b"NOTE";
    bytes.extend(header.to_bytes());
    bytes.extend(b"later");
    assert_eq!(drain(&mut open(bytes.clone()).unwrap()), (frames, None));
    bytes[8] = 2;
    let crc = crc32fast::hash(&bytes[..12]);
    bytes[12..16].copy_from_slice(&crc.to_le_bytes());
    let said = open(bytes).unwrap_err().to_string();
    assert!(said.contains("version 2, this gimbald reads version 1"), "{said}");
}

#[test]
fn formats_without_sense_are_refused() {
    let refused = |format: StreamFormat| {
        let payload = record::format_payload(&format, "x");
        let read = record::parse_format(&payload).unwrap_err();
        let written = RecordingWriter::new(Shared::default().output(), &format, "x").unwrap_err().to_string();
        assert!(written.contains(&read), "{written} / {read}");
        read
    };
    let good = StreamFormat::tight(4, 2, PixelFormat::Yuyv, (1, 30));
    assert!(refused(StreamFormat { width: 0, ..good }).contains("0x2"));
    assert!(refused(StreamFormat { height: 8193, ..good }).contains("4x8193"));
    assert!(refused(StreamFormat { stride: 7, ..good }).contains("7 bytes apart, expected 8"));
    assert!(refused(StreamFormat { stride: 1 << 30, ..good }).contains("apart"));
    let mut payload = record::format_payload(&good, "x");
    payload[..4].copy_from_slice(b"H264");
    assert!(record::parse_format(&payload).unwrap_err().contains("\"H264\""));
    assert!(record::parse_format(&payload[..20]).unwrap_err().contains("has 20 bytes"));
}

#[test]
fn a_frame_too_long_for_its_format_is_not_written() {
    let format = StreamFormat::tight(4, 2, PixelFormat::Yuyv, (1, 30));
    let shared = Shared::default();
    let mut writer = RecordingWriter::new(shared.output(), &format, "x").unwrap();
    let before = shared.bytes();
    let bytes = vec![0; 2 * 16 + (1 << 16) + 1];
    let said = writer.write_raw(&RawFrame { format, bytes: &bytes, stamp: stamp(0) }).unwrap_err().to_string();
    assert!(said.contains("a frame of 65569 bytes, 65568 were expected at most"), "{said}");
    assert_eq!(shared.bytes(), before);
}

#[test]
fn each_frame_is_handed_on_at_once() {
    let format = StreamFormat::tight(4, 2, PixelFormat::Yuyv, (1, 30));
    let shared = Shared::default();
    let mut writer = RecordingWriter::new(shared.output(), &format, "x").unwrap();
    writer.write_raw(&RawFrame { format, bytes: &[9; 16], stamp: stamp(0) }).unwrap();
    // The writer still lives, as it would in a recorder that is killed.
    assert_eq!(drain(&mut open(shared.bytes()).unwrap()).0.len(), 1);
    drop(writer);
}

#[test]
fn pictures_are_recorded_in_their_planar_format() {
    for (from, to) in
        [(PixelFormat::Yuyv, PixelFormat::I420), (PixelFormat::I444, PixelFormat::I444), (PixelFormat::Grey, PixelFormat::Grey)]
    {
        let shared = Shared::default();
        let mut sink = RecordingSink::new(shared.output(), &StreamFormat::tight(5, 3, from, (1, 30))).unwrap();
        for (n, mut plane) in sink.canvas().unwrap().planes.into_iter().enumerate() {
            for row in 0..plane.height() {
                plane.row_mut(row).fill(10 * n as u8 + row as u8);
            }
        }
        sink.submit(&stamp(3)).unwrap();
        sink.finish().unwrap();
        let (frames, error) = drain(&mut open(shared.bytes()).unwrap());
        let (format, bytes, read) = &frames[0];
        assert_eq!((frames.len(), error, format.pixel, *read), (1, None, to, stamp(3)));
        assert_eq!((bytes[0], bytes[14]), (0, 2));
        if to != PixelFormat::Grey {
            assert_eq!((bytes[15], bytes.last()), (10, Some(&if to == PixelFormat::I420 { 21 } else { 22 })));
        }
    }
}
