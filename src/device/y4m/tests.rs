//! y4m headers, frames, round trips and damage.

use super::*;
use crate::device::{DeviceError, FrameSink, FrameSource, Input, Lent, Output, StreamFormat};
use crate::frame::Stamp;
use crate::image::{PixelFormat, Range, Siting};
use std::io::{self, Cursor, Write};
use std::sync::{Arc, Mutex};

fn open(bytes: impl Into<Vec<u8>>) -> Result<Y4mSource, DeviceError> {
    let bytes = bytes.into();
    let len = bytes.len() as u64;
    Y4mSource::new(Input::from_reader("test.y4m".into(), Box::new(Cursor::new(bytes)), Some(len)))
}

fn refusal(header: &str) -> String {
    open(header).unwrap_err().to_string()
}

/// Every frame's bytes, then the error if there was one.
fn drain(source: &mut Y4mSource) -> (Vec<Vec<u8>>, Option<String>) {
    let mut frames = Vec::new();
    loop {
        match source.lend() {
            Ok(Lent::Frame(frame)) => frames.push(frame.bytes.to_vec()),
            Ok(_) => return (frames, None),
            Err(error) => return (frames, Some(error.to_string())),
        }
    }
}

#[test]
fn headers_say_what_they_say() {
    let source = open("YUV4MPEG2 W5 H3 F30000:1001 Ip A4:3 C420mpeg2 XYSCSS=420MPEG2 XCOLORRANGE=FULL\n").unwrap();
    let format = source.format();
    assert_eq!((format.width, format.height, format.pixel), (5, 3, PixelFormat::I420));
    assert_eq!((format.interval, format.aspect), ((1001, 30000), (4, 3)));
    assert_eq!((format.colour.siting, format.colour.range), (Siting::Left, Range::Full));
    assert_eq!(format.frame_bytes(), Some(15 + 12));
    for (tag, pixel, siting) in [
        ("", PixelFormat::I420, Siting::Centre),
        (" C420paldv", PixelFormat::I420, Siting::TopLeft),
        (" C420jpeg", PixelFormat::I420, Siting::Centre),
        (" C422", PixelFormat::I422, Siting::Centre),
        (" C444", PixelFormat::I444, Siting::Centre),
        (" Cmono", PixelFormat::Grey, Siting::Centre),
    ] {
        let format = open(format!("YUV4MPEG2 W5 H3 F0:0{tag}\n")).unwrap().format();
        assert_eq!((format.pixel, format.colour.siting, format.interval), (pixel, siting, (1, 25)), "{tag}");
    }
}

/// As ffmpeg reads them, from what ffmpeg, mjpegtools and x264 write.
#[test]
fn chroma_is_named_by_c_or_else_by_xyscss() {
    for (tags, pixel, siting) in [
        ("XYSCSS=420JPEG", PixelFormat::I420, Siting::Centre),
        ("XYSCSS=420MPEG2", PixelFormat::I420, Siting::Left),
        ("XYSCSS=420PALDV", PixelFormat::I420, Siting::TopLeft),
        ("XYSCSS=422", PixelFormat::I422, Siting::Centre),
        ("XYSCSS=444", PixelFormat::I444, Siting::Centre),
        ("XYSCSS=411", PixelFormat::I422, Siting::Centre),
        ("C411 XYSCSS=411", PixelFormat::I422, Siting::Centre),
        ("C420", PixelFormat::I420, Siting::Centre),
        ("XYSCSS=420MPEG2 C444", PixelFormat::I444, Siting::Centre),
        ("C420paldv XYSCSS=444P10", PixelFormat::I420, Siting::TopLeft),
        ("Cmono XYSCSS=400", PixelFormat::Grey, Siting::Centre),
    ] {
        let format = open(format!("YUV4MPEG2 W5 H3 F25:1 {tags}\n")).unwrap().format();
        assert_eq!((format.pixel, format.colour.siting), (pixel, siting), "{tags}");
    }
    for (tags, named) in [
        ("XYSCSS=422P10", "its chroma is XYSCSS=422P10"),
        ("Cmono16 XYSCSS=444", "its chroma is Cmono16"),
        ("C444alpha", "its chroma is C444alpha"),
        ("C410", "its chroma is C410"),
    ] {
        let said = refusal(&format!("YUV4MPEG2 W5 H3 F25:1 {tags}\n"));
        assert!(said.contains(named) && said.contains("8-bit") && said.contains("411"), "{tags}: {said}");
    }
}

#[test]
fn a_frame_of_4_1_1_becomes_one_of_4_2_2() {
    // 6 x 2: six luma samples a row, two of U and of V
    let frame: Vec<u8> = (1..=12).chain([100, 180, 20, 20, 0, 255, 8, 4]).collect();
    let mut stream = b"YUV4MPEG2 W6 H2 F25:1 C411\n".to_vec();
    for _ in 0..2 {
        stream.extend([b"FRAME\n".to_vec(), frame.clone()].concat());
    }
    let mut source = open(stream).unwrap();
    assert_eq!((source.frames(), source.format().frame_bytes()), (Some(2), Some(24)));
    let (frames, error) = drain(&mut source);
    let chroma = [[100, 120, 160], [20, 20, 20], [0, 64, 191], [8, 7, 5]].concat();
    let expected: Vec<u8> = (1..=12).chain(chroma).collect();
    assert_eq!((frames, error), (vec![expected.clone(), expected], None));
}

#[test]
fn where_no_chroma_is_named_the_wrong_size_of_a_frame_is_put_down_to_that() {
    let frames = b"FRAME\nabcdefghijklFRAME\nabcdefghijkl";
    let (given, error) = drain(&mut open([&b"YUV4MPEG2 W2 H2 F25:1\n"[..], frames].concat()).unwrap());
    assert!(given.len() == 1 && error.unwrap().contains("has no chroma format (C), so 4:2:0 was assumed"));
    let (given, error) = drain(&mut open([&b"YUV4MPEG2 W2 H2 F25:1 C420jpeg\n"[..], frames].concat()).unwrap());
    assert!(given.len() == 1 && !error.unwrap().contains("chroma"));
}

#[test]
fn what_is_refused_is_named() {
    for (header, word) in [
        ("", "ends within its header line"),
        ("YUV4MPEG2 W5 H3", "ends within its header line"),
        ("RIFF\n", "YUV4MPEG2"),
        ("YUV4MPEG2 W5\n", "no height"),
        ("YUV4MPEG2 W0 H3\n", "1 to 8192"),
        ("YUV4MPEG2 W65500 H65500\n", "\"65500\", expected 1 to 8192"),
        ("YUV4MPEG2 W99999999999999999999 H3\n", "1 to 8192"),
        ("YUV4MPEG2 W5 H3 It\n", "interlaced"),
        ("YUV4MPEG2 W5 H3 C420p10\n", "8-bit"),
        ("YUV4MPEG2 W5 H3 C410\n", "C410"),
        ("YUV4MPEG2 W5 H3 F30\n", "30:1"),
        ("YUV4MPEG2 W5 H3 \u{fc}\n", "unknown parameter"),
    ] {
        let said = refusal(header);
        assert!(said.contains(word) && said.starts_with("test.y4m: "), "{header:?}: {said}");
    }
    assert!(refusal(&format!("YUV4MPEG2 X{}\n", "a".repeat(5000))).contains("longer than 2048"));
}

#[test]
fn frames_come_with_their_times_and_parameters_are_skipped() {
    let mut source = open(b"YUV4MPEG2 W2 H1 F30:1 Cmono\nFRAME\nabFRAME Ip XA=1\ncd".to_vec()).unwrap();
    let Ok(Lent::Frame(first)) = source.lend() else { panic!("no frame") };
    assert_eq!((first.bytes, first.stamp.time_ns, first.stamp.sequence), (&b"ab"[..], 0, 0));
    let Ok(Lent::Frame(second)) = source.lend() else { panic!("no frame") };
    assert_eq!((second.bytes, second.stamp.time_ns, second.stamp.sequence), (&b"cd"[..], 33_333_333, 1));
    assert!(matches!(source.lend(), Ok(Lent::End)));
}

#[test]
fn a_truncated_stream_gives_its_whole_frames_then_says_where_it_ends() {
    let whole = b"YUV4MPEG2 W2 H2 F30:1 Cmono\nFRAME\nabcdFRAME\nefgh".to_vec();
    for cut in 0..whole.len() {
        let Ok(mut source) = open(&whole[..cut]) else {
            assert!(cut < 28, "the header is whole");
            continue;
        };
        let (frames, error) = drain(&mut source);
        assert_eq!(frames.len(), (cut - 28) / 10, "cut at {cut}");
        assert_eq!(error.is_none(), (cut - 28) % 10 == 0, "cut at {cut}: {error:?}");
        assert!(matches!(source.lend(), Ok(Lent::End)), "ended for good");
    }
    let (_, error) = drain(&mut open(&whole[..47]).unwrap());
    let said = error.unwrap();
    assert!(said.contains("ends at byte 47 within frame 1") && said.contains("begins at byte 38"), "{said}");
    let (frames, error) = drain(&mut open(b"YUV4MPEG2 W2 H2 F30:1 Cmono\nFRAME\nabcdFLAME\nefgh".to_vec()).unwrap());
    assert_eq!(frames.len(), 1);
    assert!(error.unwrap().contains("damaged at byte 38, before frame 1"));
}

/// Shared bytes, to see what a sink wrote.
#[derive(Clone, Default)]
struct Shared(Arc<Mutex<Vec<u8>>>);

impl Write for Shared {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.lock().unwrap().write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[test]
fn what_is_written_is_read_back() {
    for pixel in [PixelFormat::I420, PixelFormat::I422, PixelFormat::I444, PixelFormat::Grey] {
        let mut format = StreamFormat::tight(5, 3, pixel, (1001, 30000));
        format.colour.range = Range::Full;
        format.colour.siting = if pixel == PixelFormat::I420 { Siting::Left } else { Siting::Centre };
        let shared = Shared::default();
        let mut sink = Y4mSink::new(Output::from_writer("out.y4m".into(), Box::new(shared.clone())), &format).unwrap();
        let mut value = 0;
        for _ in 0..3 {
            for mut plane in sink.canvas().unwrap().planes {
                for row in 0..plane.height() {
                    plane.row_mut(row).fill_with(|| {
                        value += 1;
                        value as u8
                    });
                }
            }
            sink.submit(&Stamp::default()).unwrap();
        }
        sink.finish().unwrap();
        let mut source = open(shared.0.lock().unwrap().clone()).unwrap();
        // What is drawn into a sink has the range of pictures inside, whatever the frames they are of had.
        format.colour.range = Range::Limited;
        assert_eq!((source.format(), source.frames()), (format, Some(3)), "{pixel}");
        let (frames, error) = drain(&mut source);
        let bytes: Vec<u8> = (1..=value).map(|v| v as u8).collect();
        assert_eq!((frames.concat(), error), (bytes, None), "{pixel}");
    }
}
