//! One daemon's PipeWire node: it outlives restarts of the daemon and of PipeWire, and is fed with pictures.

use std::fs::OpenOptions;
use std::io;
use std::os::fd::AsFd;
use std::os::unix::fs::OpenOptionsExt;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::OFlags;

use super::daemons;
use super::still::Still;
use crate::pipewire::{Library, Node, NodeParams, Slot, State};
use crate::rt::clock::monotonic_ns;
use crate::rt::notifier::Notifier;
use crate::rt::stop::Stop;
use crate::share::{Client, Format, Heard, Refusal};

/// Size and interval of a node whose daemon was never heard.
const USUAL: (u32, u32, (u32, u32)) = (1280, 720, (1, 30));

/// How soon the daemon is tried again, and how soon while a program watches.
const AGAIN: Duration = Duration::from_millis(500);
const AGAIN_WATCHED: Duration = Duration::from_millis(100);

/// How soon PipeWire is tried again: at first it may be restarting; after [`RESTARTS_FOR`] it is rather not used here, and trying takes a
/// millisecond of processor time.
const PIPEWIRE_SOON: Duration = Duration::from_millis(100);
const PIPEWIRE_LATER: Duration = Duration::from_secs(1);
const RESTARTS_FOR: Duration = Duration::from_secs(10);

/// A daemon says within this time what its pictures are. The node waits for it: made in another size, it would have to be made again, and
/// its first readers would lose it.
const FORMAT_COMES: Duration = Duration::from_millis(300);

/// How soon a daemon is asked again that gave no pictures.
const ASK_AGAIN: Duration = Duration::from_secs(2);

/// Buffers that the daemon has to draw into at a time: one, one while that is on its way, and one for when this process is late.
const AHEAD: usize = 3;

/// Watchers get a picture at least this often.
const STILL_EVERY: Duration = Duration::from_millis(250);

/// A daemon that is there shows nothing for this long: then the last picture is too old to be shown.
const OLD: Duration = Duration::from_secs(2);

/// Without a free buffer for this long, readers' claims to buffers are no longer believed ...
const STARVED: Duration = Duration::from_millis(500);
/// ... and if it happens again within `RELAPSE`, after this long.
const STARVED_AGAIN: Duration = Duration::from_millis(30);
const RELAPSE: Duration = Duration::from_secs(10);

/// How often a free buffer is looked for while there is none.
const LOOK_AGAIN: Duration = Duration::from_millis(10);

/// What a message is about.
#[derive(Clone, Copy, Debug)]
enum About {
    PipeWire,
    Daemon,
}

/// A node and its daemon.
#[derive(Debug)]
pub(super) struct Camera {
    library: &'static Library,
    instance: String,
    runtime: Option<PathBuf>,
    notifier: Notifier,
    params: NodeParams,
    node: Option<Node>,
    node_due: Instant,
    /// Since when there is none.
    node_lost: Instant,
    still: Still,
    client: Option<Client>,
    client_due: Instant,
    /// Since when, where it is.
    connected: Instant,
    /// What the daemon said last.
    format: Option<Format>,
    watched: bool,
    /// Why the daemon was given no descriptor of the camera that proves anything.
    unproven: String,
    /// When the daemon is asked again, where it gives nothing.
    ask_due: Option<Instant>,
    /// Taken from the node: not yet with the daemon, and with it.
    spare: Vec<Slot>,
    out: Vec<Slot>,
    /// Numbers that this connection knows.
    lent: Vec<u64>,
    starved: Option<Instant>,
    cured: Option<Instant>,
    /// When a picture was sent last, when the last one came from the daemon or it came itself, and the time written on the last.
    sent: Instant,
    live: Instant,
    time_ns: i64,
    /// What was said last of PipeWire and of the daemon.
    told: [String; 2],
}

impl Camera {
    pub(super) fn new(library: &'static Library, instance: &str, runtime: Option<PathBuf>, notifier: Notifier) -> Self {
        let (width, height, interval) = USUAL;
        let (name, description) = match instance {
            "" => ("gimbald".to_owned(), "gimbald".to_owned()),
            instance => (format!("gimbald.{instance}"), format!("gimbald {instance}")),
        };
        let params = NodeParams { name, description, width, height, interval };
        let now = Instant::now();
        Self {
            library,
            instance: instance.to_owned(),
            runtime,
            notifier,
            still: Still::new(&params),
            params,
            node: None,
            node_due: now,
            node_lost: now,
            client: None,
            client_due: now,
            connected: now,
            format: None,
            watched: false,
            unproven: String::new(),
            ask_due: None,
            spare: Vec::new(),
            out: Vec::new(),
            lent: Vec::new(),
            starved: None,
            cured: None,
            sent: now,
            live: now,
            time_ns: 0,
            told: Default::default(),
        }
    }

    /// Until `stop` is set and its notifier notified.
    pub(super) fn live(mut self, stop: &Stop) {
        while !stop.is_set() {
            self.wait();
            self.connect();
            self.listen();
            self.keep_node();
            self.follow();
            self.revoke();
            self.feed();
            self.show_still();
        }
    }

    fn wait(&self) {
        let now = Instant::now();
        let mut due = vec![now + Duration::from_secs(5)];
        if self.node.is_none() {
            due.push(self.node_due);
        }
        if self.client.is_none() {
            due.push(self.client_due);
        }
        due.extend(self.ask_due);
        if self.watched {
            due.push(self.sent + STILL_EVERY);
            if self.starved.is_some() {
                due.push(now + LOOK_AGAIN);
            }
        }
        let left = due.into_iter().min().unwrap_or(now).saturating_duration_since(now);
        let mut fds = vec![PollFd::from_borrowed_fd(self.notifier.fd(), PollFlags::IN)];
        fds.extend(self.client.iter().map(|client| PollFd::from_borrowed_fd(client.fd(), PollFlags::IN)));
        // An interrupting signal is like a timeout.
        let _ = poll(&mut fds, Timespec::try_from(left).ok().as_ref());
        if !fds[0].revents().is_empty() {
            self.notifier.clear();
        }
    }

    /// Says a state once, not with each try.
    fn tell(&mut self, about: About, what: String) {
        let told = &mut self.told[about as usize];
        if what != *told {
            tracing::info!(node = %self.params.name, "{what}");
            *told = what;
        }
    }

    fn connect(&mut self) {
        if self.client.is_some() || Instant::now() < self.client_due {
            return;
        }
        self.client_due = Instant::now() + if self.watched { AGAIN_WATCHED } else { AGAIN };
        let found = daemons(self.runtime.as_deref()).into_iter().find(|(instance, _)| *instance == self.instance);
        let Some((_, path)) = found else {
            self.tell(About::Daemon, "waiting for the daemon: none listens".into());
            return;
        };
        match Client::connect(&path) {
            Ok(client) => {
                self.tell(About::Daemon, format!("connected to the daemon at {}", path.display()));
                self.client = Some(client);
                (self.connected, self.live) = (Instant::now(), Instant::now());
                self.lent.clear();
                self.spare.append(&mut self.out);
                // Before anything is lent: the size has to be known.
                self.report();
            }
            Err(error) => self.tell(About::Daemon, format!("waiting for the daemon at {}: {error}", path.display())),
        }
    }

    fn hang_up(&mut self, why: &io::Error) {
        self.tell(About::Daemon, format!("the daemon is away: {why}"));
        self.client = None;
        self.client_due = Instant::now();
        self.ask_due = None;
        self.lent.clear();
        self.spare.append(&mut self.out);
    }

    /// Hears the daemon, if it says something.
    fn listen(&mut self) {
        while let Some(client) = &self.client {
            match client.receive() {
                Ok(None) => return,
                Ok(Some(Heard::Frame { id, time_ns })) => self.pass_on(id, time_ns),
                Ok(Some(Heard::Format(format))) => {
                    if self.format.replace(format).is_none() {
                        // The node may have waited for it.
                        self.node_due = Instant::now();
                    }
                    self.report();
                }
                Ok(Some(Heard::Refused(refusal))) => {
                    self.ask_due = Some(Instant::now() + ASK_AGAIN);
                    let why = match refusal {
                        Refusal::Proof => format!("no pictures: {}", self.unproven),
                        Refusal::Size => {
                            "no pictures: those who watch hold another size; it changes when they have left".into()
                        }
                    };
                    self.tell(About::Daemon, why);
                }
                Err(error) => self.hang_up(&error),
            }
        }
    }

    /// A picture came.
    fn pass_on(&mut self, id: u64, time_ns: i64) {
        let Some(at) = self.out.iter().position(|slot| slot.id == id) else { return };
        let slot = self.out.swap_remove(at);
        if !self.watched {
            // It was on its way when the last program left. The next one may come when this user may not see it any more.
            self.spare.push(slot);
            return;
        }
        self.ask_due = None;
        self.live = Instant::now();
        self.send(&slot, time_ns);
    }

    fn send(&mut self, slot: &Slot, time_ns: i64) {
        let Some(node) = &mut self.node else { return };
        // Readers expect that time goes on.
        self.time_ns = time_ns.max(self.time_ns + 1);
        if node.send(slot.id, self.time_ns) {
            self.still.sent(slot);
            self.sent = Instant::now();
        }
    }

    /// Makes the node where there is none; replaces one that was lost, or that should have another format while no program watches.
    fn keep_node(&mut self) {
        match self.node.as_ref().map(Node::state) {
            Some(State::Lost(why)) => {
                self.drop_node();
                self.node_due = Instant::now() + PIPEWIRE_SOON;
                self.tell(About::PipeWire, format!("PipeWire ended the node: {why}"));
            }
            Some(State::Paused | State::Connecting) if self.wanted() != self.params => self.drop_node(),
            _ => {}
        }
        let now = Instant::now();
        if self.node.is_some() || now < self.node_due {
            return;
        }
        let format_due = self.connected + FORMAT_COMES;
        if self.client.is_some() && self.format.is_none() && now < format_due {
            self.node_due = format_due;
            return;
        }
        self.params = self.wanted();
        self.still = Still::new(&self.params);
        match Node::new(self.library, &self.params, &self.notifier) {
            Ok(node) => {
                let NodeParams { width, height, .. } = self.params;
                self.tell(About::PipeWire, format!("the node is there, {width}x{height}"));
                self.node = Some(node);
                self.report();
            }
            Err(error) => {
                let restarts = now.duration_since(self.node_lost) < RESTARTS_FOR;
                self.node_due = now + if restarts { PIPEWIRE_SOON } else { PIPEWIRE_LATER };
                self.tell(About::PipeWire, error.to_string());
            }
        }
    }

    fn drop_node(&mut self) {
        self.node = None;
        (self.node_due, self.node_lost) = (Instant::now(), Instant::now());
        self.starved = None;
        self.spare.clear();
        self.out.clear();
        self.still.forget();
        if std::mem::take(&mut self.watched) {
            self.report();
        }
    }

    /// What the node should be.
    fn wanted(&self) -> NodeParams {
        match &self.format {
            Some(Format { width, height, interval, .. }) => {
                NodeParams { width: *width, height: *height, interval: *interval, ..self.params.clone() }
            }
            None => self.params.clone(),
        }
    }

    /// Follows whether a program watches, as PipeWire says.
    fn follow(&mut self) {
        let watched = self.node.as_ref().is_some_and(|node| node.state() == State::Streaming);
        if watched != self.watched {
            self.watched = watched;
            let now = Instant::now();
            (self.sent, self.live, self.starved) = (now, now, None);
            if watched {
                self.client_due = now;
            } else {
                self.still.forget();
            }
            self.report();
        } else if self.ask_due.is_some_and(|due| Instant::now() >= due) {
            self.report();
        }
    }

    /// Says to the daemon who watches, with the proof that this user may see the camera.
    fn report(&mut self) {
        self.ask_due = None;
        let size = (self.params.width, self.params.height);
        let camera = self.format.as_ref().map(|format| &format.camera).filter(|path| !path.as_os_str().is_empty());
        let opened = match camera {
            Some(path) if self.watched => {
                let flags = (OFlags::NONBLOCK | OFlags::NOCTTY).bits().cast_signed();
                let opened = OpenOptions::new().read(true).write(true).custom_flags(flags).open(path);
                self.unproven = match opened.as_ref().map_err(io::Error::kind) {
                    Ok(_) => "the daemon has not found its camera yet".into(),
                    Err(io::ErrorKind::PermissionDenied) => format!("this user may not open {}", path.display()),
                    Err(kind) => format!("the camera {} cannot be opened: {kind}", path.display()),
                };
                opened.ok()
            }
            _ => {
                self.unproven = "there is no camera".into();
                None
            }
        };
        if let Some(client) = &self.client
            && let Err(error) = client.watch(self.watched, size, opened.as_ref().map(AsFd::as_fd))
        {
            self.hang_up(&error);
        }
    }

    /// Tells the daemon which of the memory it knows is gone.
    fn revoke(&mut self) {
        let node = &self.node;
        let lives = |id: u64| node.as_ref().is_some_and(|node| node.has(id));
        self.spare.retain(|slot| lives(slot.id));
        self.out.retain(|slot| lives(slot.id));
        let (kept, gone): (Vec<u64>, Vec<u64>) = self.lent.iter().partition(|id| lives(**id));
        self.lent = kept;
        for id in gone {
            if let Some(client) = &self.client
                && let Err(error) = client.revoke(id)
            {
                self.hang_up(&error);
            }
        }
    }

    /// Makes sure that the daemon has memory to draw into.
    fn feed(&mut self) {
        if !self.watched {
            return;
        }
        while self.out.len() < AHEAD && self.client.is_some() {
            let Some(slot) = self.dequeue() else { return };
            let known = self.lent.contains(&slot.id);
            let Some(client) = &self.client else { return };
            let said = if known { Ok(()) } else { client.lend(slot.id, slot.fd.as_fd()) }.and_then(|()| client.free(slot.id));
            if !known {
                self.lent.push(slot.id);
            }
            self.out.push(slot);
            if let Err(error) = said {
                self.hang_up(&error);
            }
        }
    }

    /// A buffer to draw into. Where readers keep all of them for too long, what they claim is forgotten.
    fn dequeue(&mut self) -> Option<Slot> {
        let node = self.node.as_mut()?;
        let taken = self.spare.pop().or_else(|| node.dequeue());
        if taken.is_some() {
            self.starved = None;
            return taken;
        }
        if !self.out.is_empty() {
            // Pictures go on: readers use what they have.
            self.starved = None;
            return None;
        }
        let now = Instant::now();
        let since = *self.starved.get_or_insert(now);
        let patience = match self.cured {
            Some(cured) if now.duration_since(cured) < RELAPSE => STARVED_AGAIN,
            _ => STARVED,
        };
        if now.duration_since(since) >= patience {
            if self.cured.is_none_or(|cured| now.duration_since(cured) >= RELAPSE) {
                tracing::warn!(node = %self.params.name, "a reader keeps every buffer, or was killed with them: they are taken back");
            }
            node.forget_readers();
            (self.cured, self.starved) = (Some(now), Some(now));
        }
        None
    }

    /// Where no picture came for a while: shows the last one again, or the dark one.
    fn show_still(&mut self) {
        if !self.watched || self.sent.elapsed() < STILL_EVERY {
            return;
        }
        // While the daemon is away its last picture stays: it is being restarted.
        let dark = self.client.is_some() && self.live.elapsed() >= OLD;
        let slot = self.dequeue().or_else(|| self.out.pop());
        self.sent = Instant::now();
        let Some(slot) = slot else { return };
        if self.still.draw(&slot, dark) {
            self.send(&slot, monotonic_ns());
        } else {
            self.spare.push(slot);
        }
    }
}
