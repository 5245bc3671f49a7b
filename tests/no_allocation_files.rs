//! Sources, unpacking and sinks of files take no memory per frame once they are warm.

use assert_no_alloc::{AllocDisabler, assert_no_alloc};
use gimbald::device::digest::DigestSink;
use gimbald::device::null::NullSink;
use gimbald::device::recording::{RecordingSink, RecordingSource};
use gimbald::device::synthetic::{Params, Synthetic};
use gimbald::device::y4m::{Y4mSink, Y4mSource};
use gimbald::device::{FrameSink, FrameSource, Input, Lent, Output};
use gimbald::image::{Picture, PixelFormat, Range};
use gimbald::stage::unpack::Unpack;
use std::io::{Cursor, Seek, SeekFrom, Write};
use std::path::Path;
use std::sync::{Arc, Mutex};

#[global_allocator]
static ALLOCATOR: AllocDisabler = AllocDisabler;

/// Carries every frame from `source` to `sink`; after the second, whatever takes or gives memory ends the test.
fn carry(source: &mut dyn FrameSource, sink: &mut dyn FrameSink) -> u64 {
    let (mut unpack, mut picture) = (Unpack::new(), Picture::default());
    let mut count = 0;
    let mut step = || match source.lend() {
        Ok(Lent::Frame(frame)) => {
            let (format, stamp) = (frame.format, frame.stamp);
            unpack
                .unpack(
                    format.pixel,
                    format.colour.range,
                    (format.width, format.height),
                    format.stride,
                    frame.bytes,
                    &mut picture,
                )
                .is_ok()
                && sink.canvas().is_ok_and(|canvas| {
                    canvas.planes.into_iter().zip(picture.as_ref().planes).for_each(|(mut to, from)| to.copy_from(from));
                    true
                })
                && sink.submit(&stamp).is_ok()
        }
        _ => false,
    };
    while if count < 2 { step() } else { assert_no_alloc(&mut step) } {
        count += 1;
    }
    count
}

/// Bytes in memory that are there before they are written.
#[derive(Clone)]
struct Room(Arc<Mutex<Cursor<Vec<u8>>>>);

impl Room {
    fn new() -> Self {
        Self(Arc::new(Mutex::new(Cursor::new(vec![0; 4 << 20]))))
    }

    fn output(&self) -> Output {
        Output::from_writer("test".into(), Box::new(self.clone()))
    }

    fn input(&self) -> Input {
        let mut written = self.0.lock().unwrap();
        let len = written.seek(SeekFrom::Current(0)).unwrap() as usize;
        Input::from_reader("test".into(), Box::new(Cursor::new(written.get_ref()[..len].to_vec())), Some(len as u64))
    }
}

impl Write for Room {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0.lock().unwrap().write(bytes)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

#[test]
fn frames_of_files_take_no_memory() {
    let params = Params { width: 320, height: 240, frames: 8, ..Params::default() };
    let mut camera = Synthetic::new(&params).unwrap();
    let (y4m, recorded) = (Room::new(), Room::new());
    let mut sink = Y4mSink::new(y4m.output(), &camera.format()).unwrap();
    assert_eq!(carry(&mut camera, &mut sink), 8);
    sink.finish().unwrap();

    let mut source = Y4mSource::new(y4m.input()).unwrap();
    let mut sink = RecordingSink::new(recorded.output(), &source.format()).unwrap();
    assert_eq!(carry(&mut source, &mut sink), 8);
    sink.finish().unwrap();

    let mut source = RecordingSource::new(recorded.input()).unwrap();
    let mut sink = DigestSink::new(&source.format());
    assert_eq!(carry(&mut source, &mut sink), 8);

    // Real pictures of different lengths: after the longest, none is taken. (What libjpeg-turbo takes itself is not seen here.)
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/car-mjpeg-400x300.gbr");
    let mut source = RecordingSource::open(&path).unwrap();
    let mut sink = NullSink::new(&source.format());
    assert_eq!(carry(&mut source, &mut sink), 24);
}

/// A webcam's JPEG: restart markers with a pad byte before each, no Huffman tables needed, ever longer.
fn padded_jpeg(n: u8) -> Vec<u8> {
    let samples: Vec<u8> = (0..160 * 120 * 3).map(|i: usize| ((i / 9 * 97) ^ (i / 1440 * 57)) as u8 / 2).collect();
    let mut jpeg = Vec::new();
    let mut encoder = jpeg_encoder::Encoder::new(&mut jpeg, 30 + 5 * n);
    encoder.set_sampling_factor(jpeg_encoder::SamplingFactor::F_2_1);
    encoder.set_restart_interval(10);
    encoder.encode(&samples, 160, 120, jpeg_encoder::ColorType::Rgb).unwrap();
    let mut padded = Vec::new();
    for pair in jpeg.windows(2) {
        if pair[0] == 0xff && (0xd0..=0xd7).contains(&pair[1]) {
            padded.extend_from_slice(&[0xff, 0]);
        }
        padded.push(pair[0]);
    }
    [&padded[..], &jpeg[jpeg.len() - 1..]].concat()
}

/// Neither does what many webcams send take memory: bytes that the decoder would complain of in every frame.
#[test]
fn padded_jpegs_take_no_memory() {
    let frames: Vec<_> = (0..12).map(padded_jpeg).collect();
    assert!(frames.windows(2).all(|pair| pair[0].len() < pair[1].len()), "they grow");
    let (mut unpack, mut picture) = (Unpack::new(), Picture::default());
    for (n, jpeg) in frames.iter().enumerate() {
        let mut step = || unpack.unpack(PixelFormat::Mjpeg, Range::Full, (160, 120), 0, jpeg, &mut picture).is_ok();
        assert!(if n < 2 { step() } else { assert_no_alloc(step) }, "frame {n}");
    }
}
