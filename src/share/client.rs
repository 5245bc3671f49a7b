//! The companion's side of the socket.

use std::io;
use std::mem::MaybeUninit;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::path::Path;

use rustix::io::Errno;
use rustix::net::{
    AddressFamily, RecvFlags, SendAncillaryBuffer, SendAncillaryMessage, SendFlags, SocketAddrUnix, SocketFlags, SocketType,
    connect, recv, sendmsg, socket_with,
};

use super::lease::Kind;
use super::wire::{Format, FromCompanion, FromDaemon, LONGEST, Packet, Refusal};

/// A connection to a daemon. Every error ends it: drop it and connect again.
#[derive(Debug)]
pub struct Client {
    socket: OwnedFd,
}

/// What a daemon says.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Heard {
    /// What pictures it makes, and of which camera.
    Format(Format),
    /// The piece of memory of that number holds a picture taken at `time_ns` (CLOCK_MONOTONIC, nanoseconds).
    Frame {
        /// The piece's number.
        id: u64,
        /// When its first row was taken.
        time_ns: i64,
    },
    /// No pictures come, for that reason.
    Refused(Refusal),
}

impl Client {
    /// Connects to the daemon that listens at `path`.
    ///
    /// # Errors
    /// Where none does.
    pub fn connect(path: &Path) -> io::Result<Self> {
        let flags = SocketFlags::CLOEXEC | SocketFlags::NONBLOCK;
        let socket = socket_with(AddressFamily::UNIX, SocketType::SEQPACKET, flags, None)?;
        connect(&socket, &SocketAddrUnix::new(path)?)?;
        Ok(Self { socket })
    }

    /// The descriptor to poll for reading.
    pub fn fd(&self) -> BorrowedFd<'_> {
        self.socket.as_fd()
    }

    /// The next thing it says; `None` where it says nothing now.
    ///
    /// # Errors
    /// Where it hung up, or says what this version does not understand.
    pub fn receive(&self) -> io::Result<Option<Heard>> {
        let mut bytes = [0u8; LONGEST];
        let len = match recv(&self.socket, &mut bytes, RecvFlags::DONTWAIT) {
            Ok((len, _)) => len,
            Err(Errno::AGAIN | Errno::INTR) => return Ok(None),
            Err(errno) => return Err(errno.into()),
        };
        if len == 0 {
            return Err(io::Error::new(io::ErrorKind::UnexpectedEof, "the daemon hung up"));
        }
        match FromDaemon::read(&bytes[..len]) {
            Some(FromDaemon::Format(format)) => Ok(Some(Heard::Format(format))),
            Some(FromDaemon::Frame { id, time_ns }) => Ok(Some(Heard::Frame { id, time_ns })),
            Some(FromDaemon::Refused(refusal)) => Ok(Some(Heard::Refused(refusal))),
            None => Err(io::Error::new(io::ErrorKind::InvalidData, "the daemon is of another version; restart both")),
        }
    }

    /// Says whether a program watches the node of `size`; `camera` is the camera's node, opened to read and write.
    ///
    /// # Errors
    /// Where the daemon is gone or does not listen.
    pub fn watch(&self, on: bool, size: (u32, u32), camera: Option<BorrowedFd<'_>>) -> io::Result<()> {
        self.send(&FromCompanion::Watch { wants: on.then_some(Kind::Output), size }.packet(), camera)
    }

    /// Says that output, input and what is told of each frame are wanted ([`super::Pair`]); otherwise as [`Client::watch`].
    ///
    /// # Errors
    /// As [`Client::watch`].
    pub fn watch_both(&self, size: (u32, u32), camera: Option<BorrowedFd<'_>>) -> io::Result<()> {
        self.send(&FromCompanion::Watch { wants: Some(Kind::Both), size }.packet(), camera)
    }

    /// Lends a memfd of a picture's size under a number that was not lent before.
    ///
    /// # Errors
    /// As [`Client::watch`].
    pub fn lend(&self, id: u64, memory: BorrowedFd<'_>) -> io::Result<()> {
        self.send(&FromCompanion::Lend { id }.packet(), Some(memory))
    }

    /// Says that the piece of that number may be drawn into.
    ///
    /// # Errors
    /// As [`Client::watch`].
    pub fn free(&self, id: u64) -> io::Result<()> {
        self.send(&FromCompanion::Free { id }.packet(), None)
    }

    /// Says that the piece of that number is gone.
    ///
    /// # Errors
    /// As [`Client::watch`].
    pub fn revoke(&self, id: u64) -> io::Result<()> {
        self.send(&FromCompanion::Revoke { id }.packet(), None)
    }

    fn send(&self, packet: &Packet, fd: Option<BorrowedFd<'_>>) -> io::Result<()> {
        let mut space = [MaybeUninit::uninit(); rustix::cmsg_space!(ScmRights(1))];
        let mut ancillary = SendAncillaryBuffer::new(&mut space);
        let fds: Vec<BorrowedFd<'_>> = fd.into_iter().collect();
        if !fds.is_empty() {
            ancillary.push(SendAncillaryMessage::ScmRights(&fds));
        }
        let flags = SendFlags::DONTWAIT | SendFlags::NOSIGNAL;
        sendmsg(&self.socket, &[io::IoSlice::new(packet.bytes())], &mut ancillary, flags)?;
        Ok(())
    }
}
