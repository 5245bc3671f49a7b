//! One client's connection on the server's side: bytes received, and bytes still to send. Never blocks.

use std::fmt;
use std::io::{ErrorKind, Read, Write};
use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::net::UnixStream;
use std::time::{Duration, Instant};

use rustix::event::PollFlags;

use super::token_bucket::TokenBucket;
use super::{LONGEST_REQUEST, Limits, Reply, RequestError};

/// The user id of all users that have none in this user namespace (overflow uid). With systemd's PrivateUsers= these are all but root
/// and the service's own.
const UNMAPPED: u32 = 65534;

/// Bytes per read.
const READ: usize = 4096;

/// The peer process, as the kernel recorded it at the time of the connection.
#[derive(Clone, Copy, Debug, Eq, Hash, PartialEq)]
pub(super) struct Peer {
    /// Its user.
    pub(super) uid: u32,
    /// Its number; 0 for one in another process namespace.
    pub(super) pid: i32,
}

impl Peer {
    /// Who is at the other end of `stream`.
    pub(super) fn of(stream: &UnixStream) -> Self {
        let asked = rustix::net::sockopt::socket_peercred(stream);
        asked.map_or(Self { uid: UNMAPPED, pid: 0 }, |who| Self { uid: who.uid.as_raw(), pid: who.pid.as_raw_pid() })
    }

    /// Whether it is root or the daemon's own user. A user without an id in this namespace is neither, even if the daemon has that id too.
    pub(super) fn is_trusted(self) -> bool {
        self.uid != UNMAPPED && (self.uid == 0 || self.uid == rustix::process::geteuid().as_raw())
    }
}

impl fmt::Display for Peer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.uid {
            UNMAPPED => write!(f, "process {} of another user", self.pid),
            uid => write!(f, "process {} of uid {uid}", self.pid),
        }
    }
}

/// State of a session.
#[derive(Clone, Copy, Debug, Eq, PartialEq)]
pub(super) enum At {
    /// No request.
    Rest,
    /// Part of a request was received.
    Arriving,
    /// A complete request waits for its turn.
    Ready,
    /// The reply is sent when the configuration has been read.
    Reloading,
    /// A reply is being sent. Nothing is read meanwhile, so a client that does not read cannot make it grow.
    Giving,
}

/// A connection.
#[derive(Debug)]
pub(super) struct Session {
    stream: UnixStream,
    pub(super) peer: Peer,
    pub(super) trusted: bool,
    /// Requests that this connection may still make.
    pub(super) bucket: TokenBucket,
    input: Vec<u8>,
    /// Bytes of the first whole line in `input`, its end not counted.
    line: Option<usize>,
    output: Vec<u8>,
    /// The ticket of the reload that the session waits for.
    reload: Option<u64>,
    /// Close the connection when the reply is sent.
    last: bool,
    /// The client has closed its side.
    ended: bool,
    /// When the state began.
    since: Instant,
}

impl Session {
    /// A connection that was just accepted; `None` where it cannot be served without waiting.
    pub(super) fn new(stream: UnixStream, peer: Peer, limits: &Limits, now: Instant) -> Option<Self> {
        stream.set_nonblocking(true).ok()?;
        Some(Self {
            stream,
            peer,
            trusted: peer.is_trusted(),
            bucket: TokenBucket::new(limits.connection, now),
            input: Vec::new(),
            line: None,
            output: Vec::new(),
            reload: None,
            last: false,
            ended: false,
            since: now,
        })
    }

    /// The state.
    pub(super) fn at(&self) -> At {
        if !self.output.is_empty() {
            At::Giving
        } else if self.reload.is_some() {
            At::Reloading
        } else if self.line.is_some() {
            At::Ready
        } else if self.input.is_empty() {
            At::Rest
        } else {
            At::Arriving
        }
    }

    /// When the state began.
    pub(super) fn since(&self) -> Instant {
        self.since
    }

    /// The descriptor and the events to wait for; `None` while the session waits for something other than the client.
    pub(super) fn wish(&self) -> Option<(BorrowedFd<'_>, PollFlags)> {
        let wish = match self.at() {
            At::Giving => PollFlags::OUT,
            At::Rest | At::Arriving => PollFlags::IN,
            At::Ready | At::Reloading => return None,
        };
        Some((self.stream.as_fd(), wish))
    }

    /// How long it may stay in its state; `None` where that does not depend on the client.
    pub(super) fn time_limit(&self, limits: &Limits) -> Option<Duration> {
        match self.at() {
            At::Rest => Some(limits.idle),
            At::Arriving | At::Giving => Some(limits.slow),
            At::Reloading => Some(limits.reading),
            At::Ready => None,
        }
    }

    /// Reads or writes as much as possible without blocking; false when the connection is closed.
    pub(super) fn talk(&mut self, now: Instant) -> bool {
        match self.at() {
            At::Giving => self.give(now),
            At::Rest | At::Arriving => self.read_requests(now),
            At::Ready | At::Reloading => true,
        }
    }

    fn read_requests(&mut self, now: Instant) -> bool {
        let mut buffer = [0; READ];
        let rested = self.input.is_empty();
        match self.stream.read(&mut buffer) {
            Ok(0) => self.ended = true,
            Ok(read) => self.input.extend_from_slice(&buffer[..read]),
            Err(error) => return is_passing(error.kind()),
        }
        self.find_line();
        if rested || self.line.is_some() {
            self.since = now;
        }
        // With room for the \r of a line end.
        if self.line.is_none() && self.input.len() > LONGEST_REQUEST + 1 {
            self.input = Vec::new();
            self.last = true;
            return self.reply(&Reply::Refused(RequestError::TooLong.into()), now);
        }
        !self.is_over()
    }

    fn find_line(&mut self) {
        self.line = self.input.iter().position(|byte| *byte == b'\n');
    }

    /// Removes the next request from the input, without its line end.
    pub(super) fn take_line(&mut self, now: Instant) -> Option<Vec<u8>> {
        let length = self.line?;
        let mut line: Vec<u8> = self.input.drain(..=length).collect();
        line.pop();
        if line.ends_with(b"\r") {
            line.pop();
        }
        self.find_line();
        self.since = now;
        Some(line)
    }

    /// Makes the session wait for the reload with this ticket.
    pub(super) fn await_reload(&mut self, ticket: u64, now: Instant) {
        (self.reload, self.since) = (Some(ticket), now);
    }

    /// Ends the wait for a reload with this ticket or an earlier one; whether there was one.
    pub(super) fn has_awaited(&mut self, ticket: u64) -> bool {
        self.reload.take_if(|waited| *waited <= ticket).is_some()
    }

    /// Replies; false when the connection is closed.
    pub(super) fn reply(&mut self, reply: &Reply, now: Instant) -> bool {
        self.output = reply.line().into_bytes();
        self.since = now;
        self.give(now)
    }

    fn give(&mut self, now: Instant) -> bool {
        match self.stream.write(&self.output) {
            Ok(0) => return false,
            Ok(written) => drop(self.output.drain(..written)),
            Err(error) => return is_passing(error.kind()),
        }
        if self.output.is_empty() {
            // Frees the memory of a long reply.
            self.output = Vec::new();
            self.since = now;
        }
        !self.is_over()
    }

    /// Sends the reason why the connection is closed, unless another reply is being sent.
    pub(super) fn dismiss(&self, why: &Reply) {
        if self.at() != At::Giving {
            dismiss(&self.stream, why);
        }
    }

    fn is_over(&self) -> bool {
        match self.at() {
            At::Giving => false,
            At::Reloading | At::Ready => self.last,
            At::Rest | At::Arriving => self.last || self.ended,
        }
    }
}

/// Sends a rejected client the reason, as far as that does not block.
pub(super) fn dismiss(mut stream: &UnixStream, why: &Reply) {
    let _ = stream.set_nonblocking(true);
    let _ = stream.write(why.line().as_bytes());
}

fn is_passing(kind: ErrorKind) -> bool {
    matches!(kind, ErrorKind::WouldBlock | ErrorKind::Interrupted)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pair() -> (UnixStream, Session) {
        let (client, stream) = UnixStream::pair().unwrap();
        let peer = Peer::of(&stream);
        (client, Session::new(stream, peer, &Limits::default(), Instant::now()).unwrap())
    }

    #[test]
    fn requests_come_in_pieces_and_several_at_once() {
        let (mut client, mut session) = pair();
        let now = Instant::now();
        assert_eq!((session.at(), session.trusted), (At::Rest, true));
        client.write_all(b"sta").unwrap();
        assert!(session.talk(now) && session.at() == At::Arriving);
        client.write_all(b"tus\r\non\nof").unwrap();
        assert!(session.talk(now) && session.at() == At::Ready && session.wish().is_none());
        assert_eq!(session.take_line(now).as_deref(), Some(&b"status"[..]));
        assert_eq!(session.take_line(now).as_deref(), Some(&b"on"[..]));
        assert_eq!((session.at(), session.take_line(now)), (At::Arriving, None));
        client.shutdown(std::net::Shutdown::Write).unwrap();
        assert!(!session.talk(now), "half a request and no more to come");
    }

    #[test]
    fn who_says_no_more_still_gets_the_replies() {
        let (mut client, mut session) = pair();
        let now = Instant::now();
        client.write_all(b"status\n").unwrap();
        client.shutdown(std::net::Shutdown::Write).unwrap();
        assert!(session.talk(now));
        session.take_line(now).unwrap();
        session.await_reload(3, now);
        assert!(session.talk(now) && !session.has_awaited(2) && session.has_awaited(3) && !session.has_awaited(3));
        assert!(session.reply(&Reply::Metrics { text: "x".into() }, now), "it is not known yet that there is no more");
        assert!(!session.talk(now));
        drop(session);
        let mut text = String::new();
        client.read_to_string(&mut text).unwrap();
        assert_eq!(text, "{\"ok\":true,\"text\":\"x\"}\n");
    }

    #[test]
    fn what_is_not_taken_is_not_added_to() {
        let (client, mut session) = pair();
        let now = Instant::now();
        let long = Reply::Metrics { text: "x".repeat(4 << 20) };
        (&client).write_all(b"status\nstatus\n").unwrap();
        assert!(session.talk(now));
        session.take_line(now).unwrap();
        assert!(session.reply(&long, now) && session.at() == At::Giving);
        assert!(session.talk(now) && session.at() == At::Giving);
        assert_eq!(session.time_limit(&Limits::default()), Some(Limits::default().slow));
        drop(client);
        assert!(!session.talk(now));
    }

    #[test]
    fn a_line_without_end_is_refused() {
        let (client, mut session) = pair();
        let now = Instant::now();
        (&client).write_all(&[b'x'; LONGEST_REQUEST + 1]).unwrap();
        assert!(session.talk(now) && session.talk(now) && session.at() == At::Arriving);
        (&client).write_all(b"x").unwrap();
        assert!(!session.talk(now) && session.input.capacity() == 0);
    }

    #[test]
    fn who_has_no_user_here_is_not_trusted() {
        assert!(Peer { uid: 0, pid: 1 }.is_trusted());
        assert!(Peer { uid: rustix::process::geteuid().as_raw(), pid: 1 }.is_trusted());
        let stranger = Peer { uid: UNMAPPED, pid: 7 };
        assert!(!stranger.is_trusted());
        assert_eq!(stranger.to_string(), "process 7 of another user");
    }
}
