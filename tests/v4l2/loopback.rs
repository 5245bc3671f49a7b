//! The loopback: what other programs read, who holds what, who watches, hand-over.

use std::process::Command;
use std::time::{Duration, Instant};

use assert_no_alloc::assert_no_alloc;
use gimbald::device::v4l2::{Capture, CaptureParams, Loopback, Viewers, devices};
use gimbald::device::{DeviceError, FrameSink, FrameSource, Lent};
use gimbald::frame::Stamp;
use gimbald::image::{Picture, PixelFormat};
use gimbald::rt::clock::monotonic_ns;
use gimbald::rt::notifier::Notifier;
use gimbald::stage::unpack::Unpack;

use crate::rig::{Rig, draw, feed, next, output, read_back, vga};

#[test]
fn other_programs_read_what_is_drawn() {
    let Some(rig) = Rig::find("other_programs_read_what_is_drawn") else { return };
    use std::process::Stdio;
    for format in [PixelFormat::Yuyv, PixelFormat::I420, PixelFormat::Nv12] {
        for (device, w, h) in [(&rig.loopback, 640, 480), (&rig.exclusive, 1280, 720), (&rig.loopback, 322, 180)] {
            let mut sink = Loopback::open(&output(device, format, w, h)).unwrap();
            let path = std::env::temp_dir().join("gimbald-v4l2-test.raw");
            let child = Command::new("v4l2-ctl")
                .arg("-d")
                .arg(device)
                .args(["--stream-mmap", "--stream-count=5", "--stream-to"])
                .arg(&path)
                .stdout(Stdio::null())
                .stderr(Stdio::piped())
                .spawn()
                .unwrap();
            feed(&mut sink, child);
            let bytes = std::fs::read(&path).unwrap();
            std::fs::remove_file(&path).unwrap();
            let whole = sink.format().frame_bytes().unwrap();
            assert_eq!(bytes.len(), 5 * whole, "{format} {w}x{h}");
            // The first may be an old one.
            let numbers: Vec<_> =
                bytes.chunks_exact(whole).skip(1).map(|frame| read_back(format, frame, w as usize, h as usize)).collect();
            println!(
                "{format} {w}x{h} on {}: v4l2-ctl read frames {numbers:?}, {:?} sent and dropped",
                device.display(),
                sink.counts()
            );
            let child = Command::new("ffmpeg")
                .args(["-loglevel", "error", "-f", "v4l2", "-i"])
                .arg(device)
                .args(["-frames:v", "8", "-f", "rawvideo", "-"])
                .stdout(Stdio::piped())
                .stderr(Stdio::piped())
                .stdin(Stdio::null())
                .spawn()
                .unwrap();
            let bytes = feed(&mut sink, child);
            let numbers: Vec<_> =
                bytes.chunks_exact(whole).skip(1).map(|frame| read_back(format, frame, w as usize, h as usize)).collect();
            assert!(numbers.iter().any(Option::is_some), "every frame is torn");
            println!("    ffmpeg read frames {numbers:?}");
        }
    }
}

#[test]
fn our_own_capture_reads_the_loopback_with_its_times() {
    let Some(rig) = Rig::find("our_own_capture_reads_the_loopback_with_its_times") else { return };
    for format in [PixelFormat::Yuyv, PixelFormat::I420, PixelFormat::Nv12] {
        let mut sink = Loopback::open(&output(&rig.exclusive, format, 640, 480)).unwrap();
        let params = CaptureParams { device: rig.exclusive.display().to_string(), ..CaptureParams::default() };
        let mut camera = Capture::open(&params, Notifier::new().unwrap()).unwrap();
        assert_eq!((camera.format().pixel, camera.format().width), (format, 640));
        for number in 1..20 {
            draw(&mut sink, number);
            // A time of the past, in whole microseconds, as V4L2 carries it.
            let sent = (monotonic_ns() - 40_000_000) / 1000 * 1000;
            sink.submit(&Stamp { time_ns: sent, ..Stamp::default() }).unwrap();
            let (stamp, bytes) = next(&mut camera);
            assert_eq!(read_back(format, &bytes, 640, 480), Some(number));
            assert_eq!(stamp.time_ns, sent, "the time goes through unchanged");
        }
        println!("{format}: {:?}; {:?} sent and dropped", camera.counts(), sink.counts());
    }
}

#[test]
fn an_exclusive_node_is_a_camera_while_it_is_written_to() {
    let Some(rig) = Rig::find("an_exclusive_node_is_a_camera_while_it_is_written_to") else { return };
    let seen = || devices().into_iter().find(|device| device.path == rig.exclusive).map(|device| device.capture).unwrap();
    assert!(!seen());
    let sink = Loopback::open(&output(&rig.exclusive, PixelFormat::Yuyv, 640, 480)).unwrap();
    assert!(seen(), "even before the first frame");
    let second = Loopback::open(&output(&rig.exclusive, PixelFormat::Yuyv, 640, 480)).unwrap_err();
    assert!(matches!(second, DeviceError::Busy { .. }), "{second}");
    drop(sink);
    assert!(!seen(), "and gives it back");
}

#[test]
fn the_node_is_usable_after_each_end() {
    let Some(rig) = Rig::find("the_node_is_usable_after_each_end") else { return };
    for (number, format) in [(1, PixelFormat::Yuyv), (2, PixelFormat::I420), (3, PixelFormat::Nv12), (4, PixelFormat::Yuyv)] {
        let (w, h) = (320 + 2 * number, 240);
        let mut sink = Loopback::open(&output(&rig.loopback, format, w, h)).unwrap();
        // Without a reader nothing is held back, and nobody waits.
        let before = Instant::now();
        for _ in 0..100 {
            draw(&mut sink, 7);
            sink.submit(&Stamp { time_ns: monotonic_ns(), ..Stamp::default() }).unwrap();
        }
        assert_eq!(sink.counts(), (100, 0));
        assert!(before.elapsed() < Duration::from_secs(10));
        sink.finish().unwrap();
    }
}

#[test]
fn a_format_that_a_watcher_holds_is_taken_or_explained() {
    let Some(rig) = Rig::find("a_format_that_a_watcher_holds_is_taken_or_explained") else { return };
    let mut sink = Loopback::open(&output(&rig.loopback, PixelFormat::Yuyv, 640, 480)).unwrap();
    draw(&mut sink, 1);
    sink.submit(&Stamp { time_ns: monotonic_ns(), ..Stamp::default() }).unwrap();
    let params = CaptureParams { device: rig.loopback.display().to_string(), ..CaptureParams::default() };
    let mut watcher = Capture::open(&params, Notifier::new().unwrap()).unwrap();
    next(&mut watcher);
    drop(sink);
    match Loopback::open(&output(&rig.loopback, PixelFormat::Yuyv, 320, 240)) {
        Err(error) => {
            println!("{error}");
            assert!(matches!(error, DeviceError::Unsupported { .. } | DeviceError::Busy { .. }), "{error}");
        }
        // What the watcher holds is taken, and told; old modules let it go.
        Ok(sink) => {
            let format = sink.format();
            assert!([(640, 480), (320, 240)].contains(&(format.width, format.height)), "{format:?}");
            println!("asked for 320x240, it is {}x{}", format.width, format.height);
        }
    }
    // The writer comes back with the same format: the watcher goes on.
    let mut sink = Loopback::open(&output(&rig.loopback, PixelFormat::Yuyv, 640, 480)).unwrap();
    for number in 50..60 {
        draw(&mut sink, number);
        sink.submit(&Stamp { time_ns: monotonic_ns(), ..Stamp::default() }).unwrap();
        assert_eq!(read_back(PixelFormat::Yuyv, &next(&mut watcher).1, 640, 480), Some(number));
    }
}

#[test]
fn who_watches_is_told() {
    let Some(rig) = Rig::find("who_watches_is_told") else { return };
    let mut sink = Loopback::open(&output(&rig.exclusive, PixelFormat::Yuyv, 640, 480)).unwrap();
    let (mut viewers, notifier) = (Viewers::of(&rig.exclusive).unwrap(), Notifier::new().unwrap());
    println!("the module tells by itself: {}", viewers.are_told());
    let mut settled = |watched: bool| {
        let deadline = Instant::now() + Duration::from_secs(20);
        let told = viewers.are_told();
        let mut seen = || {
            let count = viewers.wait(&notifier, Some(Duration::from_millis(300))).unwrap();
            assert!(!told || count <= 1, "{count} readers where there is one");
            count > 0
        };
        while seen() != watched {
            assert!(Instant::now() < deadline, "it does not become {watched}");
        }
        // And stays so.
        seen() == watched
    };
    assert!(settled(false));
    draw(&mut sink, 1);
    sink.submit(&Stamp { time_ns: monotonic_ns(), ..Stamp::default() }).unwrap();
    let params = CaptureParams { device: rig.exclusive.display().to_string(), ..CaptureParams::default() };
    let watcher = Capture::open(&params, Notifier::new().unwrap()).unwrap();
    assert!(settled(true));
    drop(watcher);
    assert!(settled(false));
    notifier.notify();
    let before = Instant::now();
    viewers.wait(&notifier, Some(Duration::from_secs(60))).unwrap();
    assert!(before.elapsed() < Duration::from_secs(30), "a notification ends the wait");
}

#[test]
fn a_reader_keeps_its_camera_when_the_writer_hands_over() {
    let Some(rig) = Rig::find("a_reader_keeps_its_camera_when_the_writer_hands_over") else { return };
    let open = || Loopback::open(&output(&rig.exclusive, PixelFormat::Yuyv, 640, 480)).unwrap();
    let mut sink = open();
    draw(&mut sink, 1);
    sink.submit(&Stamp { time_ns: monotonic_ns(), ..Stamp::default() }).unwrap();
    let params = CaptureParams { device: rig.exclusive.display().to_string(), ..CaptureParams::default() };
    let mut watcher = Capture::open(&params, Notifier::new().unwrap()).unwrap();
    next(&mut watcher);
    sink.hand_over();
    drop(sink);
    let seen = || devices().into_iter().find(|device| device.path == rig.exclusive).map(|device| device.capture).unwrap();
    assert!(seen(), "it stays a camera");
    let mut sink = open();
    for number in 50..55 {
        draw(&mut sink, number);
        sink.submit(&Stamp { time_ns: monotonic_ns(), ..Stamp::default() }).unwrap();
        assert_eq!(read_back(PixelFormat::Yuyv, &next(&mut watcher).1, 640, 480), Some(number));
    }
    drop((watcher, sink));
    assert!(!seen(), "and is given back at the real end");
    // A format that was left locked by one that was killed does not lock out the next.
    let mut sink = open();
    sink.hand_over();
    drop(sink);
    let sink = Loopback::open(&output(&rig.exclusive, PixelFormat::Nv12, 320, 240)).unwrap();
    assert_eq!((sink.format().width, sink.format().pixel), (320, PixelFormat::Nv12));
}

#[test]
fn times_only_go_up_for_readers() {
    let Some(rig) = Rig::find("times_only_go_up_for_readers") else { return };
    let mut sink = Loopback::open(&output(&rig.exclusive, PixelFormat::Yuyv, 640, 480)).unwrap();
    let params = CaptureParams { device: rig.exclusive.display().to_string(), ..CaptureParams::default() };
    let mut watcher = Capture::open(&params, Notifier::new().unwrap()).unwrap();
    let mut last = 0;
    let now = monotonic_ns() / 1000 * 1000;
    for (number, time_ns) in [now, now - 50_000_000, now + 1_000_000, now, 0].into_iter().enumerate() {
        draw(&mut sink, number as u8);
        sink.submit(&Stamp { time_ns, ..Stamp::default() }).unwrap();
        let taken = next(&mut watcher).0.time_ns;
        assert!(taken > last, "{taken} after {last}");
        last = taken;
    }
}

#[test]
fn a_camera_is_no_loopback() {
    let Some(rig) = Rig::find("a_camera_is_no_loopback") else { return };
    let error = Loopback::open(&output(&rig.camera, PixelFormat::Yuyv, 640, 480)).unwrap_err().to_string();
    assert!(error.contains("vivid") && error.contains("modprobe v4l2loopback"), "{error}");
}

#[test]
fn no_frame_takes_memory_between_the_devices() {
    let Some(rig) = Rig::find("no_frame_takes_memory_between_the_devices") else { return };
    for format in [PixelFormat::Yuyv, PixelFormat::I420] {
        let mut camera = rig.open(vga(format));
        let mut sink = Loopback::open(&output(&rig.loopback, format, 640, 480)).unwrap();
        let (mut unpack, mut picture) = (Unpack::new(), Picture::default());
        let mut step = || match camera.lend() {
            Ok(Lent::Frame(frame)) => {
                let (format, stamp) = (frame.format, frame.stamp);
                unpack.unpack(format.pixel, format.colour.range, (640, 480), format.stride, frame.bytes, &mut picture).is_ok()
                    && sink.canvas().is_ok_and(|canvas| {
                        canvas.planes.into_iter().zip(picture.as_ref().planes).for_each(|(mut to, from)| to.copy_from(from));
                        true
                    })
                    && sink.submit(&stamp).is_ok()
            }
            Ok(Lent::Idle) => true,
            _ => false,
        };
        assert!((0..2).all(|_| step()));
        // Taking or giving memory ends the test.
        assert!((0..60).all(|_| assert_no_alloc(&mut step)));
        assert!(sink.counts().0 > 50, "{:?}", sink.counts());
    }
}
