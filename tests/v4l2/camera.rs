//! The camera: formats, losses, damage, failures, odd clocks, JPEG.

use std::path::Path;
use std::process::{Child, Command};
use std::time::{Duration, Instant};

use gimbald::device::v4l2::{Capture, CaptureParams, Direction, find};
use gimbald::device::{DeviceError, FrameSource, Lent};
use gimbald::frame::FrameFlags;
use gimbald::image::{Picture, PixelFormat, Range};
use gimbald::rt::clock::monotonic_ns;
use gimbald::rt::notifier::Notifier;
use gimbald::stage::unpack::Unpack;

use crate::rig::{Rig, next, pixel, vga};

#[test]
fn every_format_is_captured() {
    let Some(rig) = Rig::find("every_format_is_captured") else { return };
    use PixelFormat::{Bgr24, Grey, I420, Nv12, Rgb24, Uyvy, Yuyv};
    for (format, bytes) in [
        (Yuyv, 614_400),
        (Uyvy, 614_400),
        (Nv12, 460_800),
        (I420, 460_800),
        (Grey, 307_200),
        (Rgb24, 921_600),
        (Bgr24, 921_600),
    ] {
        let mut camera = rig.open(vga(format));
        let said = camera.format();
        assert_eq!((said.pixel, said.width, said.height), (format, 640, 480));
        assert!((said.rate() - 30.0).abs() < 0.1, "{said:?}");
        let mut stamps = Vec::new();
        for _ in 0..30 {
            let (stamp, frame) = next(&mut camera);
            assert_eq!(frame.len(), bytes, "{format}");
            assert_eq!(stamp.flags, FrameFlags::default(), "{format}");
            assert!(monotonic_ns().abs_diff(stamp.time_ns) < 1_000_000_000, "{format}: {stamp:?}");
            stamps.push(stamp);
            // Eight colour bars: white, yellow, cyan, green, magenta, red, blue, black, ever darker.
            let bars: Vec<_> = (0..8).map(|bar| pixel(format, &frame, 40 + 80 * bar, 400)).collect();
            assert!(bars.windows(2).all(|two| two[0][0] > two[1][0] + 5), "{format}: {bars:?}");
            if format != Grey {
                assert!(bars[6][1] > 180 && bars[5][2] > 180 && bars[1][1] < 80, "{format}: blue, red, yellow: {bars:?}");
            }
        }
        for two in stamps.windows(2) {
            assert!(two[1].time_ns > two[0].time_ns && two[1].sequence > two[0].sequence, "{format}: {two:?}");
        }
        let frames = stamps[29].sequence - stamps[0].sequence;
        let mean_ms = (stamps[29].time_ns - stamps[0].time_ns) as f64 / 1e6 / frames as f64;
        assert!((30.0..37.0).contains(&mean_ms), "{format}: {mean_ms} ms from frame to frame");
        println!("{format}: 30 frames, {mean_ms:.2} ms apart, {:?}", camera.counts());
    }
}

#[test]
fn by_itself_it_chooses_720p_at_30() {
    let Some(rig) = Rig::find("by_itself_it_chooses_720p_at_30") else { return };
    let mut camera = rig.open(CaptureParams::default());
    let format = camera.format();
    assert_eq!((format.width, format.height, format.rate().round() as u32), (1280, 720, 30), "{format:?}");
    assert_eq!(next(&mut camera).1.len(), format.frame_bytes().unwrap());
    drop(camera);
    let asked = CaptureParams { width: Some(641), ..CaptureParams::default() };
    let error = Capture::open(&rig.params(asked), Notifier::new().unwrap()).unwrap_err().to_string();
    assert!(error.contains("641") && error.contains("YUYV 640x480"), "{error}");
    let error = Capture::open(
        &rig.params(CaptureParams { format: Some(PixelFormat::Mjpeg), ..vga(PixelFormat::Mjpeg) }),
        Notifier::new().unwrap(),
    );
    assert!(matches!(error, Err(DeviceError::Unsupported { .. })), "vivid has no MJPG: {error:?}");
}

#[test]
fn frames_that_the_driver_lost_show_as_gaps() {
    let Some(rig) = Rig::find("frames_that_the_driver_lost_show_as_gaps") else { return };
    rig.control("percentage_of_dropped_buffers=30");
    let mut camera = rig.open(vga(PixelFormat::Grey));
    let first = next(&mut camera).0.sequence;
    let last = (0..60).map(|_| next(&mut camera).0.sequence).last().unwrap();
    rig.control("percentage_of_dropped_buffers=0");
    let counts = camera.counts();
    println!("{counts:?}");
    assert!(counts.missing > 5, "{counts:?}");
    assert_eq!(last - first, 60 + counts.missing + counts.dropped, "every gap is accounted for");
}

#[test]
fn damaged_frames_are_flagged() {
    let Some(rig) = Rig::find("damaged_frames_are_flagged") else { return };
    let mut camera = rig.open(vga(PixelFormat::Yuyv));
    next(&mut camera);
    rig.control("inject_v4l2_buf_flag_error=1");
    let flags: Vec<_> = (0..15).map(|_| next(&mut camera).0.flags).collect();
    assert_eq!(flags.iter().filter(|flags| flags.contains(FrameFlags::ERROR)).count(), 1, "{flags:?}");
    assert_eq!(camera.counts().damaged, 1);
}

/// The error that ends a stream of which some frames may still come.
fn end(camera: &mut Capture) -> DeviceError {
    for _ in 0..200 {
        if let Err(error) = camera.lend() {
            return error;
        }
    }
    panic!("the stream does not end");
}

#[test]
fn an_unplugged_camera_is_gone_and_comes_back() {
    let Some(rig) = Rig::find("an_unplugged_camera_is_gone_and_comes_back") else { return };
    let mut camera = rig.open(vga(PixelFormat::Yuyv));
    next(&mut camera);
    rig.control("disconnect=1");
    let before = Instant::now();
    let error = end(&mut camera);
    assert!(matches!(error, DeviceError::Gone { .. }), "{error}");
    assert!(before.elapsed() < Duration::from_millis(500));
    assert!(matches!(end(&mut camera), DeviceError::Gone { .. }), "and stays so");
    drop(camera);
    let mut camera = rig.open(vga(PixelFormat::Yuyv));
    next(&mut camera);
    // The node itself goes, and comes back, found by name.
    let driver = Path::new("/sys/bus/platform/drivers/vivid");
    std::fs::write(driver.join("unbind"), "vivid.0").unwrap();
    assert!(matches!(end(&mut camera), DeviceError::Gone { .. }));
    drop(camera);
    assert!(Capture::open(&rig.params(vga(PixelFormat::Yuyv)), Notifier::new().unwrap()).is_err());
    std::fs::write(driver.join("bind"), "vivid.0").unwrap();
    let deadline = Instant::now() + Duration::from_secs(20);
    while find("vivid", Direction::Capture).is_err() && Instant::now() < deadline {
        std::thread::sleep(Duration::from_millis(100));
    }
    let by_name = CaptureParams { device: "vivid".into(), ..vga(PixelFormat::Yuyv) };
    next(&mut Capture::open(&by_name, Notifier::new().unwrap()).unwrap());
}

#[test]
fn a_stream_that_failed_is_started_anew() {
    let Some(rig) = Rig::find("a_stream_that_failed_is_started_anew") else { return };
    let mut camera = rig.open(vga(PixelFormat::Yuyv));
    let before = next(&mut camera).0.sequence;
    rig.control("inject_fatal_streaming_error=1");
    let stamps: Vec<_> = (0..10).map(|_| next(&mut camera).0).collect();
    assert_eq!(camera.counts().restarts, 1);
    assert!(stamps[0].sequence > before && stamps.windows(2).all(|two| two[1].sequence > two[0].sequence), "{stamps:?}");
    // A buffer that the driver refuses once, and a start that it refuses once.
    rig.control("inject_vidioc_qbuf_error=1");
    (0..5).for_each(|_| drop(next(&mut camera)));
    assert_eq!(camera.counts().restarts, 2);
    drop(camera);
    rig.control("inject_vidioc_streamon_error=1");
    let refused = Capture::open(&rig.params(vga(PixelFormat::Yuyv)), Notifier::new().unwrap()).unwrap_err();
    assert!(refused.to_string().contains("start the stream"), "{refused}");
    next(&mut rig.open(vga(PixelFormat::Yuyv)));
}

#[test]
fn a_ring_interrupts_the_wait_for_a_frame() {
    let Some(rig) = Rig::find("a_ring_interrupts_the_wait_for_a_frame") else { return };
    let wake = Notifier::new().unwrap();
    let slow = rig.params(CaptureParams { fps: Some(1.0), ..vga(PixelFormat::Grey) });
    let mut camera = Capture::open(&slow, wake.clone()).unwrap();
    next(&mut camera);
    let ringer = std::thread::spawn(move || {
        std::thread::sleep(Duration::from_millis(150));
        let when = Instant::now();
        wake.notify();
        when
    });
    assert!(matches!(camera.lend().unwrap(), Lent::Idle), "the notification came before the frame");
    let late = ringer.join().unwrap().elapsed();
    assert!(late < Duration::from_millis(100), "{late:?}");
    println!("woke up {late:?} after the notification");
    next(&mut camera);
}

#[test]
fn a_slow_reader_gets_the_newest_frame() {
    let Some(rig) = Rig::find("a_slow_reader_gets_the_newest_frame") else { return };
    let mut camera = rig.open(vga(PixelFormat::Grey));
    next(&mut camera);
    for _ in 0..5 {
        std::thread::sleep(Duration::from_millis(250));
        let age_ms = (monotonic_ns() - next(&mut camera).0.time_ns) as f64 / 1e6;
        println!("age {age_ms:.1} ms");
        // Of the buffers one was ours: the driver filled the others and then had none.
        assert!(age_ms < 200.0, "{age_ms}");
    }
    assert!(camera.counts().dropped >= 5, "{:?}", camera.counts());
}

#[test]
fn odd_counts_and_clocks_are_made_straight() {
    let Some(rig) = Rig::find("odd_counts_and_clocks_are_made_straight") else { return };
    rig.control("wrap_sequence_number=1,wrap_timestamp=1");
    let mut camera = rig.open(CaptureParams { fps: Some(60.0), ..vga(PixelFormat::Grey) });
    let stamps: Vec<_> = (0..200).map(|_| next(&mut camera).0).collect();
    rig.control("wrap_sequence_number=0,wrap_timestamp=0");
    assert!(stamps[0].sequence < 1 << 32 && stamps[199].sequence >= 1 << 32, "{:?} {:?}", stamps[0], stamps[199]);
    assert!(stamps.windows(2).all(|two| two[1].sequence > two[0].sequence && two[1].time_ns > two[0].time_ns));
    assert!(stamps[199].time_ns.abs_diff(monotonic_ns()) < 1_000_000_000);
    let counts = camera.counts();
    assert_eq!(counts.foreign_times, counts.frames + counts.dropped, "{counts:?}");
}

#[test]
fn a_camera_in_use_is_busy() {
    let Some(rig) = Rig::find("a_camera_in_use_is_busy") else { return };
    let camera = rig.open(vga(PixelFormat::Yuyv));
    let error = Capture::open(&rig.params(vga(PixelFormat::Yuyv)), Notifier::new().unwrap()).unwrap_err();
    assert!(matches!(error, DeviceError::Busy { .. }), "{error}");
    drop(camera);
    next(&mut rig.open(vga(PixelFormat::Yuyv)));
    let error = Capture::open(
        &CaptureParams { device: rig.loopback.display().to_string(), ..vga(PixelFormat::Yuyv) },
        Notifier::new().unwrap(),
    );
    assert!(error.is_err(), "a loopback without a writer is no camera");
}

/// A program that does not outlive its test, however that ends.
struct Ended(Child);

impl Drop for Ended {
    fn drop(&mut self) {
        let _ = self.0.kill().and_then(|()| self.0.wait());
    }
}

#[test]
fn a_camera_that_gives_jpeg_is_read() {
    let Some(rig) = Rig::find("a_camera_that_gives_jpeg_is_read") else { return };
    // ffmpeg as a camera that gives JPEG: red, for a start.
    let source = ["-loglevel", "error", "-re", "-f", "lavfi", "-i", "color=red:size=640x480:rate=30"];
    let _ffmpeg =
        Ended(Command::new("ffmpeg").args(source).args(["-c:v", "mjpeg", "-f", "v4l2"]).arg(&rig.loopback).spawn().unwrap());
    // Whoever opens the device before holds its format against ffmpeg.
    let node = rig.loopback.file_name().unwrap().to_str().unwrap();
    let format = Path::new("/sys/devices/virtual/video4linux").join(node).join("format");
    let deadline = Instant::now() + Duration::from_secs(60);
    while !std::fs::read_to_string(&format).is_ok_and(|format| format.starts_with("MJPG")) {
        assert!(Instant::now() < deadline, "ffmpeg does not begin");
        std::thread::sleep(Duration::from_millis(100));
    }
    let params = CaptureParams { device: rig.loopback.display().to_string(), ..CaptureParams::default() };
    let mut camera = loop {
        match Capture::open(&params, Notifier::new().unwrap()) {
            Ok(camera) if camera.format().pixel == PixelFormat::Mjpeg => break camera,
            other => assert!(Instant::now() < deadline, "{other:?}"),
        }
        std::thread::sleep(Duration::from_millis(200));
    };
    let (mut unpack, mut picture) = (Unpack::new(), Picture::default());
    for _ in 0..10 {
        let (stamp, bytes) = next(&mut camera);
        assert_eq!(stamp.flags, FrameFlags::default());
        assert!(bytes.len() < 100_000 && bytes.starts_with(&[0xff, 0xd8]), "cut to what was filled: {}", bytes.len());
        unpack.unpack(PixelFormat::Mjpeg, Range::Full, (640, 480), 0, &bytes, &mut picture).unwrap();
        let [y, u, v] = picture.as_ref().planes.map(|plane| i32::from(plane.at(100, 100)));
        assert!((y - 81).abs() < 8 && (u - 90).abs() < 8 && (v - 240).abs() < 8, "red: {y} {u} {v}");
    }
}
