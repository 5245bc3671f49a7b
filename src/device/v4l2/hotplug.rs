//! Waiting for video devices to come and go, heard at /dev instead of asked for again and again.

use std::mem::MaybeUninit;
use std::os::fd::{AsFd, OwnedFd};
use std::path::Path;
use std::time::Duration;

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::inotify;

use super::super::DeviceError;
use crate::rt::wake::Wake;

/// Where devices come and go.
const DEV: &str = "/dev";

/// Why a wait ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum News {
    /// The bell rang.
    Rung,
    /// A video device came, went, or was given other permissions.
    Devices,
    /// Nothing for as long as patience lasted.
    Nothing,
}

/// An ear at /dev.
#[derive(Debug)]
pub struct Hotplug {
    heard: OwnedFd,
}

impl Hotplug {
    /// Begins to listen.
    ///
    /// # Errors
    /// Where the system gives no more inotify instances.
    pub fn new() -> Result<Self, DeviceError> {
        let error = |errno: rustix::io::Errno| DeviceError::io(Path::new(DEV), "listen at", errno.into());
        let heard = inotify::init(inotify::CreateFlags::CLOEXEC | inotify::CreateFlags::NONBLOCK).map_err(error)?;
        // ATTRIB: udev hands a new node to its group a moment after the kernel made it.
        let wanted = inotify::WatchFlags::CREATE | inotify::WatchFlags::DELETE | inotify::WatchFlags::ATTRIB;
        inotify::add_watch(&heard, DEV, wanted).map_err(error)?;
        Ok(Self { heard })
    }

    /// Waits for news, at most `patience`.
    pub fn wait(&self, bell: &Wake, patience: Duration) -> News {
        let mut fds =
            [PollFd::from_borrowed_fd(self.heard.as_fd(), PollFlags::IN), PollFd::from_borrowed_fd(bell.fd(), PollFlags::IN)];
        // An interrupting signal ends the wait early, as a ring would.
        let _ = poll(&mut fds, Timespec::try_from(patience).ok().as_ref());
        if bell.hush() {
            News::Rung
        } else if self.drain() {
            News::Devices
        } else {
            News::Nothing
        }
    }

    /// Takes what was heard; says whether any of it was of a video device.
    pub fn drain(&self) -> bool {
        let mut room = [MaybeUninit::uninit(); 4096];
        let mut events = inotify::Reader::new(&self.heard, &mut room);
        let mut any = false;
        while let Ok(event) = events.next() {
            let name = event.file_name().map(|name| name.to_bytes()).unwrap_or_default();
            // "v4l": the directory of links by name and by place; "v4l2loopback": the module was loaded.
            any |= name.starts_with(b"video") || name.starts_with(b"v4l");
        }
        any
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_news_patience_runs_out_and_a_ring_ends_it() {
        let (hotplug, bell) = (Hotplug::new().unwrap(), Wake::new().unwrap());
        assert_eq!(hotplug.wait(&bell, Duration::from_millis(1)), News::Nothing);
        bell.ring();
        assert_eq!(hotplug.wait(&bell, Duration::from_secs(60)), News::Rung);
        assert!(!hotplug.drain());
    }
}
