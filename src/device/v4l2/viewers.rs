//! Viewers of a loopback device: v4l2loopback reports them since 0.13; before, open descriptors are counted.

use std::os::fd::{AsFd, OwnedFd};
use std::path::Path;
use std::time::{Duration, Instant};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::inotify;
use rustix::io::Errno;

use super::super::DeviceError;
use super::node::Node;
use crate::rt::notifier::Notifier;

/// v4l2loopback's V4L2_EVENT_PRI_CLIENT_USAGE: the first word is how many readers stream. The versions that send it serve one reader
/// at a time, so it is 0 or 1.
const CLIENT_USAGE: u32 = 0x0800_0000 + 0x08E0_0000 + 1;

/// How many descriptors of all its devices are open, as the kernel counts them.
const OPEN_COUNT: &str = "/sys/module/v4l2loopback/refcnt";

/// Counting: programs open a node for a moment to see what it is, and the count is right only a moment after an event.
const SETTLED: Duration = Duration::from_millis(200);
/// Counting: how often a watched device is looked at though nothing was heard (another loopback's reader may have counted).
const LOOK_AGAIN: Duration = Duration::from_secs(5);

/// An ear at a loopback device.
#[derive(Debug)]
pub struct Viewers {
    way: Way,
    count: u32,
}

#[derive(Debug)]
enum Way {
    /// The module tells.
    Told(Node),
    /// The node's openings are heard, and what is open is counted.
    Counted {
        heard: OwnedFd,
        /// When the last one was heard, until the count was taken.
        since: Option<Instant>,
    },
}

impl Viewers {
    /// Listens at the loopback device at `path`, which this process holds open once.
    ///
    /// # Errors
    /// As for opening any device.
    pub fn of(path: &Path) -> Result<Self, DeviceError> {
        let node = Node::open(path)?;
        match node.subscribe(CLIENT_USAGE) {
            Ok(()) => Ok(Self { way: Way::Told(node), count: 0 }),
            Err(Errno::INVAL | Errno::NOTTY) => {
                drop(node);
                let flags = inotify::CreateFlags::CLOEXEC | inotify::CreateFlags::NONBLOCK;
                let watched = inotify::WatchFlags::OPEN | inotify::WatchFlags::CLOSE_WRITE | inotify::WatchFlags::CLOSE_NOWRITE;
                let heard = inotify::init(flags).map_err(|errno| DeviceError::io(path, "listen at", errno.into()))?;
                inotify::add_watch(&heard, path, watched).map_err(|errno| DeviceError::io(path, "listen at", errno.into()))?;
                Ok(Self { way: Way::Counted { heard, since: Some(Instant::now()) }, count: 0 })
            }
            Err(errno) => Err(node.error("listen at", errno)),
        }
    }

    /// Whether the module tells by itself; where it is counted, who only holds the device open counts as well, and so do readers
    /// of other loopback devices.
    pub fn are_told(&self) -> bool {
        matches!(self.way, Way::Told(_))
    }

    /// Waits until a viewer comes or goes, `notifier` is notified or `timeout` runs out; says how many watch. Where the module
    /// tells: streaming readers. Where it is counted: openings of loopback devices beside this process's own, more than watch.
    ///
    /// # Errors
    /// Where the device is gone.
    pub fn wait(&mut self, notifier: &Notifier, timeout: Option<Duration>) -> Result<u32, DeviceError> {
        let before = Instant::now();
        loop {
            let left = timeout.map(|timeout| timeout.saturating_sub(before.elapsed()));
            let (was, notified) = (self.count, self.listen(notifier, left)?);
            if notified || self.count != was || left.is_some_and(|left| left.is_zero()) {
                return Ok(self.count);
            }
        }
    }

    /// One wait at the poll, and what came of it; says whether it was notified.
    fn listen(&mut self, notifier: &Notifier, left: Option<Duration>) -> Result<bool, DeviceError> {
        let own = match &self.way {
            Way::Told(_) => None,
            Way::Counted { since: Some(since), .. } => Some(SETTLED.saturating_sub(since.elapsed())),
            Way::Counted { since: None, .. } => (self.count > 0).then_some(LOOK_AGAIN),
        };
        let timeout = match (left, own) {
            (Some(left), Some(own)) => Some(left.min(own)),
            (left, own) => left.or(own),
        };
        let (fd, flags) = match &self.way {
            Way::Told(node) => (node.fd(), PollFlags::PRI),
            Way::Counted { heard, .. } => (heard.as_fd(), PollFlags::IN),
        };
        let mut fds = [PollFd::from_borrowed_fd(fd, flags), PollFd::from_borrowed_fd(notifier.fd(), PollFlags::IN)];
        // An interrupting signal is like a timeout: look, and wait again.
        let _ = poll(&mut fds, timeout.and_then(|timeout| Timespec::try_from(timeout).ok()).as_ref());
        let (heard, notified) = (fds[0].revents(), !fds[1].revents().is_empty());
        if notified {
            notifier.clear();
        }
        match &mut self.way {
            Way::Told(node) => {
                while let Some(event) = node.next_event().map_err(|errno| node.error("listen at", errno))? {
                    if event.kind == CLIENT_USAGE {
                        self.count = event.word;
                    }
                }
                if heard.intersects(PollFlags::HUP | PollFlags::NVAL) {
                    return Err(DeviceError::Gone { path: node.path().to_path_buf() });
                }
            }
            Way::Counted { heard: ear, since } => {
                if !heard.is_empty() {
                    let mut events = [0u8; 4096];
                    while rustix::io::read(&*ear, &mut events).is_ok_and(|bytes| bytes > 0) {}
                    // From the first that was heard: who opens all the time is seen all the same.
                    since.get_or_insert_with(Instant::now);
                } else if since.is_none_or(|since| since.elapsed() >= SETTLED) {
                    *since = None;
                    // One is this process's own. Where it cannot be counted, it is safer to show the picture.
                    self.count = open_count().map_or(1, |count| count.saturating_sub(1));
                }
            }
        }
        Ok(notified)
    }
}

fn open_count() -> Option<u32> {
    std::fs::read_to_string(OPEN_COUNT).ok()?.trim().parse().ok()
}
