//! Reads the configuration file on a thread of its own, so that threads which answer clients and signals never wait for a file.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use crossbeam_channel::Sender;

use super::token_bucket::{Rate, TokenBucket};
use super::{Applied, DaemonState};
use crate::rt::notifier::Notifier;

/// Readings a second, at most; askers who are more share one.
const READINGS: Rate = Rate { per_second: 40.0, burst: 20.0 };

/// What came of one reading.
#[derive(Clone, Debug)]
pub(super) struct Reloaded {
    /// Everybody whose ticket is at most this has his answer.
    pub(super) ticket: u64,
    /// What [`DaemonState::reload`] says.
    pub(super) result: Result<Applied, String>,
}

/// The pending and running configuration reloads.
#[derive(Debug, Default)]
pub(super) struct Reloads(Mutex<Readings>);

#[derive(Debug, Default)]
struct Readings {
    /// The newest ticket that was given out; its reading has begun or will.
    asked: u64,
    /// The ticket of the newest reading that has begun.
    begun: u64,
    /// Whether a thread is reading it.
    busy: bool,
    /// Whether one of those who wait for the next reading has nothing but the log to learn from that nothing changed.
    aloud: bool,
    bucket: Option<TokenBucket>,
    /// Who is told, and the notifier for it.
    listener: Option<(Sender<Reloaded>, Notifier)>,
}

impl Reloads {
    fn readings(&self) -> MutexGuard<'_, Readings> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Tells from now on `sender` what comes of each reading, and notifies `wake`.
    pub(super) fn listen(&self, sender: Sender<Reloaded>, wake: Notifier) {
        self.readings().listener = Some((sender, wake));
    }

    fn tell(&self, told: Reloaded) {
        if let Some((sender, wake)) = &self.readings().listener {
            // Without a receiver there is no caller that waits either.
            let _ = sender.send(told);
            wake.notify();
        }
    }

    /// The ticket of the next reading, once it may begin, and whether to say that nothing changed; `None` where none is due.
    fn begin(&self) -> Option<(u64, bool)> {
        loop {
            let mut readings = self.readings();
            if readings.begun == readings.asked {
                readings.busy = false;
                return None;
            }
            let now = Instant::now();
            let bucket = readings.bucket.get_or_insert_with(|| TokenBucket::new(READINGS, now));
            if bucket.try_take(now) {
                readings.begun = readings.asked;
                return Some((readings.begun, std::mem::take(&mut readings.aloud)));
            }
            let wait = bucket.wait(now);
            drop(readings);
            std::thread::sleep(wait);
        }
    }
}

impl DaemonState {
    /// Has the configuration read again soon, on another thread, and returns the ticket of that reading: one that begins after this
    /// call, so that it sees what is in the file now. The result is logged and returned to the clients that wait for it. That nothing
    /// changed is logged only with `aloud`, for a caller that gets no reply (SIGHUP).
    pub fn reload_soon(self: &Arc<Self>, aloud: bool) -> u64 {
        let mut readings = self.reloads.readings();
        readings.aloud |= aloud;
        if readings.asked == readings.begun {
            readings.asked += 1;
        }
        let ticket = readings.asked;
        if readings.busy {
            return ticket;
        }
        readings.busy = true;
        drop(readings);
        let state = self.clone();
        // It is never joined: a file system that does not answer must not keep the daemon from ending.
        let thread = std::thread::Builder::new().name("reload".into()).spawn(move || {
            while let Some((ticket, aloud)) = state.reloads.begin() {
                let result = state.reload_and_say(aloud);
                state.reloads.tell(Reloaded { ticket, result });
            }
        });
        if let Err(error) = thread {
            let what = format!("cannot start a thread to read the configuration: {error}");
            tracing::error!("{what}");
            let mut readings = self.reloads.readings();
            (readings.busy, readings.begun) = (false, ticket);
            drop(readings);
            self.reloads.tell(Reloaded { ticket, result: Err(what) });
        }
        ticket
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Settings;
    use crate::systemd::Systemd;
    use crossbeam_channel::{bounded, unbounded};
    use std::sync::atomic::{AtomicU32, Ordering::Relaxed};
    use std::time::Duration;

    const LONG: Duration = Duration::from_secs(30);

    #[test]
    fn who_asks_while_the_file_is_read_gets_the_next_reading_and_all_of_them_the_same() {
        let (begun, has_begun) = unbounded();
        let (go_on, may_go_on) = bounded::<()>(0);
        let count = Arc::new(AtomicU32::new(0));
        let counted = count.clone();
        let read = move || {
            counted.fetch_add(1, Relaxed);
            begun.send(()).unwrap();
            may_go_on.recv().map_err(|_| "over".to_owned())?;
            Ok(Settings::default())
        };
        let state = Arc::new(DaemonState::new(Settings::default(), Systemd::disconnected(), Box::new(read)));
        let (sender, told) = unbounded();
        let wake = Notifier::new().unwrap();
        state.reloads.listen(sender, wake.clone());
        let first = state.reload_soon(false);
        has_begun.recv_timeout(LONG).unwrap();
        let second = state.reload_soon(false);
        assert!(second > first);
        assert!((0..1000).all(|_| state.reload_soon(false) == second), "they share it");
        go_on.send_timeout((), LONG).unwrap();
        assert_eq!(told.recv_timeout(LONG).unwrap().ticket, first);
        assert!(wake.wait(LONG));
        go_on.send_timeout((), LONG).unwrap();
        let reloaded = told.recv_timeout(LONG).unwrap();
        assert_eq!((reloaded.ticket, reloaded.result), (second, Ok(Applied::default())));
        assert_eq!(count.load(Relaxed), 2);
        drop(go_on);
        let third = state.reload_soon(false);
        let reloaded = told.recv_timeout(LONG).unwrap();
        assert_eq!((reloaded.ticket, reloaded.result), (third, Err("over".into())));
    }

    #[test]
    fn readings_have_a_rate() {
        let count = Arc::new(AtomicU32::new(0));
        let counted = count.clone();
        let read = move || {
            counted.fetch_add(1, Relaxed);
            Ok(Settings::default())
        };
        let state = Arc::new(DaemonState::new(Settings::default(), Systemd::disconnected(), Box::new(read)));
        let begun = Instant::now();
        let mut asked = 0;
        while begun.elapsed() < Duration::from_millis(500) {
            asked = state.reload_soon(false);
        }
        assert!(asked > 0);
        let most = READINGS.burst + READINGS.per_second * begun.elapsed().as_secs_f64() + 1.0;
        assert!(f64::from(count.load(Relaxed)) <= most, "{} readings", count.load(Relaxed));
    }
}
