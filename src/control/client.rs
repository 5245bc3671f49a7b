//! The client's side of the control socket: sends requests to a daemon and reads its replies.

use std::io::{self, BufRead, BufReader, Read, Write};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::time::Duration;

use rustix::net::sockopt::{Timeout, set_socket_timeout};
use rustix::net::{AddressFamily, SocketAddrUnix, SocketFlags, SocketType, connect, socket_with};

use super::{Applied, FrameNumber, FrameRecord, Refusal, RefusalKind, Reply, Request, Status};

/// A daemon that does not answer for this long hangs.
const TIMEOUT: Duration = Duration::from_secs(5);
/// Pauses before a request is repeated on a new connection, where the daemon was too busy or hung up.
const PAUSES: [Duration; 3] = [Duration::from_millis(50), Duration::from_millis(150), Duration::from_millis(400)];
/// Bytes of a reply, at most.
const LONGEST_REPLY: u64 = 1 << 20;

/// Why there is no answer.
#[derive(Debug, thiserror::Error)]
pub enum ClientError {
    /// No daemon listens.
    #[error("no daemon running at {path}: {source}")]
    NotRunning {
        /// The socket.
        path: PathBuf,
        /// The system's words.
        source: io::Error,
    },
    /// One may not talk to it.
    #[error(
        "{path}: permission denied (access is set by control.mode and control.group in the configuration of the daemon): {source}"
    )]
    Forbidden {
        /// The socket.
        path: PathBuf,
        /// The system's words.
        source: io::Error,
    },
    /// It is there and does not answer, or not as it should.
    #[error("{path}: the daemon does not respond: {what}")]
    Silent {
        /// The socket.
        path: PathBuf,
        /// What came instead.
        what: String,
    },
    /// It ended the connection instead.
    #[error("{path}: the daemon closed the connection; it may be busy with other clients")]
    HungUp {
        /// The socket.
        path: PathBuf,
    },
    /// It answers what is no reply of this version.
    #[error("{path}: unexpected response from the daemon: {what}; it may be a different version, check with `gimbald doctor`")]
    Unknown {
        /// The socket.
        path: PathBuf,
        /// What is wrong with the reply.
        what: String,
    },
    /// It refuses what was asked.
    #[error("{}", .0.error)]
    Refused(Refusal),
}

/// A way to a daemon.
#[derive(Debug)]
pub struct Connection {
    path: PathBuf,
    stream: BufReader<UnixStream>,
}

impl Connection {
    /// Connects to the daemon that listens at `path`.
    ///
    /// # Errors
    /// Where no daemon listens there.
    pub fn open(path: &Path) -> Result<Self, ClientError> {
        Ok(Self { path: path.into(), stream: connected(path)? })
    }

    /// The socket's path.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Asks one thing. Where the daemon is too busy, or has hung up since the last request, it is asked again a few times; what is
    /// asked twice has the same effect.
    ///
    /// # Errors
    /// Where no reply comes, and where the reply is a refusal.
    pub fn ask(&mut self, request: &Request) -> Result<Reply, ClientError> {
        for pause in PAUSES {
            match self.ask_once(request) {
                Err(ClientError::HungUp { .. }) => {}
                Err(ClientError::Refused(Refusal { kind: RefusalKind::Busy, .. })) => {}
                other => return other,
            }
            std::thread::sleep(pause);
            self.stream = connected(&self.path)?;
        }
        self.ask_once(request)
    }

    fn ask_once(&mut self, request: &Request) -> Result<Reply, ClientError> {
        let failed = |error: io::Error| match error.kind() {
            io::ErrorKind::BrokenPipe | io::ErrorKind::ConnectionReset => ClientError::HungUp { path: self.path.clone() },
            io::ErrorKind::WouldBlock => {
                ClientError::Silent { path: self.path.clone(), what: format!("no reply for {} s", TIMEOUT.as_secs()) }
            }
            _ => ClientError::Silent { path: self.path.clone(), what: error.to_string() },
        };
        let line = request.line() + "\n";
        let mut reply = String::new();
        let sent = self.stream.get_mut().write_all(line.as_bytes());
        // One who is dismissed has been told why, though nothing is taken of him any more.
        let read = self.stream.by_ref().take(LONGEST_REPLY).read_line(&mut reply);
        if !reply.ends_with('\n') {
            sent.map_err(failed)?;
            read.map_err(failed)?;
            return Err(ClientError::HungUp { path: self.path.clone() });
        }
        match Reply::read(&reply) {
            Ok(Reply::Refused(refusal)) => Err(ClientError::Refused(refusal)),
            Ok(reply) => Ok(reply),
            Err(what) => Err(self.other(&what)),
        }
    }

    /// Asks for the status.
    ///
    /// # Errors
    /// As [`Connection::ask`].
    pub fn status(&mut self) -> Result<Status, ClientError> {
        match self.ask(&Request::Status)? {
            Reply::Status { status } => Ok(*status),
            _ => Err(self.other("no status")),
        }
    }

    /// Asks for the metrics, in Prometheus' text format.
    ///
    /// # Errors
    /// As [`Connection::ask`].
    pub fn metrics(&mut self) -> Result<String, ClientError> {
        match self.ask(&Request::Prometheus)? {
            Reply::Metrics { text } => Ok(text),
            _ => Err(self.other("no metrics")),
        }
    }

    /// Asks for everything that is kept of the last frames, oldest first: about a minute.
    ///
    /// # Errors
    /// As [`Connection::ask`].
    pub fn history(&mut self) -> Result<Vec<FrameRecord>, ClientError> {
        let (mut first, mut frames) = (0, Vec::new());
        loop {
            let Reply::History { history } = self.ask(&Request::History(FrameNumber(first)))? else {
                return Err(self.other("no history"));
            };
            // Frames that are sent meanwhile need not be waited for.
            let is_last = history.frames.len() < 100 || history.next <= first;
            first = history.next;
            frames.extend(history.frames);
            if is_last {
                return Ok(frames);
            }
        }
    }

    /// Asks for a change: [`Request::On`], [`Request::Off`], [`Request::Set`] or [`Request::Reload`].
    ///
    /// # Errors
    /// As [`Connection::ask`].
    pub fn change(&mut self, request: &Request) -> Result<Applied, ClientError> {
        match self.ask(request)? {
            Reply::Applied(applied) => Ok(applied),
            _ => Err(self.other("no list of what changed")),
        }
    }

    fn other(&self, what: &str) -> ClientError {
        ClientError::Unknown { path: self.path.clone(), what: what.to_owned() }
    }
}

/// A connection on which nothing takes longer than [`TIMEOUT`], connecting included: a daemon that is stopped accepts no connection.
fn connected(path: &Path) -> Result<BufReader<UnixStream>, ClientError> {
    let made = || -> io::Result<UnixStream> {
        let socket = socket_with(AddressFamily::UNIX, SocketType::STREAM, SocketFlags::CLOEXEC, None)?;
        set_socket_timeout(&socket, Timeout::Send, Some(TIMEOUT))?;
        set_socket_timeout(&socket, Timeout::Recv, Some(TIMEOUT))?;
        connect(&socket, &SocketAddrUnix::new(path)?)?;
        Ok(UnixStream::from(socket))
    };
    made().map(BufReader::new).map_err(|source| match source.kind() {
        io::ErrorKind::PermissionDenied => ClientError::Forbidden { path: path.into(), source },
        io::ErrorKind::WouldBlock => ClientError::Silent { path: path.into(), what: "it does not accept connections".into() },
        _ => ClientError::NotRunning { path: path.into(), source },
    })
}
