//! Output and input of a frame with its numbers, in one piece of shared memory: for the page of `gimbald view`.
//!
//! ```text
//! output, as every shared picture | input, cropped to the output's size | descriptions of the last frames
//! ```

use std::io;
use std::os::fd::OwnedFd;
use std::sync::Arc;

use rustix::fs::{MemfdFlags, SealFlags, fcntl_add_seals, ftruncate, memfd_create};

use super::frame_info::{self, FrameInfo, Ring};
use super::lease::{Kind, Lease, LeaseView, Leases};
use super::memory::Memory;
use crate::device::StreamFormat;
use crate::frame::Frame;
use crate::image::{PictureRef, PlaneRef};
use crate::kernel::{Level, convert::NEUTRAL, convert::pack};

/// Bytes of such a piece for pictures of that size; `None` where there can be none.
pub(super) fn bytes(width: u32, height: u32) -> Option<usize> {
    super::wire::bytes(width, height).map(|picture| 2 * picture + frame_info::BYTES)
}

/// The memory of a pair, as its owner reads it.
#[derive(Debug)]
pub struct Pair {
    memory: Memory,
    picture: usize,
}

impl Pair {
    /// New memory for pictures of that size, and the descriptor to lend it by.
    ///
    /// # Errors
    /// Where there can be no such pictures, or the system gives no memory.
    pub fn new(width: u32, height: u32) -> io::Result<(Self, OwnedFd)> {
        let impossible = || io::Error::new(io::ErrorKind::InvalidInput, format!("invalid picture size {width}x{height}"));
        let (all, picture) = bytes(width, height).zip(super::wire::bytes(width, height)).ok_or_else(impossible)?;
        let fd = memfd_create(c"gimbald-view", MemfdFlags::CLOEXEC | MemfdFlags::ALLOW_SEALING)?;
        ftruncate(&fd, all as u64)?;
        fcntl_add_seals(&fd, SealFlags::SHRINK | SealFlags::GROW)?;
        Ok((Self { memory: Memory::map(&fd, all)?, picture }, fd))
    }

    /// The output's bytes, of [`super::PIXEL`].
    pub fn output(&self) -> &[u8] {
        &self.memory.bytes()[..self.picture]
    }

    /// The input's bytes, likewise.
    pub fn input(&self) -> &[u8] {
        &self.memory.bytes()[self.picture..2 * self.picture]
    }

    /// The last frames, oldest first; the last is the one of the pictures.
    pub fn frames(&self) -> Vec<FrameInfo> {
        frame_info::read(&self.memory.bytes()[2 * self.picture..])
    }
}

/// Where the frame path gives pairs to those that want them: a few atomic loads a frame where none does.
#[derive(Debug)]
pub struct Inspector {
    leases: LeaseView,
    ring: Ring,
    format: StreamFormat,
    level: Level,
}

impl Inspector {
    pub(super) fn new(leases: Arc<Leases>, most: usize, format: StreamFormat) -> Self {
        Self { leases: LeaseView::new(leases, most), ring: Ring::default(), format, level: Level::detected() }
    }

    /// Gives a frame and its output to those that want pairs. Never waits: one that has no memory free misses it.
    pub fn show(&mut self, frame: &Frame, output: PictureRef<'_>) {
        self.leases.refresh();
        if !self.leases.is_wanted(Kind::Both) {
            return;
        }
        self.ring.push(FrameInfo::of(frame, self.ring.count(), (output.width(), output.height())));
        let (width, height) = (self.format.width as usize, self.format.height as usize);
        if (output.width(), output.height()) != (width, height) {
            return;
        }
        for lease in self.leases.wanting(Kind::Both) {
            self.send(lease, frame, output);
        }
    }

    fn send(&self, lease: &Lease, frame: &Frame, output: PictureRef<'_>) {
        let Some(len) = bytes(self.format.width, self.format.height) else { return };
        let picture = (len - frame_info::BYTES) / 2;
        lease.draw(len, frame.stamp.time_ns, |bytes| {
            let (pixel, stride) = (self.format.pixel, self.format.stride);
            let (first, rest) = bytes.split_at_mut(picture);
            let (second, frames) = rest.split_at_mut(picture);
            let input = cropped(frame.picture.as_ref(), output.width(), output.height());
            if (input.width(), input.height()) != (output.width(), output.height()) {
                second.fill(NEUTRAL);
            }
            self.ring.write(frames);
            pack(self.level, output, pixel, stride, first).is_ok() && pack(self.level, input, pixel, stride, second).is_ok()
        });
    }
}

/// The top-left part of `picture`, at most `width` x `height`.
fn cropped(picture: PictureRef<'_>, width: usize, height: usize) -> PictureRef<'_> {
    let (across, down) = (width.min(picture.width()), height.min(picture.height()));
    let (chroma_across, chroma_down) = picture.sampling.chroma_size(across, down);
    fn part(plane: PlaneRef<'_>, across: usize, down: usize) -> Option<PlaneRef<'_>> {
        PlaneRef::new(plane.samples(), across, down, plane.stride())
    }
    let [y, u, v] = picture.planes;
    match (part(y, across, down), part(u, chroma_across, chroma_down), part(v, chroma_across, chroma_down)) {
        (Some(y), Some(u), Some(v)) => PictureRef { sampling: picture.sampling, planes: [y, u, v] },
        _ => picture,
    }
}
