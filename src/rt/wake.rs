//! A bell: lets one thread interrupt another that waits for a device.

use std::io;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::sync::Arc;
use std::time::Duration;

use rustix::event::{EventfdFlags, PollFd, PollFlags, Timespec, eventfd, poll};

/// A bell that any thread may ring (also from a signal's thread); clones ring the same one.
///
/// It says *look around*, not why: what to look at is a flag beside it, set before ringing. It stays rung until
/// [`Wake::hush`], so a ring that comes before the wait is not lost.
#[derive(Clone, Debug)]
pub struct Wake {
    fd: Arc<OwnedFd>,
}

impl Wake {
    /// A silent bell.
    ///
    /// # Errors
    /// Where the process has no file descriptor left.
    pub fn new() -> io::Result<Self> {
        let fd = eventfd(0, EventfdFlags::CLOEXEC | EventfdFlags::NONBLOCK)?;
        Ok(Self { fd: Arc::new(fd) })
    }

    /// Rings.
    pub fn ring(&self) {
        // Refused only where the counter would overflow: then it rings already.
        let _ = rustix::io::write(&*self.fd, &1u64.to_ne_bytes());
    }

    /// Silences the bell; says whether it rang.
    pub fn hush(&self) -> bool {
        let mut count = [0u8; 8];
        matches!(rustix::io::read(&*self.fd, &mut count), Ok(8))
    }

    /// Waits at most `patience` for a ring and silences it; says whether it rang.
    pub fn wait(&self, patience: Duration) -> bool {
        let mut fds = [PollFd::from_borrowed_fd(self.fd(), PollFlags::IN)];
        // An interrupting signal ends the wait early, like a ring would: the caller looks around and waits again.
        let _ = poll(&mut fds, Timespec::try_from(patience).ok().as_ref());
        self.hush()
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
    fn a_ring_before_the_wait_is_not_lost() {
        let bell = Wake::new().unwrap();
        assert!(!bell.hush());
        bell.clone().ring();
        let before = Instant::now();
        assert!(bell.wait(Duration::from_secs(20)));
        assert!(before.elapsed() < Duration::from_secs(10), "it did not wait");
        assert!(!bell.hush(), "the wait silenced it");
    }

    #[test]
    fn a_ring_ends_a_wait_in_another_thread() {
        let bell = Wake::new().unwrap();
        let ringer = bell.clone();
        let before = Instant::now();
        let thread = std::thread::spawn(move || {
            std::thread::sleep(Duration::from_millis(50));
            ringer.ring();
        });
        assert!(bell.wait(Duration::from_secs(20)));
        assert!(before.elapsed() < Duration::from_secs(10));
        thread.join().unwrap();
        assert!(!bell.wait(Duration::from_millis(20)), "without a ring the wait runs out");
    }
}
