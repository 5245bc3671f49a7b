//! The devices of the tests, and what several of them do with these.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Mutex, MutexGuard};
use std::time::{Duration, Instant};

use gimbald::device::v4l2::{Capture, CaptureParams, Loopback, LoopbackParams, devices};
use gimbald::device::{FrameSink, FrameSource, Lent};
use gimbald::frame::Stamp;
use gimbald::image::{Colour, PixelFormat};
use gimbald::rt::clock::monotonic_ns;
use gimbald::rt::notifier::Notifier;

/// There is one camera: one test at a time.
static RIG: Mutex<()> = Mutex::new(());

/// The devices of the tests.
pub struct Rig {
    pub camera: PathBuf,
    pub loopback: PathBuf,
    /// The loopback made with exclusive_caps.
    pub exclusive: PathBuf,
    _alone: MutexGuard<'static, ()>,
}

impl Rig {
    /// `None`, said aloud, where the machine has no such devices; a failure where GIMBALD_DEVICES=required says it must.
    pub fn find(test: &str) -> Option<Self> {
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
    pub fn control(&self, controls: &str) {
        let status = Command::new("v4l2-ctl").arg("-d").arg(&self.camera).args(["-c", controls]).status().unwrap();
        assert!(status.success(), "v4l2-ctl -c {controls}");
    }

    pub fn open(&self, params: CaptureParams) -> Capture {
        Capture::open(&self.params(params), Notifier::new().unwrap()).unwrap()
    }

    pub fn params(&self, params: CaptureParams) -> CaptureParams {
        CaptureParams { device: self.camera.display().to_string(), ..params }
    }
}

pub fn vga(format: PixelFormat) -> CaptureParams {
    CaptureParams { format: Some(format), width: Some(640), height: Some(480), fps: Some(30.0), ..CaptureParams::default() }
}

/// The stamp and bytes of the next frame; patient with idleness.
pub fn next(camera: &mut Capture) -> (Stamp, Vec<u8>) {
    for _ in 0..10 {
        if let Lent::Frame(frame) = camera.lend().unwrap() {
            return (frame.stamp, frame.bytes.to_vec());
        }
    }
    panic!("no frame came");
}

/// (Y, U, V) of the pixel at (x, y) of a 640x480 frame; RGB roughly converted.
pub fn pixel(format: PixelFormat, bytes: &[u8], x: usize, y: usize) -> [i32; 3] {
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

pub fn output(device: &Path, pixel: PixelFormat, width: u32, height: u32) -> LoopbackParams {
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
pub fn draw(sink: &mut Loopback, number: u8) {
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
pub fn sample(format: PixelFormat, bytes: &[u8], (w, h): (usize, usize), x: usize, y: usize) -> [u8; 3] {
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
pub fn read_back(format: PixelFormat, bytes: &[u8], w: usize, h: usize) -> Option<u8> {
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
pub fn feed(sink: &mut Loopback, child: std::process::Child) -> Vec<u8> {
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
