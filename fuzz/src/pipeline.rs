//! The whole pipeline over a few small frames: any settings, sizes, formats, times, pictures and damage.

use crate::stream::mended;
use gimbald::config::Settings;
use gimbald::device::null::NullSink;
use gimbald::device::recording::RecordingSource;
use gimbald::device::{FrameSource, Input};
use gimbald::image::PixelFormat;
use gimbald::pipeline::run_inline;
use gimbald::rt::stop::Stop;
use libfuzzer_sys::arbitrary::{Result, Unstructured};
use std::io::Cursor;

/// What may be set, each or not.
const SETS: &[&[&str]] = &[
    &["shutter.model=cho2007", "shutter.parameters=time-t+1"],
    &["smooth.lookahead_ms=200", "smooth.lookahead_ms=33"],
    &["smooth.mode=iir", "smooth.strength=0", "smooth.cutoff_hz=10"],
    &["crop.border=mirror", "crop.border=black"],
    &["crop.zoom=auto", "crop.zoom=1", "crop.zoom=2"],
    &["fit.form=general", "fit.threshold_px=0.2"],
    &["warp.filter=bilinear", "warp.filter=bicubic"],
    &["camera.readout_ms=-100", "camera.readout_ms=25", "camera.readout_ms=0"],
    &["camera.hfov_deg=170", "camera.hfov_deg=10", "camera.hfov_deg=60"],
    &["camera.lens_k1=-0.35", "camera.lens_k1=0.35", "camera.lens_k1=0"],
    &["track.window=24", "track.window=16"],
    &["track.points=400"],
    &["stabilize.enabled=false"],
];

/// What is set first: little work for each frame, so that many inputs are tried.
const LIGHT: [&str; 2] = ["track.points=50", "track.window=8"];
const MAX_FRAMES: usize = 8;

/// A stream that is made up of the input.
pub fn pipeline(data: &[u8]) {
    let mut bytes = Unstructured::new(data);
    let (Ok(settings), Ok(stream)) = (settings(&mut bytes), stream(&mut bytes)) else { return };
    let stream = mended(&stream);
    let len = stream.len() as u64;
    let input = Input::from_reader("input".into(), Box::new(Cursor::new(stream)), Some(len));
    let Ok(mut source) = RecordingSource::new(input) else { return };
    let mut sink = NullSink::new(&source.format());
    if let Ok(totals) = run_inline(&mut source, &mut sink, &settings.pipeline, &Stop::default(), &mut ()) {
        assert_eq!(totals.frames_in, totals.frames_out, "{totals:?}");
        assert_eq!(totals.stabilized + totals.held + totals.passed_through, totals.frames_out, "{totals:?}");
    }
}

fn settings(bytes: &mut Unstructured<'_>) -> Result<Settings> {
    let mut settings = Settings::default();
    let mut set = |assignment: &str| settings.set(assignment).unwrap_or_else(|faults| panic!("{faults}"));
    LIGHT.into_iter().for_each(&mut set);
    for choices in SETS {
        if bytes.ratio(1, 4)? {
            set(bytes.choose(choices)?);
        }
    }
    Ok(settings)
}

/// What a recording is of from here on.
#[derive(Clone, Copy)]
struct Format {
    pixel: PixelFormat,
    width: u32,
    height: u32,
    stride: usize,
}

impl Format {
    fn any(bytes: &mut Unstructured<'_>) -> Result<Self> {
        let pixel = *bytes.choose(&PixelFormat::ALL)?;
        // Large pictures are rare: each costs as much as a hundred small ones.
        let most = if bytes.ratio(1, 64)? { [320, 240] } else { [64, 48] };
        let (width, height) = (bytes.int_in_range(1..=most[0])?, bytes.int_in_range(1..=most[1])?);
        Ok(Self { pixel, width, height, stride: pixel.tight_stride(width) })
    }

    fn record(self, bytes: &mut Unstructured<'_>, stream: &mut Vec<u8>) -> Result<()> {
        let mut payload = self.pixel.fourcc().to_vec();
        let interval =
            if bytes.ratio(1, 8)? { [bytes.arbitrary()?, bytes.arbitrary()?] } else { [1, *bytes.choose(&[30, 15, 60])?] };
        for number in [self.width, self.height, self.stride as u32, interval[0], interval[1], 1, 1] {
            payload.extend(number.to_le_bytes());
        }
        payload.extend([bytes.int_in_range(0..=2)?, bytes.int_in_range(0..=2)?, 0, 0]);
        record(b"FORM", (0, 0, 0), &payload, stream);
        Ok(())
    }
}

/// Appends a record; its checksums are still to be mended.
fn record(kind: &[u8; 4], (time, sequence, flags): (i64, u64, u32), payload: &[u8], stream: &mut Vec<u8>) {
    stream.extend(kind);
    stream.extend((payload.len() as u32).to_le_bytes());
    stream.extend(time.to_le_bytes());
    stream.extend(sequence.to_le_bytes());
    stream.extend(flags.to_le_bytes());
    stream.extend([0; 8]);
    stream.extend(payload);
}

fn stream(bytes: &mut Unstructured<'_>) -> Result<Vec<u8>> {
    let mut stream = vec![0; 16];
    let mut format = Format::any(bytes)?;
    format.record(bytes, &mut stream)?;
    let (mut time, mut sequence, mut at) = (0i64, 0u64, [0i32; 2]);
    for n in 0..MAX_FRAMES {
        if bytes.is_empty() {
            break;
        }
        if bytes.ratio(1, 12)? {
            format = Format::any(bytes)?;
            format.record(bytes, &mut stream)?;
        }
        time = match bytes.int_in_range(0..=15)? {
            0 => bytes.arbitrary()?,
            1 => time,
            2 => time.wrapping_sub(40_000_000),
            3 => time.wrapping_add(bytes.int_in_range(0..=2_000_000_000)?),
            _ => time.wrapping_add(33_333_333),
        };
        sequence = if bytes.ratio(1, 16)? { bytes.arbitrary()? } else { sequence.wrapping_add(1) };
        for place in &mut at {
            *place += bytes.int_in_range(-6..=6)?;
        }
        let mut frame = picture(format, at, n as u32, bytes.int_in_range(0..=9)?);
        if bytes.ratio(1, 16)? {
            frame.truncate(bytes.int_in_range(0..=frame.len())?);
        }
        let flags = if bytes.ratio(1, 16)? { bytes.arbitrary()? } else { 0 };
        record(b"FRAM", (time, sequence, flags), &frame, &mut stream);
    }
    Ok(stream)
}

/// A frame's bytes: blocks of grey that have moved to `at`, or a kind without anything to follow.
fn picture(format: Format, at: [i32; 2], n: u32, kind: u32) -> Vec<u8> {
    let len = format.pixel.frame_bytes(format.height, format.stride).unwrap_or(0);
    let hash = |x: u32, y: u32| (x.wrapping_mul(73_856_093) ^ y.wrapping_mul(19_349_663)).wrapping_mul(2_654_435_761) >> 24;
    let sample = |i: usize| {
        let (x, y) = ((i % format.stride) as i32 + at[0], (i / format.stride) as i32 + at[1]);
        match kind {
            0 => 0,
            1 => 255,
            2 => hash(i as u32, n) as u8,
            _ => 40 + (hash((x >> 3) as u32, (y >> 3) as u32) / 2) as u8,
        }
    };
    (0..len).map(sample).collect()
}
