//! The recorded streams in `fixtures/`: that they are what their README says, and how they were made.

use gimbald::device::digest::DigestSink;
use gimbald::device::recording::RecordingWriter;
use gimbald::device::{FrameSink, Lent, RawFrame, StreamFormat, replay};
use gimbald::frame::{FrameFlags, Stamp};
use gimbald::image::{Colour, PixelFormat, Range, Siting};
use gimbald::stage::unpack::Unpack;
use std::error::Error;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

const CAR: &str = "car-mjpeg-400x300.gbr";
const FACE: &str = "face-yuyv-400x300.gbr";

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures").join(name)
}

/// Unpacks every frame and says what came of it all, and the time of the last.
fn digest(name: &str) -> Result<(StreamFormat, String, i64), Box<dyn Error>> {
    let mut source = replay::open(&fixture(name))?;
    let format = source.format();
    let (expected, mut last) = (source.frames(), 0);
    let mut sink = DigestSink::new(&format);
    let (mut unpack, mut picture) = (Unpack::new(), format.picture());
    while let Lent::Frame(RawFrame { format, bytes, stamp }) = source.lend()? {
        unpack.unpack(format.pixel, format.colour.range, (format.width, format.height), format.stride, bytes, &mut picture)?;
        assert_eq!(picture.sampling(), format.sampling());
        for (mut to, from) in sink.canvas()?.planes.into_iter().zip(picture.as_ref().planes) {
            to.copy_from(from);
        }
        sink.submit(&stamp)?;
        last = stamp.time_ns;
    }
    assert_eq!(Some(sink.submitted()), expected);
    Ok((format, sink.text(), last))
}

/// Golden: whatever changes these numbers changes the pictures that everything else starts from.
#[test]
fn fixtures_give_the_pictures_they_always_gave() -> Result<(), Box<dyn Error>> {
    let (format, text, last) = digest(CAR)?;
    assert_eq!((format.pixel, format.interval, format.colour.range), (PixelFormat::Mjpeg, (1001, 30000), Range::Full));
    assert_eq!((text.as_str(), last), ("24 frames 400x300 14a0af450452c098", 766_193_000));
    let (format, text, last) = digest(FACE)?;
    assert_eq!((format.pixel, format.interval, format.stride), (PixelFormat::Yuyv, (1, 25), 800));
    assert_eq!((text.as_str(), last), ("6 frames 400x300 50f7ea8c03acd468", 200_000_000));
    Ok(())
}

/// Runs ffmpeg; its words are in the error.
fn ffmpeg(arguments: &[&str]) -> Result<(), Box<dyn Error>> {
    let out = Command::new("ffmpeg").args(["-v", "error", "-y"]).args(arguments).output()?;
    if out.status.success() { Ok(()) } else { Err(String::from_utf8_lossy(&out.stderr).into()) }
}

/// Makes the fixtures anew from the clips in the directory `GIMBALD_CLIPS`:
/// `GIMBALD_CLIPS=DIR cargo test --test fixtures -- --ignored`.
#[test]
#[ignore = "writes fixtures/; needs ffmpeg and the clips"]
fn make() -> Result<(), Box<dyn Error>> {
    let clips = PathBuf::from(std::env::var("GIMBALD_CLIPS").map_err(|_| "set GIMBALD_CLIPS to the directory of the clips")?);
    let clip = |name: &str| clips.join(name).display().to_string();
    let work = std::env::temp_dir().join(format!("gimbald-fixtures-{}", std::process::id()));
    fs::create_dir_all(&work)?;

    let jpegs = work.join("%02d.jpg").display().to_string();
    let input = clip("a04_car_phone_gyro.mp4");
    ffmpeg(&["-i", &input, "-vf", "scale=400:300", "-frames:v", "24", "-pix_fmt", "yuvj422p", "-q:v", "4", &jpegs])?;
    let mut format = StreamFormat::tight(400, 300, PixelFormat::Mjpeg, (1001, 30000));
    format.colour = Colour { range: Range::Full, siting: Siting::Centre };
    let mut writer = RecordingWriter::create(&fixture(CAR), &format, "a04_car_phone_gyro")?;
    let times = fs::read_to_string(clip("a04_car_phone_gyro.frames.csv"))?;
    for (n, line) in times.lines().skip(1).take(24).enumerate() {
        let seconds: f64 = line.split(',').nth(1).ok_or("frames.csv has no second column")?.parse()?;
        let bytes = fs::read(work.join(format!("{:02}.jpg", n + 1)))?;
        let stamp = Stamp { time_ns: (seconds * 1e9).round() as i64, sequence: n as u64, flags: FrameFlags::default() };
        writer.write_raw(&RawFrame { format, bytes: &bytes, stamp })?;
    }
    writer.finish()?;

    let raw = work.join("face.yuyv").display().to_string();
    let input = clip("a05_webcam_static_face.mp4");
    ffmpeg(&["-i", &input, "-frames:v", "6", "-pix_fmt", "yuyv422", "-f", "rawvideo", &raw])?;
    let format = StreamFormat::tight(400, 300, PixelFormat::Yuyv, (1, 25));
    let mut writer = RecordingWriter::create(&fixture(FACE), &format, "a05_webcam_static_face")?;
    for (n, bytes) in fs::read(&raw)?.chunks_exact(800 * 300).enumerate() {
        let stamp = Stamp { time_ns: format.nominal_time_ns(n as u64), sequence: n as u64, flags: FrameFlags::default() };
        writer.write_raw(&RawFrame { format, bytes, stamp })?;
    }
    writer.finish()?;
    fs::remove_dir_all(&work)?;
    Ok(())
}
