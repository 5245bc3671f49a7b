//! The thread that answers: one loop over all who talk, none of whom it ever waits for.

use std::io::{self, ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::net::UnixStream;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use rustix::event::{PollFd, PollFlags, Timespec, poll};

use super::request::{LONGEST_REQUEST, answer};
use super::{Desk, Place, exposition, socket};
use crate::config::Control;
use crate::rt::wake::Wake;

/// Who is told what, and how long one may take.
#[derive(Clone, Copy, Debug)]
pub struct Rules {
    /// How many may talk at a time; who comes then takes the place of the one who has been silent longest.
    pub most_clients: usize,
    /// Who neither asks anything whole nor takes an answer for this long is hung up on.
    pub patience: Duration,
    /// Answers in a second, at most; who asks more waits. So nobody takes the processor away from the picture by asking.
    pub most_answers: u32,
}

impl Default for Rules {
    fn default() -> Self {
        Self { most_clients: 16, patience: Duration::from_secs(60), most_answers: 500 }
    }
}

/// Bytes of answers that wait to be taken, before more is answered.
const ENOUGH: usize = 1 << 14;
const SECOND: Duration = Duration::from_secs(1);
/// Bytes of an HTTP request's head, at most.
const LONGEST_HEAD: usize = 8192;
/// After a failure to take somebody in (no descriptor left), nobody is taken in for so long.
const REST: Duration = Duration::from_millis(200);

/// Where people are listened to.
#[derive(Debug)]
pub struct Server {
    place: Option<Place>,
    metrics: Option<TcpListener>,
    rules: Rules,
}

impl Server {
    /// Listens where the settings say, on the socket and for Prometheus. What cannot be is told in the log: a picture without a
    /// socket is better than none. `service` is the service's runtime directory. `None` where nobody is listened to.
    pub fn open(settings: &Control, listen: &str, service: Option<PathBuf>) -> Option<Self> {
        let path = match settings.socket.as_str() {
            "off" => None,
            "auto" => socket::own_path(service.as_deref()),
            path => Some(PathBuf::from(path)),
        };
        let group = Some(settings.group.as_str()).filter(|group| *group != "own");
        let place = path.and_then(|path| match Place::take(&path, settings.mode_bits(), group) {
            Ok(place) => {
                tracing::info!("listening on {}", place.path().display());
                Some(place)
            }
            Err(what) => {
                tracing::warn!("no control socket: {what}");
                None
            }
        });
        let metrics = listen.parse().ok().and_then(|address: SocketAddr| match loopback_listener(address) {
            Ok(listener) => {
                tracing::info!("metrics for Prometheus on http://{address}/metrics");
                Some(listener)
            }
            Err(error) => {
                tracing::warn!(
                    "no metrics: cannot listen on {address}: {error}; correct metrics.listen, or let the service have a network"
                );
                None
            }
        });
        (place.is_some() || metrics.is_some()).then_some(Self { place, metrics, rules: Rules::default() })
    }

    /// A server of one socket, for tests and other programs.
    pub fn new(place: Place, metrics: Option<TcpListener>, rules: Rules) -> io::Result<Self> {
        metrics.iter().try_for_each(|listener| listener.set_nonblocking(true))?;
        Ok(Self { place: Some(place), metrics, rules })
    }

    /// Answers until `done` rings.
    pub fn serve(&self, desk: &Desk, done: &Wake) {
        let mut clients: Vec<Client> = Vec::new();
        let mut resting: Option<Instant> = None;
        let (mut second, mut answered) = (Instant::now(), 0);
        loop {
            if answered >= self.rules.most_answers && done.wait(SECOND.saturating_sub(second.elapsed())) {
                return;
            }
            if second.elapsed() >= SECOND {
                (second, answered) = (Instant::now(), 0);
            }
            let resting_left = resting.map(|until| until.saturating_duration_since(Instant::now()));
            resting = resting.filter(|until| *until > Instant::now());
            let ready = self.wait(&clients, done, resting_left);
            if done.hush() {
                return;
            }
            let Ok(Ready { socket, metrics, talking }) = ready else { continue };
            let mut index = 0;
            clients.retain_mut(|client| {
                let active = talking.get(index).copied().unwrap_or_default();
                index += 1;
                let stays = if active { client.talk(desk, &mut answered) } else { true };
                stays && client.since.elapsed() < self.rules.patience
            });
            let failed = (socket && !self.take_in(&mut clients)) || (metrics && !self.take_in_http(&mut clients));
            if failed {
                resting = Some(Instant::now() + REST);
            }
        }
    }

    /// Waits until somebody wants something, or somebody's patience is over.
    fn wait(&self, clients: &[Client], done: &Wake, resting: Option<Duration>) -> io::Result<Ready> {
        let mut fds = vec![PollFd::from_borrowed_fd(done.fd(), PollFlags::IN)];
        let listening = resting.is_none_or(|left| left.is_zero());
        let listened: [Option<BorrowedFd<'_>>; 2] =
            [self.place.as_ref().map(|place| place.listener.as_fd()), self.metrics.as_ref().map(AsFd::as_fd)];
        let mut at = [None; 2];
        for (at, fd) in at.iter_mut().zip(listened.into_iter().map(|fd| fd.filter(|_| listening))) {
            if let Some(fd) = fd {
                *at = Some(fds.len());
                fds.push(PollFd::from_borrowed_fd(fd, PollFlags::IN));
            }
        }
        let first = fds.len();
        for client in clients {
            let wish = if client.output.is_empty() { PollFlags::IN } else { PollFlags::OUT };
            fds.push(PollFd::from_borrowed_fd(client.stream.fd(), wish));
        }
        let patience = clients.iter().map(|client| self.rules.patience.saturating_sub(client.since.elapsed()));
        let patience = patience.chain(resting).min();
        // not before it is over
        let patience = patience.map(|patience| patience + Duration::from_millis(1));
        let patience = patience.and_then(|patience| Timespec::try_from(patience).ok());
        match poll(&mut fds, patience.as_ref()) {
            Ok(_) | Err(rustix::io::Errno::INTR) => {}
            Err(error) => {
                // Nothing that waiting helps against, and nothing to spin on.
                done.wait(REST);
                return Err(error.into());
            }
        }
        let rang = |at: &Option<usize>| at.is_some_and(|at| !fds[at].revents().is_empty());
        let talking = fds[first..].iter().map(|fd| !fd.revents().is_empty()).collect();
        Ok(Ready { socket: rang(&at[0]), metrics: rang(&at[1]), talking })
    }

    /// Takes in who knocks at the socket; false where that cannot be done now.
    fn take_in(&self, clients: &mut Vec<Client>) -> bool {
        let Some(place) = &self.place else { return true };
        match place.listener.accept() {
            Ok((stream, _)) => {
                let who = rustix::net::sockopt::socket_peercred(&stream)
                    .map_or_else(|_| "somebody".into(), |who| format!("uid {}", who.uid.as_raw()));
                self.welcome(Stream::Unix(stream), who, clients);
                true
            }
            Err(error) => is_passing(&error),
        }
    }

    fn take_in_http(&self, clients: &mut Vec<Client>) -> bool {
        match self.metrics.as_ref().map(TcpListener::accept) {
            Some(Ok((stream, address))) => {
                self.welcome(Stream::Tcp(stream), address.to_string(), clients);
                true
            }
            Some(Err(error)) => is_passing(&error),
            None => true,
        }
    }

    fn welcome(&self, stream: Stream, who: String, clients: &mut Vec<Client>) {
        if stream.set_nonblocking().is_err() {
            return;
        }
        if clients.len() >= self.rules.most_clients
            && let Some(longest) = (0..clients.len()).min_by_key(|&i| clients[i].since)
        {
            clients.remove(longest);
        }
        clients.push(Client { stream, who, input: Vec::new(), output: Vec::new(), last: false, since: Instant::now() });
    }
}

/// A listener on a loopback address, which never makes anybody wait.
fn loopback_listener(address: SocketAddr) -> io::Result<TcpListener> {
    let listener = TcpListener::bind(address)?;
    listener.set_nonblocking(true)?;
    Ok(listener)
}

/// Whether who knocked has gone away again, or was a mistake of the moment.
fn is_passing(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted | ErrorKind::ConnectionAborted)
}

/// Who wants something.
struct Ready {
    socket: bool,
    metrics: bool,
    talking: Vec<bool>,
}

#[derive(Debug)]
enum Stream {
    Unix(UnixStream),
    /// Speaks HTTP.
    Tcp(TcpStream),
}

impl Stream {
    fn fd(&self) -> BorrowedFd<'_> {
        match self {
            Self::Unix(stream) => stream.as_fd(),
            Self::Tcp(stream) => stream.as_fd(),
        }
    }

    fn set_nonblocking(&self) -> io::Result<()> {
        match self {
            Self::Unix(stream) => stream.set_nonblocking(true),
            Self::Tcp(stream) => stream.set_nonblocking(true),
        }
    }

    fn read(&mut self, to: &mut [u8]) -> io::Result<usize> {
        match self {
            Self::Unix(stream) => stream.read(to),
            Self::Tcp(stream) => stream.read(to),
        }
    }

    fn write(&mut self, from: &[u8]) -> io::Result<usize> {
        match self {
            Self::Unix(stream) => stream.write(from),
            Self::Tcp(stream) => stream.write(from),
        }
    }
}

/// Somebody who talks. While an answer waits to be taken, nothing more is read: so nobody makes it grow.
#[derive(Debug)]
struct Client {
    stream: Stream,
    who: String,
    input: Vec<u8>,
    output: Vec<u8>,
    /// After this answer there is nothing more to say.
    last: bool,
    /// The last whole request or progress of an answer.
    since: Instant,
}

impl Client {
    /// Takes and gives what goes at once; false when it is over.
    fn talk(&mut self, desk: &Desk, answered: &mut u32) -> bool {
        if self.output.is_empty() {
            let mut buffer = [0; 2048];
            match self.stream.read(&mut buffer) {
                Ok(0) => return false,
                Ok(read) => self.input.extend_from_slice(&buffer[..read]),
                Err(error) => return matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted),
            }
        }
        loop {
            if self.output.is_empty() {
                match self.stream {
                    Stream::Unix(_) => self.hear_lines(desk, answered),
                    Stream::Tcp(_) => self.hear_http(desk, answered),
                }
            }
            // nothing whole was heard, or it is not taken now
            if self.output.is_empty() {
                return true;
            }
            if !self.give() {
                return false;
            }
            if !self.output.is_empty() {
                return true;
            }
        }
    }

    /// Gives what is taken at once; false when it is over.
    fn give(&mut self) -> bool {
        match self.stream.write(&self.output) {
            Ok(0) => return false,
            Ok(written) => {
                self.output.drain(..written);
                self.since = Instant::now();
            }
            Err(error) => return matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted),
        }
        !(self.last && self.output.is_empty())
    }

    /// Answers the whole lines that were heard, until there is enough to give.
    fn hear_lines(&mut self, desk: &Desk, answered: &mut u32) {
        let mut begin = 0;
        while self.output.len() < ENOUGH
            && let Some(length) = self.input[begin..].iter().position(|byte| *byte == b'\n')
        {
            let reply = answer(&self.input[begin..begin + length], desk, &self.who);
            self.output.extend_from_slice(reply.as_bytes());
            self.output.push(b'\n');
            begin += length + 1;
            *answered = answered.saturating_add(1);
            self.since = Instant::now();
        }
        self.input.drain(..begin);
        if self.input.len() > LONGEST_REQUEST && !self.input.contains(&b'\n') {
            let what = format!("{{\"ok\":false,\"error\":\"a request has at most {LONGEST_REQUEST} bytes\"}}\n");
            self.output.extend_from_slice(what.as_bytes());
            self.input.clear();
            self.last = true;
        }
    }

    /// Answers a GET with the metrics, once.
    fn hear_http(&mut self, desk: &Desk, answered: &mut u32) {
        let ended = self.input.windows(4).any(|end| end == b"\r\n\r\n") || self.input.windows(2).any(|end| end == b"\n\n");
        if !ended && self.input.len() < LONGEST_HEAD {
            return;
        }
        *answered = answered.saturating_add(1);
        let asked = self.input.split(|byte| byte.is_ascii_whitespace()).take(2).collect::<Vec<_>>();
        let (state, media, body) = match asked.as_slice() {
            [b"GET", b"/metrics" | b"/"] if ended => {
                ("200 OK", exposition::MEDIA_TYPE, exposition::text(&desk.status(), &desk.tally))
            }
            [b"GET", _] if ended => ("404 Not Found", "text/plain", "metrics are at /metrics\n".to_owned()),
            _ => ("400 Bad Request", "text/plain", "GET /metrics\n".to_owned()),
        };
        let length = body.len();
        let head =
            format!("HTTP/1.1 {state}\r\nContent-Type: {media}\r\nContent-Length: {length}\r\nConnection: close\r\n\r\n");
        self.output = (head + &body).into_bytes();
        self.input.clear();
        self.last = true;
    }
}
