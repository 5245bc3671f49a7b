//! A daemon as companions see it: numbered pictures at 30 a second, while a program watches; a device that every user may open stands for
//! the camera.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicI64, AtomicU32, Ordering::Relaxed};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use gimbald::device::StreamFormat;
use gimbald::frame::Stamp;
use gimbald::image::{Picture, PixelFormat, Sampling};
use gimbald::rt::clock::monotonic_ns;
use gimbald::rt::notifier::Notifier;
use gimbald::share::{Companions, Server};

/// Numbers begin again at 0 after as many; four of them fit into the bits of luma.
pub const NUMBERS: u32 = 1 << 16;

pub struct Producer {
    pub companions: Companions,
    pub number: Arc<AtomicU32>,
    /// When each picture was sent, by its number.
    pub sent_ns: Arc<Vec<AtomicI64>>,
    /// Processor time that the frame path spent on them, nanoseconds.
    pub cpu_ns: Arc<AtomicI64>,
    over: Arc<AtomicBool>,
    done: Notifier,
    threads: Vec<JoinHandle<()>>,
}

/// The name of the producer's instance: no daemon of this machine has it. One that is to come back has it from its environment.
pub fn instance() -> String {
    std::env::var("GIMBALD_TEST_INSTANCE").unwrap_or_else(|_| format!("test{}", std::process::id()))
}

pub fn node_name() -> String {
    format!("gimbald.{}", instance())
}

/// The folder of an instance's socket in a session's runtime directory.
fn place(runtime: &Path, instance: &str) -> PathBuf {
    runtime.join(format!("gimbald-{instance}"))
}

impl Producer {
    /// The daemon of the test's one camera; its first picture has the number after `first`.
    pub fn start(runtime: &Path, size: (u32, u32), first: u32) -> Self {
        Self::named(runtime, &instance(), size, first)
    }

    /// The daemon of another instance.
    pub fn named(runtime: &Path, instance: &str, (width, height): (u32, u32), first: u32) -> Self {
        let server = Server::open(&place(runtime, instance)).unwrap();
        let companions = server.companions().clone();
        let mut outlet = companions.outlet(&StreamFormat::tight(width, height, PixelFormat::I420, (1, 30)));
        companions.camera_is(Path::new("/dev/null"));
        let (done, over) = (Notifier::new().unwrap(), Arc::new(AtomicBool::new(false)));
        let number = Arc::new(AtomicU32::new(first));
        let sent_ns: Arc<Vec<AtomicI64>> = Arc::new((0..NUMBERS).map(|_| AtomicI64::new(0)).collect());
        let notifier = done.clone();
        let serving = std::thread::spawn(move || server.serve(&notifier, &|| Some("/dev/null".into())));
        let cpu_ns = Arc::new(AtomicI64::new(0));
        let (ended, counted, times, spent) = (over.clone(), number.clone(), sent_ns.clone(), cpu_ns.clone());
        let sending = std::thread::spawn(move || {
            let mut picture = Picture::new(Sampling::S420, width as usize, height as usize);
            draw(&mut picture);
            let mut due = Instant::now();
            while !ended.load(Relaxed) {
                due += Duration::from_micros(33_333);
                std::thread::sleep(due.saturating_duration_since(Instant::now()));
                if outlet.is_wanted() {
                    let number = (counted.load(Relaxed) + 1) % NUMBERS;
                    write_number(&mut picture, number);
                    let now = monotonic_ns();
                    times[number as usize].store(now, Relaxed);
                    let before = thread_ns();
                    outlet.send(picture.as_ref(), &Stamp { time_ns: now, ..Stamp::default() });
                    spent.fetch_add(thread_ns() - before, Relaxed);
                    counted.store(number, Relaxed);
                }
            }
        });
        Self { companions, number, sent_ns, cpu_ns, over, done, threads: vec![serving, sending] }
    }

    pub fn number(&self) -> u32 {
        self.number.load(Relaxed)
    }
}

impl Drop for Producer {
    fn drop(&mut self) {
        self.over.store(true, Relaxed);
        self.done.notify();
        self.threads.drain(..).for_each(|thread| thread.join().unwrap());
    }
}

/// Processor time of this thread, nanoseconds.
fn thread_ns() -> i64 {
    let now = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    now.tv_sec * 1_000_000_000 + now.tv_nsec
}

/// Something to look at: brighter to the right in 16 steps, bluer to the right and redder downwards.
fn draw(picture: &mut Picture) {
    let ramp = |at: usize, len: usize, from: usize, to: usize| (from + at * (to - from) / len) as u8;
    for (index, mut plane) in picture.as_mut().planes.into_iter().enumerate() {
        let (width, height) = (plane.width(), plane.height());
        for y in 0..height {
            for (x, value) in plane.row_mut(y).iter_mut().enumerate() {
                *value = match index {
                    0 => ramp(x * 16 / width, 16, 40, 230),
                    1 => ramp(x, width, 64, 192),
                    _ => ramp(y, height, 64, 192),
                };
            }
        }
    }
}

/// Sixteen pixels of the first row are the number's bits.
fn write_number(picture: &mut Picture, number: u32) {
    let mut canvas = picture.as_mut();
    let row = canvas.planes[0].row_mut(0);
    for bit in 0..16 {
        row[bit] = if number >> bit & 1 == 1 { 235 } else { 16 };
    }
}

/// The number in a picture of YUYV; `None` where it has none, as the dark picture.
pub fn read_number(bytes: &[u8]) -> Option<u32> {
    (0..16).try_fold(0, |number, bit| match bytes[2 * bit] {
        235 => Some(number | 1 << bit),
        16 => Some(number),
        _ => None,
    })
}
