//! The door to a pipeline that runs: settings go in, counts come out, and neither side waits for the other.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError, TryLockError};

use super::Params;

/// Settings that may be changed while frames go by, and what becomes of these. Lasts as long as somebody wants, over many streams.
#[derive(Debug)]
pub struct Live {
    /// Goes up with each change: all that the frame path looks at while there is none.
    version: AtomicU64,
    params: Mutex<Params>,
    /// Frames the source gave, damaged ones included.
    frames_in: AtomicU64,
    /// Frames whose data was damaged.
    damaged: AtomicU64,
    /// Frames given up because a newer one was there.
    dropped: AtomicU64,
}

/// What became of the frames of a [`Live`] until they were to be drawn; over all its streams.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Frames the source gave, damaged ones included.
    pub frames_in: u64,
    /// Frames whose data was damaged.
    pub damaged: u64,
    /// Frames given up because a newer one was there.
    pub dropped: u64,
}

impl Live {
    /// Settings as they are at first.
    pub fn new(params: &Params) -> Self {
        Self {
            version: AtomicU64::new(0),
            params: Mutex::new(*params),
            frames_in: AtomicU64::new(0),
            damaged: AtomicU64::new(0),
            dropped: AtomicU64::new(0),
        }
    }

    /// The settings as they were set last.
    pub fn params(&self) -> Params {
        *self.params.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Sets what the next frame is to be drawn with; what [`super::Stabilizer::set_params`] does not take waits for the next stream.
    pub fn set(&self, params: &Params) {
        *self.params.lock().unwrap_or_else(PoisonError::into_inner) = *params;
        self.version.fetch_add(1, Ordering::Release);
    }

    /// What became of the frames so far.
    pub fn counts(&self) -> Counts {
        let of = |count: &AtomicU64| count.load(Ordering::Relaxed);
        Counts { frames_in: of(&self.frames_in), damaged: of(&self.damaged), dropped: of(&self.dropped) }
    }

    /// The settings, where they changed since `seen`. One atomic load otherwise; where they are being set at this moment, the next
    /// frame will see them.
    pub(super) fn changed_since(&self, seen: &mut u64) -> Option<Params> {
        let version = self.version.load(Ordering::Acquire);
        if version == *seen {
            return None;
        }
        let params = match self.params.try_lock() {
            Ok(params) => *params,
            Err(TryLockError::Poisoned(poisoned)) => *poisoned.into_inner(),
            Err(TryLockError::WouldBlock) => return None,
        };
        *seen = version;
        Some(params)
    }

    pub(super) fn count_in(&self, intact: bool) {
        self.frames_in.fetch_add(1, Ordering::Relaxed);
        self.damaged.fetch_add(u64::from(!intact), Ordering::Relaxed);
    }

    pub(super) fn count_dropped(&self) {
        self.dropped.fetch_add(1, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_change_is_seen_once() {
        let live = Live::new(&Params::default());
        let mut seen = 0;
        assert_eq!(live.changed_since(&mut seen), None);
        let other = Params { enabled: false, ..Params::default() };
        live.set(&Params::default());
        live.set(&other);
        assert_eq!(live.changed_since(&mut seen), Some(other));
        assert_eq!(live.changed_since(&mut seen), None);
        assert_eq!(live.params(), other);
    }

    #[test]
    fn while_it_is_being_set_nobody_waits() {
        let live = Live::new(&Params::default());
        live.set(&Params::default());
        let held = live.params.lock().unwrap();
        let mut seen = 0;
        assert_eq!(live.changed_since(&mut seen), None);
        drop(held);
        assert!(live.changed_since(&mut seen).is_some());
    }
}
