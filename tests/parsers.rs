//! Damaged, cut, random and monstrous input to every parser of files: frames or a clear error, bounded memory, never a panic.

use gimbald::device::recording::{RecordingSource, RecordingWriter};
use gimbald::device::y4m::Y4mSource;
use gimbald::device::{DeviceError, FrameSource, Input, Lent, Output, RawFrame, StreamFormat, replay};
use gimbald::frame::{FrameFlags, Stamp};
use gimbald::image::{Picture, PixelFormat, Range};
use gimbald::stage::unpack::{Unpack, UnpackError};
use proptest::prelude::*;
use std::io::{self, Cursor, Read, Write};
use std::path::Path;
use std::sync::{Arc, Mutex};

/// What a source gave: each frame's bytes and whether it is marked as damaged; and the error, if there was one.
#[derive(Debug, Default, PartialEq)]
struct Given {
    frames: Vec<(Vec<u8>, bool)>,
    error: Option<String>,
}

/// Takes everything there is. The source has to come to an end, say each error once and name its file in it.
fn drain(source: Result<impl FrameSource, DeviceError>) -> Given {
    let mut given = Given::default();
    let outcome = source.and_then(|mut source| {
        loop {
            match source.lend() {
                Ok(Lent::Frame(frame)) => {
                    let marked = frame.stamp.flags.contains(FrameFlags::ERROR);
                    given.frames.push((frame.bytes.to_vec(), marked));
                }
                Ok(_) => return Ok(()),
                Err(error) => {
                    assert!(matches!(source.lend(), Ok(Lent::End)), "after an error comes the end");
                    return Err(error);
                }
            }
        }
    });
    given.error = outcome.err().map(|error| error.to_string());
    assert!(given.error.iter().all(|said| said.starts_with("test: ") && said.len() > 20), "{:?}", given.error);
    given
}

/// Gives its bytes in pieces of no more than `step`, as pipes do.
struct Trickle(Cursor<Vec<u8>>, usize);

impl Read for Trickle {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        let step = self.1.min(into.len());
        self.0.read(&mut into[..step])
    }
}

fn input(bytes: &[u8], step: usize) -> Input {
    Input::from_reader("test".into(), Box::new(Trickle(Cursor::new(bytes.to_vec()), step.max(1))), None)
}

fn y4m(bytes: &[u8]) -> Given {
    drain(Y4mSource::new(input(bytes, usize::MAX)))
}

fn recording(bytes: &[u8]) -> Given {
    drain(RecordingSource::new(input(bytes, usize::MAX)))
}

#[derive(Clone, Default)]
struct Shared(Arc<Mutex<Vec<u8>>>);

impl Write for Shared {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.lock().map_err(|_| io::ErrorKind::Other)?.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// A recording of the given frames, one format.
fn record(format: &StreamFormat, frames: &[Vec<u8>]) -> Vec<u8> {
    let shared = Shared::default();
    let mut writer =
        RecordingWriter::new(Output::from_writer("test".into(), Box::new(shared.clone())), format, "a camera").unwrap();
    for (n, bytes) in frames.iter().enumerate() {
        let stamp = Stamp { time_ns: n as i64 * 40_000_000, sequence: n as u64, flags: FrameFlags::default() };
        writer.write_raw(&RawFrame { format: *format, bytes, stamp }).unwrap();
    }
    writer.finish().unwrap();
    let bytes = shared.0.lock().unwrap();
    bytes.clone()
}

/// The frames of a fixture: real pictures of a real camera's coder.
fn jpegs() -> Vec<Vec<u8>> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/car-mjpeg-400x300.gbr");
    drain_file(&path).unwrap()
}

fn drain_file(path: &Path) -> Result<Vec<Vec<u8>>, DeviceError> {
    let mut source = replay::open(path)?;
    let mut frames = Vec::new();
    while let Lent::Frame(frame) = source.lend()? {
        frames.push(frame.bytes.to_vec());
    }
    Ok(frames)
}

/// Most memory that this process ever had in use, MiB.
fn peak_mib() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).unwrap();
    line.trim().trim_end_matches(" kB").parse::<u64>().unwrap() / 1024
}

/// A small y4m stream and its frames.
fn y4m_stream(width: usize, height: usize, chroma: &str, count: usize) -> (Vec<u8>, Vec<Vec<u8>>) {
    let (cw, ch) = match chroma {
        "420jpeg" => (width.div_ceil(2), height.div_ceil(2)),
        "422" => (width.div_ceil(2), height),
        "444" => (width, height),
        _ => (0, 0),
    };
    let len = width * height + 2 * cw * ch;
    let frames: Vec<Vec<u8>> = (0..count).map(|n| (0..len).map(|b| (b * 31 + n * 7) as u8).collect()).collect();
    let mut bytes = format!("YUV4MPEG2 W{width} H{height} F25:1 Ip A1:1 C{chroma}\n").into_bytes();
    for frame in &frames {
        bytes.extend(b"FRAME\n");
        bytes.extend(frame);
    }
    (bytes, frames)
}

fn chromas() -> impl Strategy<Value = &'static str> {
    prop::sample::select(vec!["420jpeg", "422", "444", "mono"])
}

fn raw_formats() -> impl Strategy<Value = PixelFormat> {
    prop::sample::select(PixelFormat::ALL.to_vec())
}

/// Places (as a share of the length) and values of bytes to change.
fn changes() -> impl Strategy<Value = Vec<(f64, u8)>> {
    prop::collection::vec((0.0..1.0, any::<u8>()), 1..6)
}

fn change(bytes: &mut [u8], changes: &[(f64, u8)]) {
    for &(place, value) in changes {
        let at = (place * bytes.len() as f64) as usize;
        bytes[at] = value;
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn y4m_comes_through_any_pipe(w in 1usize..24, h in 1usize..16, chroma in chromas(), count in 0usize..4, step in 1usize..60) {
        let (bytes, frames) = y4m_stream(w, h, chroma, count);
        let given = drain(Y4mSource::new(input(&bytes, step)));
        prop_assert_eq!(given, Given { frames: frames.into_iter().map(|f| (f, false)).collect(), error: None });
    }

    #[test]
    fn y4m_that_is_cut_or_changed_is_no_surprise(
        w in 1usize..24, h in 1usize..16, chroma in chromas(), changes in changes(), cut in 0.0..1.0f64,
    ) {
        let (whole, frames) = y4m_stream(w, h, chroma, 3);
        let cut = &whole[..(cut * whole.len() as f64) as usize];
        let given = y4m(cut);
        for (got, want) in given.frames.iter().zip(&frames) {
            prop_assert_eq!(&got.0, want);
        }
        let header = whole.iter().position(|&b| b == b'\n').unwrap_or(0) + 1;
        let clean = cut.len() >= header && (cut.len() - header) % (6 + frames[0].len()) == 0;
        prop_assert_eq!(given.error.is_none(), clean);

        let mut changed = whole.clone();
        change(&mut changed, &changes);
        // Frames or an error; no more bytes than there were.
        let given = y4m(&changed);
        prop_assert!(given.frames.iter().map(|f| f.0.len()).sum::<usize>() <= whole.len());
    }

    #[test]
    fn random_words_are_a_y4m_header_or_an_error(words in "[ WHFIACX0-9a-z:?=-]{0,60}", rest in prop::collection::vec(any::<u8>(), 0..300)) {
        let mut bytes = format!("YUV4MPEG2 {words}\n").into_bytes();
        bytes.extend(rest);
        y4m(&bytes);
    }

    #[test]
    fn random_bytes_are_nothing(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        for begin in [&b""[..], b"YUV4MPEG2 ", b"\x89GBR\r\n\x1a\n"] {
            let bytes = [begin, &bytes].concat();
            prop_assert!(recording(&bytes).error.is_some());
            prop_assert!(begin != b"" || y4m(&bytes).error.is_some());
            y4m(&bytes);
        }
    }

    #[test]
    fn recordings_come_through_any_pipe(
        format in raw_formats(), w in 1u32..24, h in 1u32..16, pad in 0usize..5,
        frames in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..200), 0..4), step in 1usize..60,
    ) {
        let mut stream = StreamFormat::tight(w, h, format, (1, 25));
        stream.stride += if format.is_compressed() { 0 } else { pad };
        let given = drain(RecordingSource::new(input(&record(&stream, &frames), step)));
        prop_assert_eq!(given, Given { frames: frames.into_iter().map(|f| (f, false)).collect(), error: None });
    }

    #[test]
    fn recordings_that_are_cut_or_changed_say_so(
        format in raw_formats(), frames in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..200), 1..4),
        changes in changes(), cut in 0.0..1.0f64,
    ) {
        let whole = record(&StreamFormat::tight(16, 8, format, (1, 25)), &frames);
        let given = recording(&whole[..(cut * whole.len() as f64) as usize]);
        for (got, want) in given.frames.iter().zip(&frames) {
            prop_assert_eq!(got, &(want.clone(), false));
        }
        let mut changed = whole.clone();
        change(&mut changed, &changes);
        let given = recording(&changed);
        // Nothing changed comes unmarked.
        for (got, want) in given.frames.iter().zip(&frames) {
            prop_assert!(&got.0 == want || got.1);
        }
        prop_assert!(changed == whole || given.error.is_some() || given.frames.iter().any(|f| f.1));
    }

    #[test]
    fn a_real_picture_with_changed_or_missing_bytes_is_a_picture_or_an_error(
        which in 0usize..24, changes in changes(), cut in 0.0..1.0f64, shorten: bool,
    ) {
        let whole = jpegs().swap_remove(which);
        let cut = (cut * whole.len() as f64) as usize;
        let mut changed = whole.clone();
        change(&mut changed, &changes);
        if shorten {
            changed.truncate(cut);
        }
        let mut unpack = Unpack::new();
        let mut picture = Picture::default();
        let mut decode = |bytes: &[u8]| unpack.unpack(PixelFormat::Mjpeg, Range::Full, (400, 300), 0, bytes, &mut picture);
        // A changed byte may well make another whole picture; a missing end cannot, and is an exception where most come whole.
        for _ in 0..6 {
            prop_assert_eq!(decode(&whole), Ok(()));
        }
        let _ = decode(&changed);
        prop_assert!(decode(&whole[..cut.min(whole.len() - 3)]).is_err());
        prop_assert_eq!(decode(&whole), Ok(()), "the next picture is well");
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 40, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn any_file_can_be_offered_for_replay(kind in 0usize..4, rest in prop::collection::vec(any::<u8>(), 0..300)) {
        let begin: &[u8] = [&b""[..], b"YUV4MPEG2 W2 H2\n", b"\x89GBR\r\n\x1a\n\x01\0\0\0", b"\0\0\0\x20ftypisom"][kind];
        let path = std::env::temp_dir().join(format!("gimbald-any-{}", std::process::id()));
        std::fs::write(&path, [begin, &rest].concat()).unwrap();
        let frames = drain_file(&path);
        std::fs::remove_file(&path).unwrap();
        if let Err(error) = frames {
            prop_assert!(error.to_string().starts_with(&path.display().to_string()));
        }
    }
}

#[test]
fn monstrous_claims_take_no_memory() {
    let before = peak_mib();
    // A y4m header that is allowed (200 MB a frame), and ones that are not.
    for chroma in ["444", "411"] {
        let given = y4m(format!("YUV4MPEG2 W8192 H8192 F25:1 C{chroma}\nFRAME\nand then nothing").as_bytes());
        assert!(given.error.unwrap().contains("truncated"), "{chroma}: allowed, but cut");
    }
    for size in ["W8193 H1", "W1 H8193", "W4294967296 H1", "W4294967295 H4294967295", "W-1 H1", "W1 H99999999999999999999999"] {
        let error = y4m(format!("YUV4MPEG2 {size} F25:1\nFRAME\n").as_bytes()).error.unwrap();
        assert!(error.contains("expected 1 to 8192"), "{size}: {error}");
    }
    // A recording of the largest pictures, cut within its first.
    let stream = StreamFormat::tight(7680, 4320, PixelFormat::Mjpeg, (1, 25));
    let bytes = record(&stream, &[vec![1; 1000]]);
    assert!(recording(&bytes[..bytes.len() - 1]).error.unwrap().contains("truncated"));
    // Larger ones, of which one picture would take 200 MB to decode, are refused by who reads and by who writes.
    let stream = StreamFormat::tight(7680, 4321, PixelFormat::Mjpeg, (1, 25));
    let output = Output::from_writer("test".into(), Box::new(Shared::default()));
    let error = RecordingWriter::new(output, &stream, "a camera").unwrap_err().to_string();
    assert!(error.contains("7680x4321, expected at most 33177600 pixels"), "{error}");
    // A picture that claims to be 65500 pixels wide and high.
    let mut jpeg = jpegs().swap_remove(0);
    let header = jpeg.windows(2).position(|w| w == [0xff, 0xc0]).unwrap();
    jpeg[header + 5..header + 9].copy_from_slice(&[0xff, 0xdc, 0xff, 0xdc]);
    let error =
        Unpack::new().unpack(PixelFormat::Mjpeg, Range::Full, (400, 300), 0, &jpeg, &mut Picture::default()).unwrap_err();
    assert_eq!(error, UnpackError::SizeMismatch { found: (65500, 65500), expected: (400, 300) });
    // Other tests of this file run beside this one, with some MiB of their own.
    let grown = peak_mib() - before;
    assert!(grown < 64, "{grown} MiB more than before");
}
