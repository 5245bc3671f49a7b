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
use gimbald::image::{PictureMut, PictureRef};
use gimbald::pipeline::{Live, Observer, Pace, Params, run_inline, run_live, run_threaded};
use gimbald::rt::stop::Stop;
use gimbald::stage::shutter::{self, Model, Parameters};
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
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

/// The path of a picture to a companion: drawn into lent memory, told over the socket.
#[test]
fn a_picture_for_a_companion_takes_no_memory() {
    use gimbald::image::{Picture, PixelFormat, Sampling};
    use gimbald::rt::notifier::Notifier;
    use gimbald::share::{Client, Heard, Server};
    use rustix::fs::{MemfdFlags, SealFlags, fcntl_add_seals, ftruncate, memfd_create};
    use std::os::fd::AsFd;

    let folder = std::env::temp_dir().join(format!("gimbald-no-allocation-{}", std::process::id()));
    let server = Server::open(&folder).unwrap();
    let companions = server.companions().clone();
    let mut outlet = companions.outlet(&StreamFormat::tight(64, 48, PixelFormat::I420, (1, 30)));
    companions.camera_is(std::path::Path::new("/dev/null"));
    let (done, notifier) = (Notifier::new().unwrap(), Notifier::new().unwrap());
    let (ringing, path) = (done.clone(), server.path().to_path_buf());
    companions.tell(&notifier);
    let serving = thread::spawn(move || server.serve(&ringing, &|| None));
    let client = Client::connect(&path).unwrap();
    let camera = std::fs::OpenOptions::new().read(true).write(true).open("/dev/null").unwrap();
    client.watch(true, (64, 48), Some(camera.as_fd())).unwrap();
    for id in 0..4 {
        let fd = memfd_create(c"test", MemfdFlags::CLOEXEC | MemfdFlags::ALLOW_SEALING).unwrap();
        ftruncate(&fd, 2 * 64 * 48).unwrap();
        fcntl_add_seals(&fd, SealFlags::SHRINK).unwrap();
        client.lend(id, fd.as_fd()).unwrap();
        client.free(id).unwrap();
    }
    let picture = Picture::new(Sampling::S420, 64, 48);
    let (mut sent, mut most, begun) = (0, 0, std::time::Instant::now());
    while sent < 200 {
        assert!(begun.elapsed() < Duration::from_secs(30), "{sent} pictures came");
        let before = taken();
        outlet.send(picture.as_ref(), &Stamp::default());
        let took = taken() - before;
        while let Ok(Some(said)) = client.hear() {
            if let Heard::Frame { id, .. } = said {
                sent += 1;
                client.free(id).unwrap();
            }
        }
        // The first ones meet a companion that just came.
        if sent > 20 {
            most = most.max(took);
        }
        thread::sleep(Duration::from_micros(500));
    }
    assert_eq!(most, 0, "a picture took memory {most} times");
    done.notify();
    serving.join().unwrap();
    let _ = std::fs::remove_dir_all(&folder);
}
