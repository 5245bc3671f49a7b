//! The thread of the control socket: one event loop over all connections, which never blocks on one of them.

use std::io;
use std::os::fd::{AsFd, BorrowedFd};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, unbounded};
use rustix::event::{PollFd, PollFlags, Timespec, poll};

use super::answer::answer;
use super::log_limiter::Subject;
use super::quotas::Quotas;
use super::reload::Reloaded;
use super::session::{At, Peer, Session, dismiss};
use super::token_bucket::TokenBucket;
use super::{BoundSocket, DaemonState, Limits, RefusalKind, Reply, Request, socket};
use crate::config::Control;
use crate::rt::notifier::Notifier;

/// After a failure to accept a connection (no descriptor left), none is accepted for this long.
const REST: Duration = Duration::from_millis(200);
/// Connections that are accepted in a row before existing ones are served again.
const ACCEPTED_AT_ONCE: usize = 16;

/// Where clients connect.
#[derive(Debug)]
pub struct Server {
    place: BoundSocket,
    limits: Limits,
    /// Notified when the configuration has been read.
    reloaded: Notifier,
}

impl Server {
    /// Listens where the settings say. Failures are logged and not fatal: a service without a socket is better than none. `service` is
    /// the service's runtime directory. `None` where there is no socket.
    pub fn open(settings: &Control, service: Option<PathBuf>) -> Option<Self> {
        let path = match settings.socket.as_str() {
            "off" => return None,
            "auto" => socket::own_path(service.as_deref()),
            path => Some(PathBuf::from(path)),
        };
        let Some(path) = path else {
            tracing::info!(
                "control socket disabled: neither RUNTIME_DIRECTORY nor XDG_RUNTIME_DIR is set; set control.socket to a path to enable it"
            );
            return None;
        };
        let group = Some(settings.group.as_str()).filter(|group| *group != "own");
        let place = BoundSocket::bind(&path, settings.mode_bits(), group);
        let server = place.and_then(|place| Self::new(place, Limits::default()).map_err(|error| error.to_string()));
        match server {
            Ok(server) => {
                tracing::info!("listening on {}", path.display());
                Some(server)
            }
            Err(what) => {
                tracing::warn!("control socket disabled: {what}");
                None
            }
        }
    }

    /// A server with limits of its own, for tests and other programs.
    ///
    /// # Errors
    /// Where the process has no descriptor left.
    pub fn new(place: BoundSocket, limits: Limits) -> io::Result<Self> {
        Ok(Self { place, limits, reloaded: Notifier::new()? })
    }

    /// Answers until `done` is notified.
    pub fn serve(&self, state: &Arc<DaemonState>, done: &Notifier) {
        let (sender, reloaded) = unbounded();
        state.reloads.listen(sender, self.reloaded.clone());
        let now = Instant::now();
        let mut serving = Serving {
            server: self,
            state,
            reloaded,
            quotas: Quotas::new(&self.limits, now),
            accepted: TokenBucket::new(self.limits.accepted, now),
            sessions: Vec::new(),
            resting: None,
        };
        while let Some(ready) = serving.wait(done) {
            let now = Instant::now();
            serving.talk(&ready.sessions, now);
            if ready.newcomers {
                serving.accept(now);
            }
            serving.tell_reloaded(now);
            serving.answer(now);
            serving.end_late(now);
            state.flush_log_limiter(now);
        }
    }
}

/// Descriptors that are ready.
#[derive(Default)]
struct Ready {
    newcomers: bool,
    /// For each session.
    sessions: Vec<bool>,
}

/// State of the event loop.
struct Serving<'a> {
    server: &'a Server,
    state: &'a Arc<DaemonState>,
    reloaded: Receiver<Reloaded>,
    quotas: Quotas,
    accepted: TokenBucket,
    sessions: Vec<Session>,
    /// No connection is accepted before this time.
    resting: Option<Instant>,
}

impl Serving<'_> {
    /// Waits until a descriptor is ready; `None` when the server is to stop.
    fn wait(&mut self, done: &Notifier) -> Option<Ready> {
        let now = Instant::now();
        self.resting = self.resting.filter(|until| *until > now);
        let accepts = self.resting.is_none() && self.accepted.has(now);
        let mut fds = vec![
            PollFd::from_borrowed_fd(done.fd(), PollFlags::IN),
            PollFd::from_borrowed_fd(self.server.reloaded.fd(), PollFlags::IN),
        ];
        let listener: BorrowedFd<'_> = self.server.place.listener.as_fd();
        if accepts {
            fds.push(PollFd::from_borrowed_fd(listener, PollFlags::IN));
        }
        let first = fds.len();
        let wishes = self.sessions.iter().map(Session::wish).collect::<Vec<_>>();
        fds.extend(wishes.iter().flatten().map(|&(fd, wish)| PollFd::from_borrowed_fd(fd, wish)));
        let timeout = self.timeout(now, accepts).and_then(|timeout| Timespec::try_from(timeout).ok());
        match poll(&mut fds, timeout.as_ref()) {
            Ok(_) | Err(rustix::io::Errno::INTR) => {}
            // Nothing that waiting helps against, and nothing to spin on.
            Err(_) => return if done.wait(REST) { None } else { Some(Ready::default()) },
        }
        let readable: Vec<bool> = fds.iter().map(|fd| !fd.revents().is_empty()).collect();
        let mut of_sessions = readable[first..].iter();
        let sessions = wishes.iter().map(|wish| wish.is_some() && of_sessions.next() == Some(&true)).collect();
        if done.clear() {
            return None;
        }
        self.server.reloaded.clear();
        Some(Ready { newcomers: accepts && readable[2], sessions })
    }

    /// Time until the next timeout; `None` where there is none.
    fn timeout(&self, now: Instant, accepts: bool) -> Option<Duration> {
        let left = |at: Instant| at.saturating_duration_since(now);
        let sessions = self.sessions.iter().filter_map(|session| match session.at() {
            At::Ready => Some(self.quotas.wait(session, now)),
            _ => session.time_limit(&self.server.limits).map(|limit| left(session.since() + limit)),
        });
        let accepting = if accepts { None } else { Some(self.resting.map_or_else(|| self.accepted.wait(now), left)) };
        let soonest = sessions.chain(accepting).chain(self.state.log_limiter_due().map(left)).min()?;
        // Rounded up to what poll() counts in, so that it is over when the wait is.
        Some(if soonest.is_zero() { soonest } else { soonest + Duration::from_millis(1) })
    }

    /// Reads and writes as much as possible without blocking.
    fn talk(&mut self, ready: &[bool], now: Instant) {
        let mut ready = ready.iter();
        self.sessions.retain_mut(|session| ready.next() != Some(&true) || session.talk(now));
    }

    /// Accepts pending connections. A process that connects too often gets an error and is not served.
    fn accept(&mut self, now: Instant) {
        for _ in 0..ACCEPTED_AT_ONCE {
            if !self.accepted.has(now) {
                return;
            }
            let stream = match self.server.place.listener.accept() {
                Ok((stream, _)) => stream,
                Err(error) => {
                    use io::ErrorKind::{ConnectionAborted, Interrupted, WouldBlock};
                    if !matches!(error.kind(), WouldBlock | Interrupted | ConnectionAborted) {
                        self.resting = Some(now + REST);
                    }
                    return;
                }
            };
            self.accepted.take(now);
            let peer = Peer::of(&stream);
            if !self.quotas.connect(peer, now) {
                dismiss(&stream, &busy("too many connections from this process"));
                self.log_limited(now, || tracing::warn!("refused a connection from {peer}: too many connections"));
                continue;
            }
            if let Some(displaced) = self.quotas.displaced(&self.sessions, peer, now) {
                let session = self.sessions.swap_remove(displaced);
                session.dismiss(&busy("the connection was closed in favour of another client"));
                self.log_limited(now, || tracing::warn!("closed a connection of {} to accept {peer}", session.peer));
            }
            self.sessions.extend(Session::new(stream, peer, &self.server.limits, now));
        }
    }

    /// Sends the result to clients that wait for the configuration to be read.
    fn tell_reloaded(&mut self, now: Instant) {
        while let Ok(Reloaded { ticket, result }) = self.reloaded.try_recv() {
            let reply = match result {
                Ok(applied) => Reply::Applied(applied),
                Err(error) => Reply::refused(RefusalKind::Configuration, error),
            };
            self.sessions.retain_mut(|session| !session.has_awaited(ticket) || session.reply(&reply, now));
        }
    }

    /// Answers one request of each session within its quotas, those with the fewest requests first.
    fn answer(&mut self, now: Instant) {
        let mut over = Vec::new();
        for index in self.quotas.order(&self.sessions, now) {
            let session = &mut self.sessions[index];
            if !self.quotas.wait(session, now).is_zero() {
                continue;
            }
            self.quotas.charge(session, now);
            let Some(line) = session.take_line(now) else { continue };
            let stays = match Request::read(&line) {
                Ok(Request::Reload) => {
                    session.await_reload(self.state.reload_soon(false), now);
                    true
                }
                Ok(request) => session.reply(&answer(&request, self.state, &session.peer.to_string()), now),
                Err(error) => session.reply(&Reply::Refused(error.into()), now),
            };
            if !stays {
                over.push(index);
            }
        }
        let mut index = 0;
        self.sessions.retain(|_| {
            index += 1;
            !over.contains(&(index - 1))
        });
    }

    /// Closes connections that time out, and answers clients whose reload takes too long.
    fn end_late(&mut self, now: Instant) {
        let limits = &self.server.limits;
        self.sessions.retain_mut(|session| {
            let limit = session.time_limit(limits);
            if limit.is_none_or(|limit| now.saturating_duration_since(session.since()) < limit) {
                return true;
            }
            let what = "the configuration file is still being read; it will be applied when that is done, see the log";
            session.has_awaited(u64::MAX) && session.reply(&Reply::refused(RefusalKind::Late, what), now)
        });
    }

    fn log_limited(&self, now: Instant, line: impl FnOnce()) {
        if self.state.may_log(Subject::Connection, now) {
            line();
        }
    }
}

fn busy(what: &str) -> Reply {
    Reply::refused(RefusalKind::Busy, format!("busy: {what}; try again in a moment"))
}
