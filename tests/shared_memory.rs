//! A driver's buffers are memory that other processes can write, also while a frame in them is being read.

use gimbald::device::null::NullSink;
use gimbald::device::{DeviceError, FrameSource, Lent, RawFrame, StreamFormat};
use gimbald::frame::{FrameFlags, Stamp};
use gimbald::image::PixelFormat;
use gimbald::pipeline::{Params, run_inline};
use gimbald::rt::stop::Stop;
use rustix::fs::{MemfdFlags, ftruncate, memfd_create};
use rustix::mm::{MapFlags, ProtFlags, mmap, munmap};
use std::os::fd::OwnedFd;
use std::ptr::null_mut;
use std::sync::atomic::{AtomicU8, Ordering};
use std::thread;

const WIDTH: usize = 64;
const HEIGHT: usize = 48;
/// What the other process has the header say meanwhile: a picture that needs 300 times the memory.
const HUGE: usize = 1088;
const FRAMES: u64 = 4_000;

/// Memory as two processes have it: each with a mapping of its own.
struct Mapping {
    start: *mut u8,
    length: usize,
}

// SAFETY: a mapping belongs to no thread; how each is used is said where it is.
unsafe impl Send for Mapping {}

impl Mapping {
    fn new(fd: &OwnedFd, length: usize) -> Self {
        // SAFETY: a new mapping at an address of the kernel's choice.
        let start = unsafe { mmap(null_mut(), length, ProtFlags::READ | ProtFlags::WRITE, MapFlags::SHARED, fd, 0) }.unwrap();
        Self { start: start.cast(), length }
    }

    /// As a V4L2 queue lends a buffer.
    fn bytes(&self) -> &[u8] {
        // SAFETY: mapped with this length and readable until Drop. That another mapping writes it meanwhile is the point of the test.
        unsafe { std::slice::from_raw_parts(self.start, self.length) }
    }

    /// As another process writes it.
    fn atoms(&self) -> &[AtomicU8] {
        // SAFETY: mapped with this length and writable until Drop; reached through this mapping by these atoms alone.
        unsafe { std::slice::from_raw_parts(self.start.cast(), self.length) }
    }
}

impl Drop for Mapping {
    fn drop(&mut self) {
        // SAFETY: mapped by `new` with this length; nothing borrows it any more.
        let _ = unsafe { munmap(self.start.cast(), self.length) };
    }
}

struct SharedCamera {
    memory: Mapping,
    frames: u64,
}

impl FrameSource for SharedCamera {
    fn format(&self) -> StreamFormat {
        StreamFormat::tight(WIDTH as u32, HEIGHT as u32, PixelFormat::Mjpeg, (1, 30))
    }

    fn lend(&mut self) -> Result<Lent<'_>, DeviceError> {
        if self.frames == FRAMES {
            return Ok(Lent::End);
        }
        let stamp = Stamp { time_ns: self.frames as i64 * 33_000_000, sequence: self.frames, flags: FrameFlags::default() };
        self.frames += 1;
        Ok(Lent::Frame(RawFrame { format: self.format(), bytes: self.memory.bytes(), stamp }))
    }
}

fn jpeg() -> Vec<u8> {
    let pixels: Vec<u8> = (0..WIDTH * HEIGHT * 3).map(|n| (n * 7 % 251) as u8).collect();
    let image = turbojpeg::Image {
        pixels: &pixels[..],
        width: WIDTH,
        pitch: 3 * WIDTH,
        height: HEIGHT,
        format: turbojpeg::PixelFormat::RGB,
    };
    turbojpeg::compress(image, 80, turbojpeg::Subsamp::Sub2x2).unwrap().to_vec()
}

#[test]
fn a_picture_that_changes_while_it_is_decoded_harms_nothing() {
    let jpeg = jpeg();
    let size_at = jpeg.windows(2).position(|pair| pair == [0xff, 0xc0]).unwrap() + 5;
    let sizes = [[HEIGHT, WIDTH], [HUGE, HUGE]].map(|[height, width]| {
        let (height, width) = ((height as u16).to_be_bytes(), (width as u16).to_be_bytes());
        [height[0], height[1], width[0], width[1]]
    });
    let fd = memfd_create("camera", MemfdFlags::CLOEXEC).unwrap();
    ftruncate(&fd, jpeg.len() as u64).unwrap();
    let (read, written) = (Mapping::new(&fd, jpeg.len()), Mapping::new(&fd, jpeg.len()));
    for (atom, byte) in written.atoms().iter().zip(&jpeg) {
        atom.store(*byte, Ordering::Relaxed);
    }
    let over = Stop::default();
    let totals = thread::scope(|scope| {
        let (over, written) = (&over, written);
        let writer = scope.spawn(move || {
            let written = written;
            for size in sizes.iter().cycle() {
                for (atom, byte) in written.atoms()[size_at..].iter().zip(size) {
                    atom.store(*byte, Ordering::Relaxed);
                }
                if over.is_set() {
                    break;
                }
            }
        });
        let mut source = SharedCamera { memory: read, frames: 0 };
        let mut sink = NullSink::new(&source.format());
        let totals = run_inline(&mut source, &mut sink, &Params::default(), &Stop::default(), &mut ()).unwrap();
        over.set();
        writer.join().unwrap();
        totals
    });
    assert_eq!((totals.frames_in, totals.frames_out), (FRAMES, FRAMES));
    let damaged = totals.damaged;
    assert!((1..FRAMES).contains(&damaged), "{damaged} of {FRAMES} frames damaged: nothing changed them, or nothing else came");
}
