//! A companion's connection on the daemon's side: its messages, its proof of access, the memory that it lends.

use std::mem::MaybeUninit;
use std::os::fd::OwnedFd;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use rustix::io::Errno;
use rustix::net::{
    RecvAncillaryBuffer, RecvAncillaryMessage, RecvFlags, ReturnFlags, SendFlags, Shutdown, recvmsg, send, shutdown,
};

use super::lease::{Canvas, Kind, Lease, MAX_LENT};
use super::memory::Memory;
use super::proof::CameraNode;
use super::server::Closing;
use super::wire::{Format, FromCompanion, FromDaemon, LONGEST, Refusal};

/// Messages in a second, at most: one for each of 240 frames, and some.
const MAX_MESSAGES: u32 = 1000;
/// Messages that are heard in a row before others have their turn.
const IN_A_ROW: usize = 32;
/// Descriptors that one message can bring; the kernel allows no more. Those we did not take it would close in our place.
const MAX_FDS: usize = 253;

/// A connected companion.
#[derive(Debug)]
pub(super) struct Connection {
    pub(super) lease: Arc<Lease>,
    /// The size of its node, once it said so.
    pub(super) size: Option<(u32, u32)>,
    watched: bool,
    kind: Kind,
    proven: bool,
    /// The numbers of what it lends, and those pieces that are neither free nor being drawn into.
    lent: Vec<u64>,
    resting: Vec<Canvas>,
    /// The messages of this second.
    counted: (Instant, u32),
}

impl Connection {
    pub(super) fn new(socket: OwnedFd) -> Self {
        let lease = Arc::new(Lease::new(socket));
        let (lent, resting) = (Vec::with_capacity(MAX_LENT), Vec::with_capacity(MAX_LENT));
        Self {
            lease,
            size: None,
            watched: false,
            kind: Kind::Output,
            proven: false,
            lent,
            resting,
            counted: (Instant::now(), 0),
        }
    }

    /// Whether a program watches whose user may.
    pub(super) fn watches(&self) -> bool {
        self.watched && self.proven
    }

    /// Whether it is a page of `gimbald view` that watches.
    pub(super) fn is_page(&self) -> bool {
        self.watches() && self.kind == Kind::Both
    }

    /// The size that its viewers hold: a page takes every size.
    pub(super) fn held_size(&self) -> Option<(u32, u32)> {
        self.size.filter(|_| self.watches() && self.kind == Kind::Output)
    }

    pub(super) fn is_proven(&self) -> bool {
        self.proven
    }

    pub(super) fn waits_for_proof(&self) -> bool {
        self.watched && !self.proven
    }

    /// Says what pictures there are; where it is another camera, it has to prove itself again.
    pub(super) fn tell(&mut self, format: &Format, other_camera: bool) {
        if other_camera {
            self.proven = false;
        }
        self.send(&FromDaemon::Format(format.clone()));
        self.judge(Some(format));
    }

    /// A companion that does not read misses it.
    fn send(&self, message: &FromDaemon) {
        let _ = send(&self.lease.socket, message.packet().bytes(), SendFlags::DONTWAIT | SendFlags::NOSIGNAL);
    }

    /// Whether it gets pictures.
    fn judge(&self, format: Option<&Format>) {
        let fits = format.is_some_and(|format| self.size == Some((format.width, format.height)));
        self.lease.live.store(self.watches() && fits, Ordering::Relaxed);
    }

    /// Hears what it has to say. An error is the reason to end the connection.
    pub(super) fn handle_messages(
        &mut self,
        camera: Option<&CameraNode>,
        format: Option<&Format>,
        closing: &Closing,
    ) -> Result<(), String> {
        for _ in 0..IN_A_ROW {
            let Some((message, mut fds)) = self.receive(closing)? else { break };
            let fd = fds.pop();
            if !fds.is_empty() {
                fds.into_iter().chain(fd).for_each(|fd| closing.close(fd));
                return Err("it sent more than one descriptor".into());
            }
            self.obey(message, fd, camera, format, closing)?;
        }
        Ok(())
    }

    fn receive(&mut self, closing: &Closing) -> Result<Option<(FromCompanion, Vec<OwnedFd>)>, String> {
        let mut bytes = [0; LONGEST];
        let mut space = [MaybeUninit::uninit(); rustix::cmsg_space!(ScmRights(MAX_FDS))];
        let mut ancillary = RecvAncillaryBuffer::new(&mut space);
        let flags = RecvFlags::DONTWAIT | RecvFlags::CMSG_CLOEXEC;
        let received = recvmsg(&self.lease.socket, &mut [std::io::IoSliceMut::new(&mut bytes)], &mut ancillary, flags);
        let received = match received {
            Ok(received) => received,
            Err(Errno::AGAIN | Errno::INTR) => return Ok(None),
            Err(errno) => return Err(errno.to_string()),
        };
        let mut fds = Vec::new();
        for message in ancillary.drain() {
            if let RecvAncillaryMessage::ScmRights(rights) = message {
                fds.extend(rights);
            }
        }
        if received.bytes == 0 && fds.is_empty() {
            return Err("it hung up".into());
        }
        if self.counted.0.elapsed() >= Duration::from_secs(1) {
            self.counted = (Instant::now(), 0);
        }
        self.counted.1 += 1;
        let message = (!received.flags.contains(ReturnFlags::TRUNC) && self.counted.1 <= MAX_MESSAGES)
            .then(|| FromCompanion::read(&bytes[..received.bytes]))
            .flatten();
        match message {
            Some(message) => Ok(Some((message, fds))),
            None => {
                fds.into_iter().for_each(|fd| closing.close(fd));
                Err("it sent an invalid message, or too many".into())
            }
        }
    }

    /// Does what a message asks for.
    fn obey(
        &mut self,
        message: FromCompanion,
        fd: Option<OwnedFd>,
        camera: Option<&CameraNode>,
        format: Option<&Format>,
        closing: &Closing,
    ) -> Result<(), String> {
        self.collect();
        match (message, fd) {
            (FromCompanion::Watch { wants, size }, fd) => {
                (self.size, self.watched, self.kind) = (Some(size), wants.is_some(), wants.unwrap_or(self.kind));
                self.proven = is_proof(fd, camera, closing);
                self.watch(format);
            }
            (FromCompanion::Lend { id }, Some(fd)) => {
                if let Err(why) = self.lend(id, &fd) {
                    closing.close(fd);
                    return Err(why);
                }
            }
            (FromCompanion::Free { id }, None) => {
                self.free(id);
            }
            (FromCompanion::Revoke { id }, None) => {
                self.lent.retain(|lent| *lent != id);
                self.resting.retain(|canvas| canvas.id != id);
                self.sift();
            }
            (_, fd) => {
                fd.into_iter().for_each(|fd| closing.close(fd));
                return Err("it sent a descriptor where none belongs, or none where one does".into());
            }
        }
        Ok(())
    }

    /// It watches, or no longer; if it does and gets no pictures, it is told why.
    fn watch(&mut self, format: Option<&Format>) {
        self.lease.set_kind(self.kind);
        self.judge(format);
        if self.waits_for_proof() {
            self.send(&FromDaemon::Refused(Refusal::Proof));
        } else if self.watched && !self.lease.live.load(Ordering::Relaxed) {
            self.send(&FromDaemon::Refused(Refusal::Size));
        }
    }

    /// It lends memory for one picture of its size.
    fn lend(&mut self, id: u64, fd: &OwnedFd) -> Result<(), String> {
        let (width, height) = self.size.ok_or("it lent memory before it announced a size")?;
        let bytes = match self.kind {
            Kind::Output => super::wire::bytes(width, height),
            Kind::Both => super::pair::bytes(width, height),
        };
        let bytes = bytes.ok_or("it lent memory for an impossible size")?;
        if self.lent.len() >= MAX_LENT || self.lent.contains(&id) {
            return Err("it lent too much memory".into());
        }
        let memory = Memory::map(fd, bytes).map_err(|error| format!("its memory was refused: {error}"))?;
        self.lent.push(id);
        self.resting.push(Canvas { id, memory });
        Ok(())
    }

    /// Takes back what the frame path drew into.
    fn collect(&mut self) {
        while let Ok(canvas) = self.lease.drawn.1.try_recv() {
            if self.lent.contains(&canvas.id) {
                self.resting.push(canvas);
            }
        }
        while let Ok(id) = self.lease.unsent.1.try_recv() {
            self.free(id);
        }
    }

    /// Lets the frame path draw into a piece. One that was revoked or is free already changes nothing.
    fn free(&mut self, id: u64) {
        if let Some(at) = self.resting.iter().position(|canvas| canvas.id == id) {
            let _ = self.lease.empty.0.try_send(self.resting.swap_remove(at));
        }
    }

    /// Takes what was revoked out of what is free; the frame path may be drawing into it just now, and then leaves it to be collected.
    fn sift(&mut self) {
        for _ in 0..self.lease.empty.1.len() {
            let Ok(canvas) = self.lease.empty.1.try_recv() else { break };
            if self.lent.contains(&canvas.id) {
                let _ = self.lease.empty.0.try_send(canvas);
            }
        }
    }

    /// The end of the connection. The lease is what the frame path may still have.
    pub(super) fn leave(self) -> Arc<Lease> {
        self.lease.live.store(false, Ordering::Relaxed);
        let _ = shutdown(&self.lease.socket, Shutdown::Both);
        self.lease
    }
}

/// Whether a descriptor proves that its sender may use the camera; one that does not may block when it is closed.
fn is_proof(fd: Option<OwnedFd>, camera: Option<&CameraNode>, closing: &Closing) -> bool {
    let Some(fd) = fd else { return false };
    let is_proof = camera.is_some_and(|camera| camera.is_proven_by(&fd));
    if !is_proof {
        closing.close(fd);
    }
    is_proof
}
