//! Waits for video devices to appear and disappear: /dev is watched (inotify), not polled.

use std::mem::MaybeUninit;
use std::os::fd::{AsFd, OwnedFd};
use std::path::Path;
use std::time::Duration;

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::inotify;

use super::super::DeviceError;
use crate::rt::notifier::Notifier;

/// Where devices come and go.
const DEV: &str = "/dev";

/// Why a wait ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum News {
    /// The notifier was used.
    Notified,
    /// A video device came, went, or was given other permissions.
    Devices,
    /// Nothing for `timeout`.
    Nothing,
}

/// A watch on /dev.
#[derive(Debug)]
pub struct Hotplug {
    events: OwnedFd,
}

impl Hotplug {
    /// Begins to watch.
    ///
    /// # Errors
    /// Where the system gives no more inotify instances.
    pub fn new() -> Result<Self, DeviceError> {
        let error = |errno: rustix::io::Errno| DeviceError::io(Path::new(DEV), "watch", errno.into());
        let events = inotify::init(inotify::CreateFlags::CLOEXEC | inotify::CreateFlags::NONBLOCK).map_err(error)?;
        // ATTRIB: udev hands a new node to its group a moment after the kernel made it.
        let wanted = inotify::WatchFlags::CREATE | inotify::WatchFlags::DELETE | inotify::WatchFlags::ATTRIB;
        inotify::add_watch(&events, DEV, wanted).map_err(error)?;
        Ok(Self { events })
    }

    /// Waits for news, at most `timeout`.
    pub fn wait(&self, notifier: &Notifier, timeout: Duration) -> News {
        let mut fds = [
            PollFd::from_borrowed_fd(self.events.as_fd(), PollFlags::IN),
            PollFd::from_borrowed_fd(notifier.fd(), PollFlags::IN),
        ];
        // An interrupting signal ends the wait early, as a notification would.
        let _ = poll(&mut fds, Timespec::try_from(timeout).ok().as_ref());
        if notifier.clear() {
            News::Notified
        } else if self.drain() {
            News::Devices
        } else {
            News::Nothing
        }
    }

    /// Takes the events that came; says whether any was of a video device.
    pub fn drain(&self) -> bool {
        let mut room = [MaybeUninit::uninit(); 4096];
        let mut reader = inotify::Reader::new(&self.events, &mut room);
        let mut any = false;
        while let Ok(event) = reader.next() {
            let name = event.file_name().map(|name| name.to_bytes()).unwrap_or_default();
            // "v4l": the directory of links by name and by place; "v4l2loopback": the module was loaded.
            // No name: so many events came that some were lost.
            any |= name.is_empty() || name.starts_with(b"video") || name.starts_with(b"v4l");
        }
        any
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_news_patience_runs_out_and_a_notification_ends_it() {
        let (hotplug, notifier) = (Hotplug::new().unwrap(), Notifier::new().unwrap());
        assert_eq!(hotplug.wait(&notifier, Duration::from_millis(1)), News::Nothing);
        notifier.notify();
        assert_eq!(hotplug.wait(&notifier, Duration::from_secs(60)), News::Notified);
        assert!(!hotplug.drain());
    }
}
