//! The daemon's side: a thread that accepts companions, validates what they send, and counts their viewers.

use std::fs::{self, Permissions};
use std::io;
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use crossbeam_channel::{Sender, TrySendError, bounded};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::net::{AddressFamily, SocketAddrUnix, SocketFlags, SocketType, accept_with, bind, listen, socket_with};

use super::connection::Connection;
use super::lease::{Lease, Leases, Outlet};
use super::pair::Inspector;
use super::proof::CameraNode;
use super::wire::Format;
use crate::device::StreamFormat;
use crate::rt::notifier::Notifier;

/// The socket's name in a runtime directory.
const NAME: &str = "pictures.sock";

/// Maximum number of companions. Another one replaces the one that has been without a proof for longest.
const MAX_CONNECTIONS: usize = 8;

/// Connections accepted in a second, at most; others wait.
const MAX_ARRIVALS: u32 = 50;

/// How often the camera's node is looked for while a companion with viewers could not prove its access: it may have been plugged in.
const LOOK_FOR_CAMERA: Duration = Duration::from_secs(1);

/// Descriptors that wait to be closed, at most.
const MAX_CLOSING: usize = 64;

/// The viewers of pictures through companions: the daemon's handle to them. Clones are the same.
#[derive(Clone, Debug)]
pub struct Companions(Arc<Known>);

#[derive(Debug)]
struct Known {
    leases: Arc<Leases>,
    /// Notified on changes.
    notifier: Notifier,
    asked: Mutex<Asked>,
    connected: AtomicU32,
    watching: AtomicU32,
    pages: AtomicU32,
}

#[derive(Debug, Default)]
struct Asked {
    /// Size and interval; `None` until it is known what pictures there are.
    pictures: Option<(u32, u32, (u32, u32))>,
    /// The camera's node; empty where there is none.
    camera: PathBuf,
    /// The size that is held by readers of companions.
    held: Option<(u32, u32)>,
    /// Notified when the number of viewers changes.
    listener: Option<Notifier>,
}

impl Companions {
    fn new() -> io::Result<Self> {
        let (leases, notifier) = (Arc::default(), Notifier::new()?);
        let asked = Mutex::default();
        Ok(Self(Arc::new(Known {
            leases,
            notifier,
            asked,
            connected: AtomicU32::new(0),
            watching: AtomicU32::new(0),
            pages: AtomicU32::new(0),
        })))
    }

    fn asked(&self) -> MutexGuard<'_, Asked> {
        self.0.asked.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A way to give pictures of that size and rate to all companions, which are told of it.
    pub fn outlet(&self, format: &StreamFormat) -> Outlet {
        let format = StreamFormat::tight(format.width, format.height, super::PIXEL, format.interval);
        self.asked().pictures = Some((format.width, format.height, format.interval));
        self.0.notifier.notify();
        Outlet::new(self.0.leases.clone(), MAX_CONNECTIONS, format)
    }

    /// A way to give output, input and [`super::FrameInfo`] to companions that want them; `format` is that of [`Companions::outlet`].
    pub fn inspector(&self, format: &StreamFormat) -> Inspector {
        let format = StreamFormat::tight(format.width, format.height, super::PIXEL, format.interval);
        Inspector::new(self.0.leases.clone(), MAX_CONNECTIONS, format)
    }

    /// The camera's node is `path`: who proved something for another has to prove it again.
    pub fn camera_is(&self, path: &Path) {
        self.asked().camera = path.into();
        self.0.notifier.notify();
    }

    /// Companions that are connected.
    pub fn connected(&self) -> u32 {
        self.0.connected.load(Ordering::Relaxed)
    }

    /// Companions whose node a program watches, and pages, that may have the camera's pictures.
    pub fn watching(&self) -> u32 {
        self.0.watching.load(Ordering::Relaxed)
    }

    /// Of [`Companions::watching`], the pages of `gimbald view`.
    pub fn pages(&self) -> u32 {
        self.0.pages.load(Ordering::Relaxed)
    }

    /// Pictures that companions got, and pictures that one of them missed, since the beginning.
    pub fn counts(&self) -> (u64, u64) {
        self.0.leases.counts()
    }

    /// The size that a companion's readers hold, where they hold one.
    pub fn held_size(&self) -> Option<(u32, u32)> {
        self.asked().held
    }

    /// Notifies `notifier` whenever the number of [`Companions::watching`] changes; one notifier at a time.
    pub fn tell(&self, notifier: &Notifier) {
        self.asked().listener = Some(notifier.clone());
    }

    /// The state that companions are sent.
    fn format(&self) -> Option<Format> {
        let asked = self.asked();
        let (width, height, interval) = asked.pictures?;
        // One that the camera does not tell is not needed exactly: it is nominal.
        let interval = if interval.0 > 0 && interval.1 > 0 { interval } else { (1, 30) };
        Some(Format { width, height, interval, camera: asked.camera.clone() })
    }

    fn set(&self, connected: usize, watching: usize, pages: usize, held: Option<(u32, u32)>) {
        self.0.pages.store(pages as u32, Ordering::Relaxed);
        self.0.connected.store(connected as u32, Ordering::Relaxed);
        let changed = self.0.watching.swap(watching as u32, Ordering::Relaxed) != watching as u32;
        let mut asked = self.asked();
        asked.held = held;
        if changed && let Some(listener) = &asked.listener {
            listener.notify();
        }
    }
}

/// The socket at which companions connect.
#[derive(Debug)]
pub struct Server {
    listener: OwnedFd,
    path: PathBuf,
    /// Which file is ours: another daemon may have taken its name.
    file: (u64, u64),
    companions: Companions,
}

/// Where daemons have these sockets; each with its daemon's instance, which is empty for the one without a name. `runtime` is the
/// user's runtime directory.
pub fn socket_paths(runtime: Option<&Path>) -> Vec<(String, PathBuf)> {
    let mut found = Vec::new();
    for directory in [Some(Path::new("/run")), runtime].into_iter().flatten() {
        for entry in fs::read_dir(directory).into_iter().flatten().flatten() {
            let name = entry.file_name();
            let Some(rest) = name.to_str().and_then(|name| name.strip_prefix("gimbald")) else { continue };
            let instance = match rest.strip_prefix('-') {
                Some(instance) if !instance.is_empty() => instance,
                None if rest.is_empty() => "",
                _ => continue,
            };
            let path = entry.path().join(NAME);
            if path.exists() {
                found.push((instance.to_owned(), path));
            }
        }
    }
    found.sort();
    // A daemon that the user runs comes after the system's of the same name.
    found.dedup_by(|second, first| second.0 == first.0);
    found
}

impl Server {
    /// Listens in `directory`, the service's or user's runtime directory.
    ///
    /// # Errors
    /// What stands in the way, and what to do.
    pub fn open(directory: &Path) -> Result<Self, String> {
        let path = directory.join(NAME);
        let told = |what: &'static str| {
            let path = path.display().to_string();
            move |error: io::Error| format!("{path}: cannot {what}: {error}; output.pipewire = false disables this")
        };
        fs::create_dir_all(directory).map_err(told("make its directory"))?;
        // Made under a name of its own, then renamed: what was left there is replaced, and no companion finds a socket that refuses.
        let fresh = directory.join(format!("{NAME}.{}", std::process::id()));
        let _ = fs::remove_file(&fresh);
        let flags = SocketFlags::CLOEXEC | SocketFlags::NONBLOCK;
        let listener = socket_with(AddressFamily::UNIX, SocketType::SEQPACKET, flags, None);
        let listener = listener.map_err(io::Error::from).map_err(told("make a socket"))?;
        let address = SocketAddrUnix::new(&fresh).map_err(io::Error::from).map_err(told("listen there"))?;
        bind(&listener, &address).map_err(io::Error::from).map_err(told("listen there"))?;
        listen(&listener, 16).map_err(io::Error::from).map_err(told("listen there"))?;
        // Who may have pictures is not told by the file's mode but by the proof.
        fs::set_permissions(&fresh, Permissions::from_mode(0o666)).map_err(told("set its mode"))?;
        let there = fs::symlink_metadata(&fresh).map_err(told("inspect it"))?;
        fs::rename(&fresh, &path).map_err(told("give it its name"))?;
        let companions = Companions::new().map_err(told("make an event descriptor"))?;
        Ok(Self { listener, path, file: (there.dev(), there.ino()), companions })
    }

    /// Where it listens.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The connections.
    pub fn companions(&self) -> &Companions {
        &self.companions
    }

    /// Serves companions until `done` is notified. `locate` says where the camera is that would be opened, where none was open yet.
    pub fn serve(&self, done: &Notifier, locate: &dyn Fn() -> Option<PathBuf>) {
        let Some(closing) = Closing::start() else {
            tracing::warn!("no pictures for PipeWire: cannot start a thread");
            return;
        };
        let mut round = Round {
            server: self,
            closing,
            connections: Vec::new(),
            left: Vec::new(),
            format: None,
            camera: None,
            looked: Instant::now(),
            arrivals: (Instant::now(), 0),
        };
        while !done.clear() {
            round.step(done, locate);
        }
        self.companions.0.leases.change(Vec::clear);
        round.connections.into_iter().for_each(|connection| drop(connection.leave()));
        self.companions.set(0, 0, 0, None);
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        if fs::symlink_metadata(&self.path).is_ok_and(|there| (there.dev(), there.ino()) == self.file) {
            let _ = fs::remove_file(&self.path);
        }
    }
}

/// State of the server's thread.
struct Round<'a> {
    server: &'a Server,
    closing: Closing,
    connections: Vec<Connection>,
    /// Closed connections that the frame path may still use.
    left: Vec<Arc<Lease>>,
    format: Option<Format>,
    camera: Option<CameraNode>,
    looked: Instant,
    /// Connections of this second.
    arrivals: (Instant, u32),
}

impl Round<'_> {
    /// Waits for events and handles them.
    fn step(&mut self, done: &Notifier, locate: &dyn Fn() -> Option<PathBuf>) {
        let ready = self.wait(done);
        self.server.companions.0.notifier.clear();
        self.look_for_camera(locate);
        self.tell_changes();
        let (closing, camera, format) = (&self.closing, self.camera.as_ref(), self.format.as_ref());
        let mut gone = Vec::new();
        for (index, connection) in self.connections.iter_mut().enumerate() {
            let heard = ready.connections.get(index).copied().unwrap_or(false);
            if heard && let Err(why) = connection.handle_messages(camera, format, closing) {
                gone.push((index, why));
            }
        }
        for (index, why) in gone.into_iter().rev() {
            self.disconnect(index, &why);
        }
        if ready.listener {
            self.accept();
        }
        // The frame path releases those that disconnected with its next frame.
        let (free, still): (Vec<_>, Vec<_>) =
            std::mem::take(&mut self.left).into_iter().partition(|lease| Arc::strong_count(lease) == 1);
        self.left = still;
        free.into_iter().filter_map(Arc::into_inner).for_each(|lease| self.closing.close(lease.socket));
        self.account();
    }

    fn wait(&mut self, done: &Notifier) -> Ready {
        if self.arrivals.0.elapsed() >= Duration::from_secs(1) {
            self.arrivals = (Instant::now(), 0);
        }
        let crowded = self.arrivals.1 >= MAX_ARRIVALS;
        let mut fds = vec![
            PollFd::from_borrowed_fd(done.fd(), PollFlags::IN),
            PollFd::from_borrowed_fd(self.server.companions.0.notifier.fd(), PollFlags::IN),
            PollFd::from_borrowed_fd(self.server.listener.as_fd(), if crowded { PollFlags::empty() } else { PollFlags::IN }),
        ];
        fds.extend(
            self.connections.iter().map(|connection| PollFd::from_borrowed_fd(connection.lease.socket.as_fd(), PollFlags::IN)),
        );
        let waits = crowded || self.connections.iter().any(Connection::waits_for_proof) || !self.left.is_empty();
        let timeout = waits.then(|| Timespec::try_from(LOOK_FOR_CAMERA).ok()).flatten();
        if poll(&mut fds, timeout.as_ref()).is_err() {
            return Ready::default();
        }
        let readable = |fd: &PollFd<'_>| !fd.revents().is_empty();
        Ready { listener: readable(&fds[2]), connections: fds[3..].iter().map(readable).collect() }
    }

    /// Looks for the camera where a companion that is watched could prove nothing because it is not known where the camera is.
    fn look_for_camera(&mut self, locate: &dyn Fn() -> Option<PathBuf>) {
        let lost = self.camera.as_ref().is_none_or(|camera| CameraNode::at(&camera.path).as_ref() != Some(camera));
        if lost && self.connections.iter().any(Connection::waits_for_proof) && self.looked.elapsed() >= LOOK_FOR_CAMERA / 2 {
            self.looked = Instant::now();
            if let Some(path) = locate() {
                self.server.companions.camera_is(&path);
            }
        }
    }

    /// Tells all companions where the pictures or the camera have changed.
    fn tell_changes(&mut self) {
        let Some(format) = self.server.companions.format() else { return };
        let node = CameraNode::at(&format.camera);
        let same_camera = node == self.camera;
        if self.format.as_ref() == Some(&format) && same_camera {
            return;
        }
        for connection in &mut self.connections {
            connection.tell(&format, !same_camera);
        }
        (self.format, self.camera) = (Some(format), node);
    }

    fn accept(&mut self) {
        while self.arrivals.1 < MAX_ARRIVALS
            && let Ok(socket) = accept_with(&self.server.listener, SocketFlags::CLOEXEC | SocketFlags::NONBLOCK)
        {
            self.arrivals.1 += 1;
            if self.connections.len() >= MAX_CONNECTIONS {
                match self.connections.iter().position(|connection| !connection.is_proven()) {
                    Some(index) => self.disconnect(index, "another took its place"),
                    None => continue,
                }
            }
            if self.closing.is_stuck() {
                continue;
            }
            let mut connection = Connection::new(socket);
            if let Some(format) = &self.format {
                connection.tell(format, false);
            }
            let lease = connection.lease.clone();
            self.connections.push(connection);
            self.server.companions.0.leases.change(|all| all.push(lease));
            tracing::debug!("a companion has connected");
        }
    }

    fn disconnect(&mut self, index: usize, why: &str) {
        let connection = self.connections.remove(index);
        self.server.companions.0.leases.change(|all| all.retain(|lease| !Arc::ptr_eq(lease, &connection.lease)));
        let (sent, dropped) = (connection.lease.sent.load(Ordering::Relaxed), connection.lease.dropped.load(Ordering::Relaxed));
        if connection.is_proven() {
            tracing::info!(sent, dropped, "a PipeWire companion disconnected: {why}");
        } else {
            // Every user can connect and disconnect: that must not fill the log.
            tracing::debug!("a PipeWire companion disconnected: {why}");
        }
        self.left.push(connection.leave());
    }

    fn account(&self) {
        let watching = self.connections.iter().filter(|connection| connection.watches()).count();
        let held = self.connections.iter().find_map(Connection::held_size);
        let pages = self.connections.iter().filter(|connection| connection.is_page()).count();
        self.server.companions.set(self.connections.len(), watching, pages, held);
    }
}

/// Descriptors that are ready.
#[derive(Default)]
struct Ready {
    listener: bool,
    connections: Vec<bool>,
}

/// A thread that closes descriptors received from companions: closing one can take as long as its file system takes.
#[derive(Debug)]
pub(super) struct Closing(Sender<OwnedFd>);

impl Closing {
    pub(super) fn start() -> Option<Self> {
        let (sender, receiver) = bounded::<OwnedFd>(MAX_CLOSING);
        // Never joined: it may be stuck.
        let run = move || receiver.into_iter().for_each(drop);
        std::thread::Builder::new().name("closing".into()).spawn(run).ok().map(|_| Self(sender))
    }

    /// Closes it on that thread.
    pub(super) fn close(&self, fd: OwnedFd) {
        if let Err(TrySendError::Full(fd)) = self.0.try_send(fd) {
            // It stays open: there are few of these, as no connection is accepted meanwhile.
            std::mem::forget(fd);
        }
    }

    fn is_stuck(&self) -> bool {
        self.0.len() > MAX_CLOSING / 2
    }
}
