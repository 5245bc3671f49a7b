//! A daemon as a [`Backend`]: pictures through the socket for companions, state and settings through the control socket.
//!
//! Pictures are requested only while a page is open: an open page counts as a viewer, and opens the camera. For each picture that is
//! shown, the daemon copies output and input to memory that this process lends; everything else is done in this process.

use std::fs::OpenOptions;
use std::io;
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::OFlags;
use serde_json::{Value, json};

use super::backend::Backend;
use super::preview::{self, Cursor, INTERVAL, Preview, PreviewFeed};
use crate::config::{Key, Settings, keys};
use crate::control::{Assignment, Connection, Request, Status};
use crate::device::{RawFrame, StreamFormat};
use crate::frame::Stamp;
use crate::image::Picture;
use crate::pipeline::Decoder;
use crate::report::PairEncoder;
use crate::rt::stop::Stop;
use crate::share::{self, Client, Format, Heard, Pair, Refusal};

/// A page that has requested no picture for this long is closed.
const CLOSED: Duration = Duration::from_secs(3);
/// Pause before the next attempt to reach the daemon, and between checks whether a page is open.
const RETRY: Duration = Duration::from_millis(200);
/// Pause before pictures are requested again that were refused.
const REQUEST_AGAIN: Duration = Duration::from_secs(1);
/// A status of this age is still shown.
const STATUS_AGE: Duration = Duration::from_millis(200);

/// Connects to the daemon's control socket.
pub type Connect = Box<dyn Fn() -> Result<Connection, String> + Send + Sync>;

/// A running daemon.
pub struct DaemonBackend {
    name: String,
    connect: Connect,
    /// The socket for pictures.
    pictures: PathBuf,
    configuration: Option<PathBuf>,
    preview: PreviewFeed,
    widest: usize,
    control: Mutex<Control>,
    /// Why there are no pictures, for users; empty while there are.
    problem: Mutex<String>,
}

impl std::fmt::Debug for DaemonBackend {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("DaemonBackend").field("name", &self.name).finish_non_exhaustive()
    }
}

#[derive(Default)]
struct Control {
    connection: Option<Connection>,
    status: Option<(Instant, Result<Status, String>)>,
}

impl DaemonBackend {
    /// The daemon `name` that `connect` connects to. `pictures` is its socket for pictures, `configuration` its file where it is known; a
    /// daemon that reports its file needs none.
    pub fn new(name: String, connect: Connect, pictures: PathBuf, configuration: Option<PathBuf>) -> Self {
        let (preview, control, problem) = (PreviewFeed::default(), Mutex::default(), Mutex::default());
        Self { name, connect, pictures, configuration, preview, widest: preview::WIDEST, control, problem }
    }

    /// The same with pictures of at most `widest` pixels' width.
    pub fn with_widest(self, widest: usize) -> Self {
        Self { widest, ..self }
    }

    /// Fetches pictures while a page is open, until `stop` is set.
    pub fn run(&self, stop: &Stop) {
        while !stop.is_set() {
            if self.preview.is_wanted(CLOSED) {
                let ended = PictureStream::open(&self.pictures, self.widest).and_then(|mut stream| stream.run(self, stop));
                if let Err(error) = ended {
                    self.set_problem(match error.kind() {
                        io::ErrorKind::NotFound | io::ErrorKind::ConnectionRefused => {
                            "no pictures: the daemon is not running, or its configuration has output.pipewire = false".into()
                        }
                        _ => format!("no pictures: {error}"),
                    });
                }
            }
            std::thread::sleep(RETRY);
        }
    }

    /// Why there are no pictures, for users; empty while there are.
    pub(super) fn problem(&self) -> String {
        self.problem.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    fn set_problem(&self, problem: String) {
        *self.problem.lock().unwrap_or_else(PoisonError::into_inner) = problem;
    }

    fn control(&self) -> MutexGuard<'_, Control> {
        self.control.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Sends a request. The connection is opened where there is none, and closed after a failure.
    fn request<T>(
        &self,
        control: &mut Control,
        request: impl FnOnce(&mut Connection) -> Result<T, String>,
    ) -> Result<T, String> {
        if control.connection.is_none() {
            control.connection = Some((self.connect)()?);
        }
        let Some(connection) = &mut control.connection else { return Err("no connection".into()) };
        let answer = request(connection);
        if answer.is_err() {
            control.connection = None;
        }
        answer
    }

    fn status(&self) -> Result<Status, String> {
        let mut control = self.control();
        if let Some((when, status)) = &control.status
            && when.elapsed() < STATUS_AGE
        {
            return status.clone();
        }
        let status = self.request(&mut control, |connection| connection.status().map_err(|error| error.to_string()));
        control.status = Some((Instant::now(), status.clone()));
        status
    }
}

impl Backend for DaemonBackend {
    fn name(&self) -> String {
        self.name.clone()
    }

    fn is_recording(&self) -> bool {
        false
    }

    fn is_live(&self, key: &Key) -> bool {
        key.live
    }

    fn preview(&self, seen: Cursor, timeout: Duration) -> Option<Arc<Preview>> {
        self.preview.next(seen, timeout)
    }

    fn state(&self) -> Value {
        let problem = self.problem();
        match self.status() {
            Ok(status) => json!({"status": status, "problem": problem}),
            Err(error) => json!({"error": error, "problem": problem}),
        }
    }

    fn settings(&self) -> Result<Settings, String> {
        let status = self.status()?;
        // Keys that this program does not know are of another version.
        let known = status.settings.iter().filter(|(name, _)| keys::find(name).is_some());
        let sets: Vec<String> = known.map(|(name, value)| format!("{name}={value}")).collect();
        Settings::read(None, &sets).map_err(|faults| faults.to_string())
    }

    fn set(&self, assignment: &str) -> Result<(), String> {
        let assignment: Assignment = assignment.parse()?;
        let mut control = self.control();
        control.status = None;
        self.request(&mut control, |connection| {
            connection.change(&Request::Set(assignment)).map_err(|error| error.to_string())
        })?;
        Ok(())
    }

    fn play(&self, _: &str) -> Result<(), String> {
        Err("only a recording can be played and paused".into())
    }

    fn configuration(&self) -> Option<PathBuf> {
        let reported = self.status().ok().and_then(|status| status.configuration).map(PathBuf::from);
        self.configuration.clone().or(reported)
    }
}

/// A connection that pictures arrive on.
struct PictureStream {
    client: Client,
    format: Option<Format>,
    /// The camera's node, opened: the proof that this user may see its pictures; or why it cannot be opened.
    proof: Result<OwnedFd, io::ErrorKind>,
    /// The one piece of memory that is lent, and its number. A new size needs a new one.
    lent: Option<(u64, Pair)>,
    /// The daemon has drawn into the memory. It is freed when the next picture is due: this limits the rate at which the daemon draws.
    is_drawn: bool,
    due: Instant,
    request_due: Option<Instant>,
    last: Option<u64>,
    encoder: PairEncoder,
    decoder: Decoder,
    pictures: [Picture; 2],
}

impl PictureStream {
    fn open(path: &Path, widest: usize) -> io::Result<Self> {
        Ok(Self {
            client: Client::connect(path)?,
            format: None,
            proof: Err(io::ErrorKind::NotFound),
            lent: None,
            is_drawn: false,
            due: Instant::now(),
            request_due: None,
            last: None,
            encoder: preview::encoder(widest).map_err(io::Error::other)?,
            decoder: Decoder::default(),
            pictures: Default::default(),
        })
    }

    /// Receives pictures until no page is open or the daemon disconnects.
    fn run(&mut self, backend: &DaemonBackend, stop: &Stop) -> io::Result<()> {
        backend.set_problem("waiting for the first picture".into());
        while !stop.is_set() && backend.preview.is_wanted(CLOSED) {
            self.wait();
            while let Some(heard) = self.client.receive()? {
                match heard {
                    Heard::Format(format) => self.set_format(format, backend)?,
                    Heard::Frame { id, .. } => self.publish(id, backend)?,
                    Heard::Refused(refusal) => {
                        backend.set_problem(self.text_of(refusal));
                        self.request_due = Some(Instant::now() + REQUEST_AGAIN);
                    }
                }
            }
            let now = Instant::now();
            if let Some((id, _)) = self.lent
                && self.is_drawn
                && now >= self.due
            {
                self.is_drawn = false;
                self.client.free(id)?;
            }
            if self.request_due.is_some_and(|due| now >= due) {
                self.request_pictures()?;
            }
        }
        Ok(())
    }

    fn wait(&self) {
        let now = Instant::now();
        let due = [self.is_drawn.then_some(self.due), self.request_due].into_iter().flatten().min();
        let left = due.map_or(RETRY, |due| due.saturating_duration_since(now).min(RETRY));
        let mut fds = [PollFd::from_borrowed_fd(self.client.fd(), PollFlags::IN)];
        // A signal that interrupts it is like a timeout.
        let _ = poll(&mut fds, Timespec::try_from(left).ok().as_ref());
    }

    /// The daemon reports size and camera: memory of this size is lent to it.
    fn set_format(&mut self, format: Format, backend: &DaemonBackend) -> io::Result<()> {
        let (width, height) = (format.width, format.height);
        let same_size = self.format.as_ref().is_some_and(|old| (old.width, old.height) == (width, height));
        self.format = Some(format);
        self.request_pictures()?;
        if same_size {
            return Ok(());
        }
        let before = self.lent.take().map(|(id, _)| id);
        if let Some(id) = before {
            self.client.revoke(id)?;
        }
        let (pair, memory) = Pair::new(width, height)?;
        let id = before.map_or(1, |id| id + 1);
        self.client.lend(id, memory.as_fd())?;
        self.client.free(id)?;
        (self.lent, self.is_drawn) = (Some((id, pair)), false);
        self.last = None;
        backend.preview.restart();
        Ok(())
    }

    /// Requests pictures, with the proof that this user may see the camera.
    fn request_pictures(&mut self) -> io::Result<()> {
        self.request_due = None;
        let Some(format) = &self.format else { return Ok(()) };
        let flags = (OFlags::NONBLOCK | OFlags::NOCTTY).bits().cast_signed();
        let opened = OpenOptions::new().read(true).write(true).custom_flags(flags).open(&format.camera);
        self.proof = opened.map(OwnedFd::from).map_err(|error| error.kind());
        self.client.watch_both((format.width, format.height), self.proof.as_ref().ok().map(AsFd::as_fd))
    }

    fn text_of(&self, refusal: Refusal) -> String {
        match refusal {
            Refusal::Size => "no pictures: programs that use the camera need another size".into(),
            Refusal::Proof => match self.format.as_ref().map(|format| &format.camera) {
                Some(camera) if camera.as_os_str().is_empty() => "waiting for the camera".into(),
                Some(camera) => match self.proof {
                    Ok(_) => "waiting for the camera".into(),
                    Err(io::ErrorKind::PermissionDenied) => {
                        format!(
                            "no pictures: permission denied for {}; members of the group video may open it",
                            camera.display()
                        )
                    }
                    Err(why) => format!("no pictures: the camera {} cannot be opened: {why}", camera.display()),
                },
                None => "waiting for the camera".into(),
            },
        }
    }

    /// The daemon has drawn into the memory of number `id`: the pages get it.
    fn publish(&mut self, id: u64, backend: &DaemonBackend) -> io::Result<()> {
        let Some((_, pair)) = self.lent.as_ref().filter(|(lent, _)| *lent == id) else { return Ok(()) };
        let Some(Format { width, height, interval, .. }) = self.format else { return Ok(()) };
        let format = StreamFormat::tight(width, height, share::PIXEL, interval);
        for (bytes, picture) in [pair.output(), pair.input()].into_iter().zip(&mut self.pictures) {
            let raw = RawFrame { format, bytes, stamp: Stamp::default() };
            self.decoder.decode(&raw, picture).map_err(io::Error::other)?;
        }
        let frames = pair.frames();
        if let Some(shown) = frames.last().copied() {
            // A new stream counts its frames from 0.
            if self.last.is_some_and(|last| shown.number < last) {
                backend.preview.restart();
            }
            self.last = Some(shown.number);
            backend.preview.add_frames(&frames);
            let [output, input] = &self.pictures;
            let encoded = self.encoder.encode(output.as_ref(), input.as_ref()).map_err(io::Error::other)?;
            backend.preview.publish(shown, encoded);
            backend.set_problem(String::new());
        }
        (self.is_drawn, self.due) = (true, (self.due + INTERVAL).max(Instant::now()));
        Ok(())
    }
}
