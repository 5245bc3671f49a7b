//! The frame path's side: memory that companions lend is drawn into, frame by frame.

use std::os::fd::OwnedFd;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError, TryLockError};

use crossbeam_channel::{Receiver, Sender, bounded};
use rustix::net::{SendFlags, send};

use super::memory::Memory;
use super::wire::FromDaemon;
use crate::device::StreamFormat;
use crate::frame::Stamp;
use crate::image::PictureRef;
use crate::kernel::{Level, convert::pack};

/// Pieces of memory that a companion may lend at a time; PipeWire's buffers are no more.
pub(super) const MOST_LENT: usize = 16;

/// A piece of lent memory and its number.
#[derive(Debug)]
pub(super) struct Canvas {
    pub(super) id: u64,
    pub(super) memory: Memory,
}

/// What a companion lends. The server's thread fills `empty`, the frame path draws and leaves what it drew into in `drawn`; neither
/// waits for the other. Both channels have room for every piece there is.
#[derive(Debug)]
pub(super) struct Lease {
    pub(super) socket: OwnedFd,
    /// Whether its pictures are wanted and may be had.
    pub(super) live: AtomicBool,
    pub(super) empty: (Sender<Canvas>, Receiver<Canvas>),
    pub(super) drawn: (Sender<Canvas>, Receiver<Canvas>),
    pub(super) sent: AtomicU64,
    /// Frames for which it had no memory, or no room in the socket.
    pub(super) dropped: AtomicU64,
}

impl Lease {
    pub(super) fn new(socket: OwnedFd) -> Self {
        Self {
            socket,
            live: AtomicBool::new(false),
            empty: bounded(MOST_LENT),
            drawn: bounded(MOST_LENT),
            sent: AtomicU64::new(0),
            dropped: AtomicU64::new(0),
        }
    }

    /// Draws a picture into the next free piece and says so. `false`: it was dropped.
    fn send(&self, level: Level, picture: PictureRef<'_>, format: &StreamFormat, stamp: &Stamp) -> bool {
        let sent = self.draw(level, picture, format, stamp);
        let count = if sent { &self.sent } else { &self.dropped };
        count.fetch_add(1, Ordering::Relaxed);
        sent
    }

    fn draw(&self, level: Level, picture: PictureRef<'_>, format: &StreamFormat, stamp: &Stamp) -> bool {
        let Some(bytes) = format.frame_bytes() else { return false };
        loop {
            let Ok(mut canvas) = self.empty.1.try_recv() else { return false };
            // One that is left from another size goes.
            let fits = canvas.memory.bytes().len() == bytes
                && pack(level, picture, format.pixel, format.stride, canvas.memory.bytes_mut()).is_ok();
            if !fits {
                let _ = self.drawn.0.try_send(canvas);
                continue;
            }
            let message = FromDaemon::Frame { id: canvas.id, time_ns: stamp.time_ns }.packet();
            let sent = send(&self.socket, message.bytes(), SendFlags::DONTWAIT | SendFlags::NOSIGNAL).is_ok();
            // Where it could not be sent, the companion does not know of it, so it is still free. A companion that went away is noticed by
            // the server's thread.
            let next = if sent { &self.drawn.0 } else { &self.empty.0 };
            let _ = next.try_send(canvas);
            return sent;
        }
    }
}

/// All leases there are, and a number that changes with them.
#[derive(Debug, Default)]
pub(super) struct Leases {
    version: AtomicU64,
    /// Pictures of all companions, those that went included.
    sent: AtomicU64,
    dropped: AtomicU64,
    all: Mutex<Vec<Arc<Lease>>>,
}

impl Leases {
    pub(super) fn change(&self, change: impl FnOnce(&mut Vec<Arc<Lease>>)) {
        change(&mut self.all.lock().unwrap_or_else(PoisonError::into_inner));
        self.version.fetch_add(1, Ordering::Release);
    }

    /// Pictures sent and dropped, since the beginning.
    pub(super) fn counts(&self) -> (u64, u64) {
        (self.sent.load(Ordering::Relaxed), self.dropped.load(Ordering::Relaxed))
    }
}

/// Where the frame path gives a picture to every companion that wants it: a few atomic loads where none does.
#[derive(Debug)]
pub struct Outlet {
    leases: Arc<Leases>,
    /// As they were when they last changed.
    known: Vec<Arc<Lease>>,
    seen: u64,
    format: StreamFormat,
    level: Level,
}

impl Outlet {
    pub(super) fn new(leases: Arc<Leases>, most: usize, format: StreamFormat) -> Self {
        Self { leases, known: Vec::with_capacity(most), seen: u64::MAX, format, level: Level::detected() }
    }

    /// Whether any companion wants pictures now.
    pub fn is_wanted(&mut self) -> bool {
        self.look();
        self.known.iter().any(|lease| lease.live.load(Ordering::Relaxed))
    }

    /// Gives `picture`, of this outlet's size, to each companion that wants it. Never waits: a companion that has no memory free misses it.
    pub fn send(&mut self, picture: PictureRef<'_>, stamp: &Stamp) {
        self.look();
        for lease in self.known.iter().filter(|lease| lease.live.load(Ordering::Relaxed)) {
            let sent = lease.send(self.level, picture, &self.format, stamp);
            let count = if sent { &self.leases.sent } else { &self.leases.dropped };
            count.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Takes note of companions that came or went. Where they are just being changed, the next frame will.
    fn look(&mut self) {
        let version = self.leases.version.load(Ordering::Acquire);
        if version == self.seen {
            return;
        }
        let all = match self.leases.all.try_lock() {
            Ok(all) => all,
            Err(TryLockError::Poisoned(poisoned)) => poisoned.into_inner(),
            Err(TryLockError::WouldBlock) => return,
        };
        self.known.clear();
        // Room for all was made at first.
        self.known.extend(all.iter().take(self.known.capacity()).cloned());
        self.seen = version;
    }
}
