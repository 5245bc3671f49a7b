//! Real drivers: the kernel's test camera (vivid) and v4l2loopback. Runs where both are there, as root (`tests/vm/run` makes a
//! virtual machine that has them); elsewhere each test says that it is skipped.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Mutex, MutexGuard};
use std::time::{Duration, Instant};

use assert_no_alloc::{AllocDisabler, assert_no_alloc};
use gimbald::device::v4l2::{Capture, CaptureParams, Direction, Loopback, LoopbackParams, devices, find};
use gimbald::device::{DeviceError, FrameSink, FrameSource, Lent};
use gimbald::frame::{FrameFlags, Stamp};
use gimbald::image::{Colour, Picture, PixelFormat};
use gimbald::rt::clock::monotonic_ns;
use gimbald::rt::wake::Wake;
use gimbald::stage::unpack::Unpack;

#[global_allocator]
static ALLOCATOR: AllocDisabler = AllocDisabler;

/// There is one camera: one test at a time.
static RIG: Mutex<()> = Mutex::new(());

/// The devices of the tests.
struct Rig {
    camera: PathBuf,
    loopback: PathBuf,
    /// The loopback made with exclusive_caps.
    exclusive: PathBuf,
    _alone: MutexGuard<'static, ()>,
}

impl Rig {
    /// `None`, said aloud, where the machine has no such devices; a failure where GIMBALD_DEVICES=required says it must.
    fn find(test: &str) -> Option<Self> {
        let alone = RIG.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        let all = devices();
        let with =
            |driver: &str| all.iter().filter(|device| device.driver == driver).map(|device| device.path.clone()).collect();
        let (cameras, loopbacks): (Vec<PathBuf>, Vec<PathBuf>) = (with("vivid"), with("v4l2 loopback"));
        let camera =
            all.iter().find(|device| cameras.contains(&device.path) && device.capture).map(|device| device.path.clone());
        if let (Some(camera), [loopback, exclusive, ..]) = (camera, loopbacks.as_slice()) {
            return Some(Self { camera, loopback: loopback.clone(), exclusive: exclusive.clone(), _alone: alone });
        }
        assert!(std::env::var("GIMBALD_DEVICES").as_deref() != Ok("required"), "no vivid and two v4l2loopback here");
        // Past the test harness, which keeps what a test prints to itself unless it fails.
        let _ = writeln!(
            std::io::stderr(),
            "SKIPPED: {test}: needs the kernel modules vivid and v4l2loopback (two devices); see tests/vm/run"
        );
        None
    }

    /// Sets controls of the camera, as "name=value,name=value".
    fn control(&self, controls: &str) {
        let status = Command::new("v4l2-ctl").arg("-d").arg(&self.camera).args(["-c", controls]).status().unwrap();
        assert!(status.success(), "v4l2-ctl -c {controls}");
    }

    fn open(&self, params: CaptureParams) -> Capture {
        Capture::open(&self.params(params), Wake::new().unwrap()).unwrap()
    }

    fn params(&self, params: CaptureParams) -> CaptureParams {
        CaptureParams { device: self.camera.display().to_string(), ..params }
    }
}

fn vga(format: PixelFormat) -> CaptureParams {
    CaptureParams { format: Some(format), width: Some(640), height: Some(480), fps: Some(30.0), ..CaptureParams::default() }
}

/// The stamp and bytes of the next frame; patient with idleness.
fn next(camera: &mut Capture) -> (Stamp, Vec<u8>) {
    for _ in 0..10 {
        if let Lent::Frame(frame) = camera.lend().unwrap() {
            return (frame.stamp, frame.bytes.to_vec());
        }
    }
    panic!("no frame came");
}

/// (Y, U, V) of the pixel at (x, y) of a 640x480 frame; RGB roughly converted.
fn pixel(format: PixelFormat, bytes: &[u8], x: usize, y: usize) -> [i32; 3] {
    let at = |index: usize| i32::from(bytes[index]);
    let (w, h) = (640, 480);
    let pair = (y * w + x) / 2 * 4;
    let chroma = (y / 2) * (w / 2) + x / 2;
    let rgb = |r: usize, g: usize, b: usize| {
        let (r, g, b) = (at(r), at(g), at(b));
        let luma = (299 * r + 587 * g + 114 * b) / 1000;
        [luma, 128 + (b - luma) * 564 / 1000, 128 + (r - luma) * 713 / 1000]
    };
    match format {
        PixelFormat::Yuyv => [at(pair + 2 * (x % 2)), at(pair + 1), at(pair + 3)],
        PixelFormat::Uyvy => [at(pair + 1 + 2 * (x % 2)), at(pair), at(pair + 2)],
        PixelFormat::Nv12 => [at(y * w + x), at(w * h + 2 * chroma), at(w * h + 2 * chroma + 1)],
        PixelFormat::I420 => [at(y * w + x), at(w * h + chroma), at(w * h * 5 / 4 + chroma)],
        PixelFormat::Grey => [at(y * w + x), 128, 128],
        PixelFormat::Rgb24 => rgb(3 * (y * w + x), 3 * (y * w + x) + 1, 3 * (y * w + x) + 2),
        PixelFormat::Bgr24 => rgb(3 * (y * w + x) + 2, 3 * (y * w + x) + 1, 3 * (y * w + x)),
        other => panic!("no such frames here: {other}"),
    }
}

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
    let error = Capture::open(&rig.params(asked), Wake::new().unwrap()).unwrap_err().to_string();
    assert!(error.contains("641") && error.contains("YUYV 640x480"), "{error}");
    let error = Capture::open(
        &rig.params(CaptureParams { format: Some(PixelFormat::Mjpeg), ..vga(PixelFormat::Mjpeg) }),
        Wake::new().unwrap(),
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
    assert!(Capture::open(&rig.params(vga(PixelFormat::Yuyv)), Wake::new().unwrap()).is_err());
    std::fs::write(driver.join("bind"), "vivid.0").unwrap();
    let deadline = Instant::now() + Duration::from_secs(20);
    while find("vivid", Direction::Capture).is_err() && Instant::now() < deadline {
        std::thread::sleep(Duration::from_millis(100));
    }
    let by_name = CaptureParams { device: "vivid".into(), ..vga(PixelFormat::Yuyv) };
    next(&mut Capture::open(&by_name, Wake::new().unwrap()).unwrap());
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
    let refused = Capture::open(&rig.params(vga(PixelFormat::Yuyv)), Wake::new().unwrap()).unwrap_err();
    assert!(refused.to_string().contains("start the stream"), "{refused}");
    next(&mut rig.open(vga(PixelFormat::Yuyv)));
}

#[test]
fn a_ring_interrupts_the_wait_for_a_frame() {
    let Some(rig) = Rig::find("a_ring_interrupts_the_wait_for_a_frame") else { return };
    let wake = Wake::new().unwrap();
    let slow = rig.params(CaptureParams { fps: Some(1.0), ..vga(PixelFormat::Grey) });
    let mut camera = Capture::open(&slow, wake.clone()).unwrap();
    next(&mut camera);
    let ringer = std::thread::spawn(move || {
        std::thread::sleep(Duration::from_millis(150));
        let when = Instant::now();
        wake.ring();
        when
    });
    assert!(matches!(camera.lend().unwrap(), Lent::Idle), "the ring came before the frame");
    let late = ringer.join().unwrap().elapsed();
    assert!(late < Duration::from_millis(100), "{late:?}");
    println!("woke up {late:?} after the ring");
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
    let error = Capture::open(&rig.params(vga(PixelFormat::Yuyv)), Wake::new().unwrap()).unwrap_err();
    assert!(matches!(error, DeviceError::Busy { .. }), "{error}");
    drop(camera);
    next(&mut rig.open(vga(PixelFormat::Yuyv)));
    let error = Capture::open(
        &CaptureParams { device: rig.loopback.display().to_string(), ..vga(PixelFormat::Yuyv) },
        Wake::new().unwrap(),
    );
    assert!(error.is_err(), "a loopback without a writer is no camera");
}

fn output(device: &Path, pixel: PixelFormat, width: u32, height: u32) -> LoopbackParams {
    let colour = Colour::default();
    LoopbackParams {
        device: device.display().to_string(),
        pixel,
        width,
        height,
        interval: (1, 30),
        colour,
        buffers: 4,
        create: false,
    }
}

/// Draws frame `number`: luma rises to the right, U downwards, V is the number.
fn draw(sink: &mut Loopback, number: u8) {
    let mut canvas = sink.canvas().unwrap();
    for y in 0..canvas.height() {
        for (x, sample) in canvas.planes[0].row_mut(y).iter_mut().enumerate() {
            *sample = (x / 3 + y / 5) as u8;
        }
    }
    for y in 0..canvas.planes[1].height() {
        canvas.planes[1].row_mut(y).fill((y & 255) as u8);
        canvas.planes[2].row_mut(y).fill(number);
    }
}

/// (Y, U, V) of pixel (x, y) of a frame of `w` x `h`.
fn sample(format: PixelFormat, bytes: &[u8], (w, h): (usize, usize), x: usize, y: usize) -> [u8; 3] {
    let pair = (y * w + x) / 2 * 4;
    match format {
        PixelFormat::Yuyv => [bytes[pair + 2 * (x % 2)], bytes[pair + 1], bytes[pair + 3]],
        PixelFormat::Nv12 => {
            let chroma = w * h + y / 2 * w + x / 2 * 2;
            [bytes[y * w + x], bytes[chroma], bytes[chroma + 1]]
        }
        _ => {
            let chroma = w * h + y / 2 * (w / 2) + x / 2;
            [bytes[y * w + x], bytes[chroma], bytes[chroma + w * h / 4]]
        }
    }
}

/// The number of the frame that [`draw`] drew into `bytes`; `None` where two frames are mixed (v4l2loopback has two buffers, and
/// a reader that is late sees one being drawn anew). Every sample is compared.
fn read_back(format: PixelFormat, bytes: &[u8], w: usize, h: usize) -> Option<u8> {
    assert_eq!(bytes.len(), if format == PixelFormat::Yuyv { w * h * 2 } else { w * h * 3 / 2 });
    let number = sample(format, bytes, (w, h), 0, 0)[2];
    let mut whole = true;
    for y in 0..h {
        for x in 0..w {
            let [luma, u, v] = sample(format, bytes, (w, h), x, y);
            assert_eq!([luma, u], [(x / 3 + y / 5) as u8, ((y / 2) & 255) as u8], "{format} at ({x}, {y})");
            whole &= v == number;
        }
    }
    whole.then_some(number)
}

/// Sends a frame each 60 ms (slow enough for a reader on a busy machine) until `child` ends; its standard output.
fn feed(sink: &mut Loopback, child: std::process::Child) -> Vec<u8> {
    let reader = std::thread::spawn(move || child.wait_with_output().unwrap());
    let deadline = Instant::now() + Duration::from_secs(60);
    let mut number = 0u8;
    while !reader.is_finished() {
        assert!(Instant::now() < deadline, "the reader does not end");
        number = number.wrapping_add(1);
        draw(sink, number);
        sink.submit(&Stamp { time_ns: monotonic_ns(), ..Stamp::default() }).unwrap();
        std::thread::sleep(Duration::from_millis(60));
    }
    let output = reader.join().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    output.stdout
}

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
        let mut camera = Capture::open(&params, Wake::new().unwrap()).unwrap();
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
fn a_format_that_a_watcher_holds_is_explained() {
    let Some(rig) = Rig::find("a_format_that_a_watcher_holds_is_explained") else { return };
    let mut sink = Loopback::open(&output(&rig.loopback, PixelFormat::Yuyv, 640, 480)).unwrap();
    draw(&mut sink, 1);
    sink.submit(&Stamp { time_ns: monotonic_ns(), ..Stamp::default() }).unwrap();
    let params = CaptureParams { device: rig.loopback.display().to_string(), ..CaptureParams::default() };
    let mut watcher = Capture::open(&params, Wake::new().unwrap()).unwrap();
    next(&mut watcher);
    drop(sink);
    match Loopback::open(&output(&rig.loopback, PixelFormat::Yuyv, 320, 240)) {
        Err(error) => {
            println!("{error}");
            assert!(matches!(error, DeviceError::Unsupported { .. } | DeviceError::Busy { .. }), "{error}");
        }
        // Old modules let the format go.
        Ok(sink) => println!("this v4l2loopback allows it: {:?}", sink.format()),
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
fn a_camera_is_no_loopback() {
    let Some(rig) = Rig::find("a_camera_is_no_loopback") else { return };
    let error = Loopback::open(&output(&rig.camera, PixelFormat::Yuyv, 640, 480)).unwrap_err().to_string();
    assert!(error.contains("vivid") && error.contains("modprobe v4l2loopback"), "{error}");
}

#[test]
fn a_camera_that_gives_jpeg_is_read() {
    let Some(rig) = Rig::find("a_camera_that_gives_jpeg_is_read") else { return };
    // ffmpeg as a camera that gives JPEG: red, for a start.
    let mut ffmpeg = Command::new("ffmpeg")
        .args([
            "-loglevel",
            "error",
            "-re",
            "-f",
            "lavfi",
            "-i",
            "color=red:size=640x480:rate=30",
            "-c:v",
            "mjpeg",
            "-f",
            "v4l2",
        ])
        .arg(&rig.loopback)
        .spawn()
        .unwrap();
    let params = CaptureParams { device: rig.loopback.display().to_string(), ..CaptureParams::default() };
    let deadline = Instant::now() + Duration::from_secs(30);
    let mut camera = loop {
        match Capture::open(&params, Wake::new().unwrap()) {
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
        unpack.unpack(PixelFormat::Mjpeg, (640, 480), 0, &bytes, &mut picture).unwrap();
        let [y, u, v] = picture.as_ref().planes.map(|plane| i32::from(plane.at(100, 100)));
        assert!((y - 76).abs() < 12 && (u - 85).abs() < 12 && v > 225, "red: {y} {u} {v}");
    }
    drop(camera);
    ffmpeg.kill().unwrap();
    ffmpeg.wait().unwrap();
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
                unpack.unpack(format.pixel, (640, 480), format.stride, frame.bytes, &mut picture).is_ok()
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
