//! Interrupts a thread that waits for a device: an eventfd that can be polled beside the device's own descriptor.

use std::io;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::sync::Arc;
use std::time::Duration;

use rustix::event::{EventfdFlags, PollFd, PollFlags, Timespec, eventfd, poll};

/// A notification that any thread may send, a signal's thread included; clones share one descriptor.
///
/// It carries no reason: the sender sets a flag first, the receiver checks the flags after it was woken. A notification stays
/// pending until [`Notifier::clear`], so one that is sent before the wait is not lost.
#[derive(Clone, Debug)]
pub struct Notifier {
    fd: Arc<OwnedFd>,
}

impl Notifier {
    /// A notifier with nothing pending.
    ///
    /// # Errors
    /// Where the process has no file descriptor left.
    pub fn new() -> io::Result<Self> {
        let fd = eventfd(0, EventfdFlags::CLOEXEC | EventfdFlags::NONBLOCK)?;
        Ok(Self { fd: Arc::new(fd) })
    }

    /// Sends a notification.
    pub fn notify(&self) {
        // Refused only where the counter would overflow: then one is pending already.
        let _ = rustix::io::write(&*self.fd, &1u64.to_ne_bytes());
    }

    /// Clears the notification; returns whether one was pending.
    pub fn clear(&self) -> bool {
        let mut count = [0u8; 8];
        matches!(rustix::io::read(&*self.fd, &mut count), Ok(8))
    }

    /// Waits at most `timeout` for a notification and clears it; returns whether there was one.
    pub fn wait(&self, timeout: Duration) -> bool {
        let mut fds = [PollFd::from_borrowed_fd(self.fd(), PollFlags::IN)];
        // A signal ends the wait early, as a notification would: the caller checks its flags and waits again.
        let _ = poll(&mut fds, Timespec::try_from(timeout).ok().as_ref());
        self.clear()
    }

    /// The descriptor to poll for reading, beside a device's own.
    pub fn fd(&self) -> BorrowedFd<'_> {
        self.fd.as_fd()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Instant;

    #[test]
    fn a_notification_before_the_wait_is_not_lost() {
        let notifier = Notifier::new().unwrap();
        assert!(!notifier.clear());
        notifier.clone().notify();
        let before = Instant::now();
        assert!(notifier.wait(Duration::from_secs(20)));
        assert!(before.elapsed() < Duration::from_secs(10), "it did not wait");
        assert!(!notifier.clear(), "the wait cleared it");
    }

    #[test]
    fn a_notification_ends_a_wait_in_another_thread() {
        let notifier = Notifier::new().unwrap();
        let sender = notifier.clone();
        let before = Instant::now();
        let thread = std::thread::spawn(move || {
            std::thread::sleep(Duration::from_millis(50));
            sender.notify();
        });
        assert!(notifier.wait(Duration::from_secs(20)));
        assert!(before.elapsed() < Duration::from_secs(10));
        thread.join().unwrap();
        assert!(!notifier.wait(Duration::from_millis(20)), "without a notification the wait times out");
    }
}
