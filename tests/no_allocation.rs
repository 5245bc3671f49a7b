//! The frame path takes no memory once it is warm: neither on one thread nor on two, whatever the model.
//!
//! A frame's journey is watched from when its source is asked for the next frame: both threads count what they take themselves.

mod common;

use common::{Shot, film, in_time};
use gimbald::control::Metrics;
use gimbald::device::digest::DigestSink;
use gimbald::device::synthetic::{self, Motion};
use gimbald::device::{DeviceError, FrameSink, FrameSource, Lent, RawFrame, StreamFormat};
use gimbald::frame::{Frame, Stamp};
use gimbald::image::{Picture, PictureMut, PictureRef, PixelFormat, Sampling};
use gimbald::pipeline::{Live, Observer, Pace, Params, run_inline, run_live, run_threaded};
use gimbald::rt::notifier::Notifier;
use gimbald::rt::stop::Stop;
use gimbald::share::{Client, Companions, Heard, Inspector, Pair, Server};
use gimbald::stage::shutter::{self, Model, Parameters};
use rustix::fs::{MemfdFlags, SealFlags, fcntl_add_seals, ftruncate, memfd_create};
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::os::fd::AsFd;
use std::sync::Arc;
use std::thread;
use std::time::Duration;

/// Counts what each thread takes, gives nothing away.
struct Counting;

thread_local! {
    static TAKEN: Cell<u64> = const { Cell::new(0) };
}

fn count() {
    // A thread that ends has no counter any more.
    let _ = TAKEN.try_with(|taken| taken.set(taken.get() + 1));
}

fn taken() -> u64 {
    TAKEN.with(Cell::get)
}

// SAFETY: every call is handed on to the system's allocator as it came.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count();
        // SAFETY: the caller's promise.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        count();
        // SAFETY: the caller's promise.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn realloc(&self, block: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        count();
        // SAFETY: the caller's promise.
        unsafe { System.realloc(block, layout, size) }
    }

    unsafe fn dealloc(&self, block: *mut u8, layout: Layout) {
        count();
        // SAFETY: the caller's promise.
        unsafe { System.dealloc(block, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

const FRAMES: usize = 90;
/// Frames after which nothing may be taken: every frame of the pool has been filled and every stage has seen trouble.
const WARM: usize = 45;

/// Frames that may be under way when the source ends.
const LAST: usize = 5;

/// Gives frames, and notes what its thread had taken by then.
struct Watching {
    shots: Vec<Shot>,
    next: usize,
    live: bool,
    taken: [u64; FRAMES],
}

impl FrameSource for Watching {
    fn format(&self) -> StreamFormat {
        self.shots[0].format
    }

    fn lend(&mut self) -> Result<Lent<'_>, DeviceError> {
        let Some(Shot { format, bytes, stamp }) = self.shots.get(self.next) else { return Ok(Lent::End) };
        // live as a camera; else late for once, so that the other thread waits: a thread's first wait takes memory
        if self.live || (10..14).contains(&self.next) {
            thread::sleep(Duration::from_millis(6));
        }
        self.taken[self.next] = taken();
        self.next += 1;
        Ok(Lent::Frame(RawFrame { format: *format, bytes, stamp: *stamp }))
    }
}

/// Takes pictures, and notes what its thread had taken by then.
struct WatchingSink {
    inner: DigestSink,
    taken: [u64; FRAMES],
}

impl FrameSink for WatchingSink {
    fn format(&self) -> StreamFormat {
        self.inner.format()
    }

    fn canvas(&mut self) -> Result<PictureMut<'_>, DeviceError> {
        self.inner.canvas()
    }

    fn submit(&mut self, stamp: &Stamp) -> Result<(), DeviceError> {
        if (20..26).contains(&stamp.sequence) {
            // late for once, so that the capture thread waits
            thread::sleep(Duration::from_millis(30));
        }
        self.taken[self.inner.submitted() as usize] = taken();
        self.inner.submit(stamp)
    }
}

/// Looks at frames as a trace would, counts them as a daemon would, and switches stabilization off and on all the time.
struct Looking {
    seen: u64,
    live: Arc<Live>,
    metrics: Metrics,
}

impl Observer for Looking {
    fn drawn(&mut self, frame: &Frame, output: PictureRef<'_>) {
        self.seen += frame.context.tracks.len() as u64 + output.width() as u64;
        if frame.stamp.sequence.is_multiple_of(4) {
            let params = self.live.params();
            self.live.set(&Params { enabled: !params.enabled, ..params });
        }
    }

    fn sent(&mut self, frame: &Frame) {
        self.metrics.sent(frame);
    }
}

/// A stream in which everything happens before it is warm, and again after.
fn shots() -> Vec<Shot> {
    let params = synthetic::Params {
        width: 160,
        height: 120,
        frames: FRAMES as u64,
        motion: Motion::Walk,
        ..synthetic::Params::default()
    };
    let mut shots = film(&params);
    for start in [5, WARM + 5] {
        for n in [start, start + 1, start + 20] {
            shots[n] = shots[n].clone().damaged();
        }
        shots[start + 5] = shots[start + 4].clone();
        let flat = Shot::noise(shots[0].format.pixel, [160, 120], 90, 0, 1);
        shots[start + 10].bytes.copy_from_slice(&flat.bytes);
        let noise = Shot::noise(shots[0].format.pixel, [160, 120], 90, 200, 1);
        shots[start + 15].bytes.copy_from_slice(&noise.bytes);
    }
    in_time(&mut shots, 30.0);
    shots
}

#[test]
fn no_frame_takes_memory_once_it_is_warm() {
    let shots = shots();
    let models =
        [(Model::Cho2007, Parameters::TimeT), (Model::Cho2007, Parameters::TimeT1), (Model::Continuous, Parameters::TimeT)];
    for (model, parameters) in models {
        for pace in [None, Some(Pace::Lossless), Some(Pace::Live)] {
            let params = Params { shutter: shutter::Params { model, parameters }, ..Params::default() };
            let mut source = Watching { shots: shots.clone(), next: 0, live: pace == Some(Pace::Live), taken: [0; FRAMES] };
            let mut sink = WatchingSink { inner: DigestSink::new(&source.format()), taken: [0; FRAMES] };
            let (stop, mut looking) =
                (Stop::default(), Looking { seen: 0, live: Arc::new(Live::new(&params)), metrics: Metrics::default() });
            let totals = match pace {
                None => run_inline(&mut source, &mut sink, &params, &stop, &mut looking),
                Some(Pace::Live) => {
                    let live = looking.live.clone();
                    run_live(&mut source, &mut sink, &params, &live, &stop, &mut looking)
                }
                Some(pace) => run_threaded(&mut source, &mut sink, &params, &stop, &mut looking, pace),
            }
            .unwrap();
            assert_eq!(totals.frames_in, FRAMES as u64);
            assert!(looking.seen > 0);
            let what = format!("{model:?} {parameters:?} {pace:?}");
            assert!(sink.taken[0] > 0, "{what}: nothing is counted");
            let steps = |taken: &[u64]| taken.windows(2).position(|pair| pair[0] != pair[1]);
            assert_eq!(steps(&source.taken[WARM..]), None, "{what}: a frame captured after frame {WARM} took or gave memory");
            // the last frames are sent when the source has ended and the pool is taken down
            let sent = totals.frames_out as usize - LAST;
            // live, fewer are sent: those after the first half of them
            let warm = if pace == Some(Pace::Live) { sent / 2 } else { WARM };
            assert!(sent > warm + 10, "{what}: too few frames were sent: {totals:?}");
            assert_eq!(steps(&sink.taken[warm..sent]), None, "{what}: a frame drawn after frame {warm} took or gave memory");
        }
    }
}

/// A server for companions in a thread, in a folder of its own.
struct Pictures {
    folder: std::path::PathBuf,
    path: std::path::PathBuf,
    companions: Companions,
    done: Notifier,
    thread: Option<thread::JoinHandle<()>>,
}

impl Pictures {
    fn serve(name: &str) -> Self {
        let folder = std::env::temp_dir().join(format!("gimbald-no-allocation-{}-{name}", std::process::id()));
        let server = Server::open(&folder).unwrap();
        let (companions, path, done) = (server.companions().clone(), server.path().to_path_buf(), Notifier::new().unwrap());
        companions.camera_is(std::path::Path::new(CAMERA));
        let notifier = done.clone();
        let thread = Some(thread::spawn(move || server.serve(&notifier, &|| None)));
        Self { folder, path, companions, done, thread }
    }
}

impl Drop for Pictures {
    fn drop(&mut self) {
        self.done.notify();
        self.thread.take().unwrap().join().unwrap();
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}

/// A device that every user may open stands for the camera.
const CAMERA: &str = "/dev/null";
const SIZE: (u32, u32) = (64, 48);

fn camera() -> std::fs::File {
    std::fs::OpenOptions::new().read(true).write(true).open(CAMERA).unwrap()
}

/// Has `show` show frames until `client` got 200 of them; the most memory that one of them took, but for the first 20, which meet a
/// companion that has just connected.
fn most_taken(client: &Client, mut show: impl FnMut()) -> u64 {
    let (mut received, mut most, begun) = (0, 0, std::time::Instant::now());
    while received < 200 {
        assert!(begun.elapsed() < Duration::from_secs(30), "{received} pictures came");
        let before = taken();
        show();
        let took = taken() - before;
        while let Ok(Some(said)) = client.receive() {
            if let Heard::Frame { id, .. } = said {
                received += 1;
                client.free(id).unwrap();
            }
        }
        if received > 20 {
            most = most.max(took);
        }
        thread::sleep(Duration::from_micros(500));
    }
    most
}

/// The path of a picture to a companion: drawn into lent memory, announced over the socket.
#[test]
fn a_picture_for_a_companion_takes_no_memory() {
    let pictures = Pictures::serve("companion");
    let mut outlet = pictures.companions.outlet(&StreamFormat::tight(SIZE.0, SIZE.1, PixelFormat::I420, (1, 30)));
    let client = Client::connect(&pictures.path).unwrap();
    client.watch(true, SIZE, Some(camera().as_fd())).unwrap();
    for id in 0..4 {
        let fd = memfd_create(c"test", MemfdFlags::CLOEXEC | MemfdFlags::ALLOW_SEALING).unwrap();
        ftruncate(&fd, 2 * u64::from(SIZE.0 * SIZE.1)).unwrap();
        fcntl_add_seals(&fd, SealFlags::SHRINK).unwrap();
        client.lend(id, fd.as_fd()).unwrap();
        client.free(id).unwrap();
    }
    let picture = Picture::new(Sampling::S420, 64, 48);
    assert_eq!(most_taken(&client, || outlet.send(picture.as_ref(), &Stamp::default())), 0, "memory for a picture");
}

/// The path of a frame to a page of `gimbald view`, while none is open, while one is, and after it was closed.
#[test]
fn a_frame_for_a_page_takes_no_memory() {
    let pictures = Pictures::serve("page");
    let format = StreamFormat::tight(SIZE.0, SIZE.1, PixelFormat::I420, (1, 30));
    let _outlet = pictures.companions.outlet(&format);
    let mut inspector = pictures.companions.inspector(&format);
    let output = Picture::new(Sampling::S420, 64, 48);
    let frame = Frame { picture: Picture::new(Sampling::S422, 64, 48), ..Frame::default() };
    let closed = |inspector: &mut Inspector| {
        let before = taken();
        (0..100).for_each(|_| inspector.show(&frame, output.as_ref()));
        taken() - before
    };
    assert_eq!(closed(&mut inspector), 0, "memory while no page is open");
    let client = Client::connect(&pictures.path).unwrap();
    client.watch_both(SIZE, Some(camera().as_fd())).unwrap();
    let (pair, memory) = Pair::new(SIZE.0, SIZE.1).unwrap();
    client.lend(1, memory.as_fd()).unwrap();
    client.free(1).unwrap();
    assert_eq!(most_taken(&client, || inspector.show(&frame, output.as_ref())), 0, "memory while a page is open");
    assert!(pair.frames().last().unwrap().number >= 199, "200 frames came");
    drop(client);
    let begun = std::time::Instant::now();
    while pictures.companions.connected() > 0 {
        assert!(begun.elapsed() < Duration::from_secs(30), "the page is still connected");
        thread::sleep(Duration::from_millis(1));
    }
    assert_eq!(closed(&mut inspector), 0, "memory after the page was closed");
}
