//! The interface to a running pipeline: settings in, counts out; neither side waits for the other.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError, TryLockError};

use super::Params;
use super::decode::{Reason, Reasons, Unusable, reason_text};

/// Settings that may be changed while frames go by, and what becomes of these. Outlives a stream: a daemon has one for all its streams.
#[derive(Debug)]
pub struct Live {
    /// Goes up with each change: all that the frame path looks at while there is none.
    version: AtomicU64,
    params: Mutex<Params>,
    /// Frames the source gave, unusable ones included.
    frames_in: AtomicU64,
    /// Frames that could not be used, by [`Reason`].
    unusable: [AtomicU64; Reason::COUNT],
    /// Frames whose end was missing, shown all the same.
    cut: AtomicU64,
    /// Frames given up because a newer one was there.
    dropped: AtomicU64,
    /// `frames_in` and `unusable` as they were when the present stream began.
    frames_before: AtomicU64,
    unusable_before: [AtomicU64; Reason::COUNT],
    /// The first unusable frame's words for each reason, in the present stream; a bit of `described` for each that is there.
    first: Mutex<[Option<Box<str>>; Reason::COUNT]>,
    described: AtomicU64,
}

/// What became of the frames of a [`Live`] until they were to be drawn; over all its streams.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Frames the source gave, unusable ones included.
    pub frames_in: u64,
    /// Frames that could not be used, by [`Reason`].
    pub unusable: [u64; Reason::COUNT],
    /// Frames whose end was missing, shown with the picture's before in its place.
    pub cut: u64,
    /// Frames given up because a newer one was there.
    pub dropped: u64,
}

impl Counts {
    /// Frames that could not be used.
    pub fn damaged(&self) -> u64 {
        self.unusable.iter().sum()
    }
}

impl Live {
    /// Settings as they are at first.
    pub fn new(params: &Params) -> Self {
        Self {
            version: AtomicU64::new(0),
            params: Mutex::new(*params),
            frames_in: AtomicU64::new(0),
            unusable: Default::default(),
            cut: AtomicU64::new(0),
            dropped: AtomicU64::new(0),
            frames_before: AtomicU64::new(0),
            unusable_before: Default::default(),
            first: Mutex::default(),
            described: AtomicU64::new(0),
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
        Counts {
            frames_in: of(&self.frames_in),
            unusable: std::array::from_fn(|kind| of(&self.unusable[kind])),
            cut: of(&self.cut),
            dropped: of(&self.dropped),
        }
    }

    /// Frames of the present stream (or the last, where it has ended), and how many of them could not be used.
    pub fn stream_counts(&self) -> (u64, u64) {
        // What is unusable is read first: it is counted first, and never more than all.
        let unusable = self.stream_unusable().iter().sum();
        let of = |count: &AtomicU64| count.load(Ordering::Relaxed);
        (of(&self.frames_in).saturating_sub(of(&self.frames_before)).max(unusable), unusable)
    }

    /// The same with the reasons.
    pub fn stream(&self) -> (u64, Reasons) {
        let counts = self.stream_unusable();
        let first = self.first.lock().unwrap_or_else(PoisonError::into_inner).clone();
        (self.stream_counts().0, Reasons::of(counts, first))
    }

    fn stream_unusable(&self) -> [u64; Reason::COUNT] {
        let of = |count: &AtomicU64| count.load(Ordering::Relaxed);
        std::array::from_fn(|kind| of(&self.unusable[kind]).saturating_sub(of(&self.unusable_before[kind])))
    }

    /// A stream begins.
    pub(super) fn begin(&self) {
        let Counts { frames_in, unusable, .. } = self.counts();
        self.frames_before.store(frames_in, Ordering::Relaxed);
        self.unusable_before.iter().zip(unusable).for_each(|(before, count)| before.store(count, Ordering::Relaxed));
        *self.first.lock().unwrap_or_else(PoisonError::into_inner) = Default::default();
        self.described.store(0, Ordering::Relaxed);
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

    /// Atomic additions for a frame that can be used; words are kept of the first of each kind that cannot.
    pub(super) fn count_in(&self, filled: &Result<(), Unusable>, cut: bool) {
        self.cut.fetch_add(u64::from(cut), Ordering::Relaxed);
        if let Err(why) = filled {
            let kind = why.reason() as usize;
            self.unusable[kind].fetch_add(1, Ordering::Relaxed);
            let bit = 1 << kind;
            // Where they are being read just now, the next such frame's words are kept.
            if self.described.load(Ordering::Relaxed) & bit == 0
                && let Ok(mut first) = self.first.try_lock()
            {
                first[kind] = Some(reason_text(why));
                self.described.fetch_or(bit, Ordering::Relaxed);
            }
        }
        self.frames_in.fetch_add(1, Ordering::Relaxed);
    }

    pub(super) fn count_dropped(&self) {
        self.dropped.fetch_add(1, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reasons_are_those_of_the_present_stream_and_counts_those_of_all() {
        let live = Live::new(&Params::default());
        live.begin();
        live.count_in(&Ok(()), false);
        live.count_in(&Err(Unusable::Empty), false);
        live.count_in(&Err(Unusable::Empty), false);
        let (frames, reasons) = live.stream();
        assert_eq!(reasons.in_words(frames).unwrap(), "2 of 3 frames cannot be used: the frame has no bytes");
        live.begin();
        assert_eq!(live.stream(), (0, Reasons::default()));
        live.count_in(&Err(Unusable::Marked), false);
        let (frames, reasons) = live.stream();
        assert_eq!((frames, reasons.total(), reasons.main()), (1, 1, Some(Reason::Marked)));
        assert!(reasons.in_words(1).unwrap().contains("marked as damaged"), "{reasons:?}");
        let counts = live.counts();
        assert_eq!((counts.frames_in, counts.damaged()), (4, 3));
        assert_eq!(counts.unusable[Reason::Empty as usize], 2);
    }

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
