//! The frame path's side: draws into memory that companions lend.

use std::os::fd::OwnedFd;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
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
pub(super) const MAX_LENT: usize = 16;

/// Which pictures of a frame a companion wants.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub(super) enum Kind {
    /// The output.
    Output = 1,
    /// Output, input, and [`super::FrameInfo`].
    Both = 2,
}

/// A piece of lent memory and its number.
#[derive(Debug)]
pub(super) struct Canvas {
    pub(super) id: u64,
    pub(super) memory: Memory,
}

/// What a companion lends. The server's thread fills `empty`, the frame path draws and leaves what it drew into in `drawn`; neither
/// waits for the other. All channels have room for every piece there is.
#[derive(Debug)]
pub(super) struct Lease {
    pub(super) socket: OwnedFd,
    /// Whether its pictures are wanted and may be had.
    pub(super) live: AtomicBool,
    /// Which pictures are wanted, a [`Kind`].
    kind: AtomicU32,
    pub(super) empty: (Sender<Canvas>, Receiver<Canvas>),
    pub(super) drawn: (Sender<Canvas>, Receiver<Canvas>),
    /// The numbers of pieces in `drawn` that the companion could not be told of.
    pub(super) unsent: (Sender<u64>, Receiver<u64>),
    pub(super) sent: AtomicU64,
    /// Frames for which it had no memory, or no room in the socket.
    pub(super) dropped: AtomicU64,
}

impl Lease {
    pub(super) fn new(socket: OwnedFd) -> Self {
        Self {
            socket,
            live: AtomicBool::new(false),
            kind: AtomicU32::new(Kind::Output as u32),
            empty: bounded(MAX_LENT),
            drawn: bounded(MAX_LENT),
            unsent: bounded(MAX_LENT),
            sent: AtomicU64::new(0),
            dropped: AtomicU64::new(0),
        }
    }

    /// Sets which pictures are wanted.
    pub(super) fn set_kind(&self, kind: Kind) {
        self.kind.store(kind as u32, Ordering::Relaxed);
    }

    fn is_live(&self, kind: Kind) -> bool {
        self.live.load(Ordering::Relaxed) && self.kind.load(Ordering::Relaxed) == kind as u32
    }

    /// Draws a picture into the next free piece and says so. `false`: it was dropped.
    fn send(&self, level: Level, picture: PictureRef<'_>, format: &StreamFormat, stamp: &Stamp) -> bool {
        let Some(bytes) = format.frame_bytes() else { return false };
        self.draw(bytes, stamp.time_ns, |memory| pack(level, picture, format.pixel, format.stride, memory).is_ok())
    }

    /// Has `draw` fill the next free piece of `bytes` bytes with a picture taken at `time_ns`, and says so. `draw` returns whether it did.
    /// `false`: the picture was dropped.
    pub(super) fn draw(&self, bytes: usize, time_ns: i64, mut draw: impl FnMut(&mut [u8]) -> bool) -> bool {
        let sent = self.try_draw(bytes, time_ns, &mut draw);
        let count = if sent { &self.sent } else { &self.dropped };
        count.fetch_add(1, Ordering::Relaxed);
        sent
    }

    fn try_draw(&self, bytes: usize, time_ns: i64, draw: &mut impl FnMut(&mut [u8]) -> bool) -> bool {
        loop {
            let Ok(mut canvas) = self.empty.1.try_recv() else { return false };
            // One that is left from another size goes.
            let fits = canvas.memory.bytes().len() == bytes && draw(canvas.memory.bytes_mut());
            if !fits {
                let _ = self.drawn.0.try_send(canvas);
                continue;
            }
            let id = canvas.id;
            // First this: the companion may free it as soon as it has the message.
            let _ = self.drawn.0.try_send(canvas);
            let message = FromDaemon::Frame { id, time_ns }.packet();
            let sent = send(&self.socket, message.bytes(), SendFlags::DONTWAIT | SendFlags::NOSIGNAL).is_ok();
            if !sent {
                // The companion does not know of it, so it is still free. One that has disconnected is noticed by the server's thread.
                let _ = self.unsent.0.try_send(id);
            }
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

/// The frame path's copy of the list of leases, so that it takes no lock for a frame.
#[derive(Debug)]
pub(super) struct LeaseView {
    shared: Arc<Leases>,
    /// As they were when they last changed.
    known: Vec<Arc<Lease>>,
    seen: u64,
}

/// Where the frame path gives a picture to every companion that wants it: a few atomic loads where none does.
#[derive(Debug)]
pub struct Outlet {
    leases: LeaseView,
    format: StreamFormat,
    level: Level,
}

impl Outlet {
    pub(super) fn new(leases: Arc<Leases>, most: usize, format: StreamFormat) -> Self {
        Self { leases: LeaseView::new(leases, most), format, level: Level::detected() }
    }

    /// Whether any companion wants pictures now.
    pub fn is_wanted(&mut self) -> bool {
        self.leases.refresh();
        self.leases.is_wanted(Kind::Output)
    }

    /// Gives `picture`, of this outlet's size, to each companion that wants it. Never waits: a companion that has no memory free misses it.
    pub fn send(&mut self, picture: PictureRef<'_>, stamp: &Stamp) {
        self.leases.refresh();
        for lease in self.leases.wanting(Kind::Output) {
            self.leases.count(lease.send(self.level, picture, &self.format, stamp));
        }
    }
}

impl LeaseView {
    pub(super) fn new(shared: Arc<Leases>, most: usize) -> Self {
        Self { shared, known: Vec::with_capacity(most), seen: u64::MAX }
    }

    /// Whether any companion wants pictures of that kind now.
    pub(super) fn is_wanted(&self, kind: Kind) -> bool {
        self.wanting(kind).next().is_some()
    }

    /// The leases of companions that want such pictures now.
    pub(super) fn wanting(&self, kind: Kind) -> impl Iterator<Item = &Lease> {
        self.known.iter().map(|lease| &**lease).filter(move |lease| lease.is_live(kind))
    }

    /// Counts a picture of [`Companions::counts`](super::Companions::counts).
    fn count(&self, sent: bool) {
        let count = if sent { &self.shared.sent } else { &self.shared.dropped };
        count.fetch_add(1, Ordering::Relaxed);
    }

    /// Takes note of companions that connected or left. While the list is being changed, the next frame does it.
    pub(super) fn refresh(&mut self) {
        let version = self.shared.version.load(Ordering::Acquire);
        if version == self.seen {
            return;
        }
        let all = match self.shared.all.try_lock() {
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
