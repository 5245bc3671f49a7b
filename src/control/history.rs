//! What happened to the last frames: a ring of numbers that the frame path writes and requests read. Neither waits for the other: a record
//! that is being overwritten while it is read is left out.

use std::sync::atomic::Ordering::{Acquire, Relaxed, Release};
use std::sync::atomic::{AtomicI64, AtomicU32, AtomicU64, fence};

use serde::{Deserialize, Serialize};

use crate::frame::{Frame, Outcome, Stage};

/// Frames that are kept: a minute at 60 fps, half a megabyte.
const KEPT: u64 = 3600;
/// The oldest of them that are not read, because they are overwritten next.
const MARGIN: u64 = 8;
/// Frames in a reply, at most.
const PER_REPLY: u64 = 200;
/// Numbers of a frame.
const NUMBERS: usize = 24 + Stage::ALL.len();
/// Number of a slot without a record, or whose record is being written.
const NONE: u64 = u64::MAX;

/// What is known of a frame after it was sent. Values that were not finite are 0.
#[derive(Clone, Copy, Debug, Default, Deserialize, PartialEq, Serialize)]
#[serde(default)]
pub struct FrameRecord {
    /// Frames that were sent before it, since the daemon started.
    pub number: u64,
    /// When its first row was taken (seconds on the camera's clock).
    pub time_s: f64,
    /// Time since the frame before (seconds); 0 for the first of a stream.
    pub interval_s: f32,
    /// Outcome, as [`Outcome::code`] has it.
    pub outcome: u8,
    /// Motion of the camera since the frame before, in the four parameters of the motion model.
    pub motion: [f32; 4],
    /// The camera's path.
    pub path: [f32; 4],
    /// The virtual camera's path.
    pub smoothed: [f32; 4],
    /// Weight of the correction, 0 to 1.
    pub trust: f32,
    /// Confidence in the frame's motion, 0 to 1.
    pub confidence: f32,
    /// Share of the crop margin in use.
    pub crop_use: f32,
    /// What yaw, pitch, roll and zoom take of the margin where least of it is left.
    pub crop_shares: [f32; 4],
    /// Points that were tracked.
    pub tracks: f32,
    /// Points that agree with the motion.
    pub inliers: f32,
    /// Age when it was sent (ms).
    pub age_ms: f32,
    /// Processing time of each stage, in the order of [`Stage::ALL`] (ms).
    pub spent_ms: [f32; Stage::ALL.len()],
}

/// Frames in the order in which they were sent.
#[derive(Clone, Debug, Default, Deserialize, PartialEq, Serialize)]
#[serde(default)]
pub struct HistoryPart {
    /// At most 200 records.
    pub frames: Vec<FrameRecord>,
    /// Number of the frame that follows them. No records with this number and above: there are no more yet.
    pub next: u64,
}

impl FrameRecord {
    fn numbers(frame: &Frame, age_ms: f64) -> [f32; NUMBERS] {
        let context = &frame.context;
        let mut numbers = [0.0; NUMBERS];
        let all = [context.interval_s, f64::from(context.outcome.code())]
            .into_iter()
            .chain(context.motion.0)
            .chain(context.path.0)
            .chain(context.smoothed.0)
            .chain([context.trust, context.confidence, context.crop_use])
            .chain([f64::from(context.fit.tracks), f64::from(context.fit.inliers), age_ms])
            .chain(context.crop_shares)
            .chain(context.spent_ns.map(|ns| ns as f64 * 1e-6));
        numbers.iter_mut().zip(all).for_each(|(number, value)| *number = value as f32);
        numbers
    }

    fn from_numbers(number: u64, time_ns: i64, n: &[f32; NUMBERS]) -> Self {
        let four = |at: usize| std::array::from_fn(|i| n[at + i]);
        Self {
            number,
            time_s: time_ns as f64 * 1e-9,
            interval_s: n[0],
            outcome: n[1] as u8,
            motion: four(2),
            path: four(6),
            smoothed: four(10),
            trust: n[14],
            confidence: n[15],
            crop_use: n[16],
            tracks: n[17],
            inliers: n[18],
            age_ms: n[19],
            crop_shares: four(20),
            spent_ms: std::array::from_fn(|i| n[24 + i]),
        }
    }

    /// How the frame was shown.
    pub fn outcome(&self) -> Outcome {
        Outcome::from_code(self.outcome)
    }
}

#[derive(Debug)]
struct Slot {
    number: AtomicU64,
    time_ns: AtomicI64,
    numbers: [AtomicU32; NUMBERS],
}

impl Slot {
    fn new() -> Self {
        Self { number: AtomicU64::new(NONE), time_ns: AtomicI64::new(0), numbers: std::array::from_fn(|_| AtomicU32::new(0)) }
    }

    /// The record of this number; `None` where the slot has another, or gets one meanwhile.
    fn read(&self, number: u64) -> Option<FrameRecord> {
        let before = self.number.load(Acquire);
        let time_ns = self.time_ns.load(Relaxed);
        let numbers = std::array::from_fn(|i| {
            let value = f32::from_bits(self.numbers[i].load(Relaxed));
            // JSON has no other numbers.
            if value.is_finite() { value } else { 0.0 }
        });
        fence(Acquire);
        let after = self.number.load(Relaxed);
        (before == number && after == number).then(|| FrameRecord::from_numbers(number, time_ns, &numbers))
    }
}

/// The ring.
#[derive(Debug)]
pub(super) struct History {
    slots: Box<[Slot]>,
    count: AtomicU64,
}

impl Default for History {
    fn default() -> Self {
        Self { slots: (0..KEPT).map(|_| Slot::new()).collect(), count: AtomicU64::new(0) }
    }
}

impl History {
    /// Adds a frame. One writer at a time; some thirty atomic stores.
    pub(super) fn add(&self, frame: &Frame, age_ms: f64) {
        let count = self.count.load(Relaxed);
        let slot = &self.slots[(count % KEPT) as usize];
        slot.number.store(NONE, Relaxed);
        // A reader that sees one of the new values sees that the slot is being written.
        fence(Release);
        slot.time_ns.store(frame.stamp.time_ns, Relaxed);
        let numbers = FrameRecord::numbers(frame, age_ms);
        slot.numbers.iter().zip(numbers).for_each(|(kept, number)| kept.store(number.to_bits(), Relaxed));
        slot.number.store(count, Release);
        self.count.store(count + 1, Release);
    }

    /// The frames from number `first` on that are still there, oldest first.
    pub(super) fn since(&self, first: u64) -> HistoryPart {
        let count = self.count.load(Acquire);
        let from = first.max(count.saturating_sub(KEPT - MARGIN)).min(count);
        let next = from.saturating_add(PER_REPLY).min(count);
        let frames = (from..next).filter_map(|number| self.slots[(number % KEPT) as usize].read(number)).collect();
        HistoryPart { frames, next }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::{HoldReason, PassReason, PathParameters};

    fn frame(n: u64) -> Frame {
        let mut frame = Frame::default();
        frame.stamp.time_ns = n as i64 * 20_000_000;
        frame.context.path = PathParameters([n as f64; 4]);
        frame.context.smoothed = PathParameters([-(n as f64); 4]);
        frame.context.outcome = Outcome::Stabilized;
        frame.context.spent_ns = [n * 1_000_000; Stage::ALL.len()];
        frame
    }

    #[test]
    fn the_last_frames_are_read_in_parts_and_in_order() {
        let history = History::default();
        assert_eq!(history.since(0), HistoryPart::default());
        let frames = 2 * KEPT + 100;
        (0..frames).for_each(|n| history.add(&frame(n), 5.0));
        let (mut first, mut read) = (0, Vec::new());
        loop {
            let part = history.since(first);
            assert!(part.frames.len() as u64 <= PER_REPLY);
            if part.frames.is_empty() {
                break;
            }
            first = part.next;
            read.extend(part.frames);
        }
        assert_eq!((first, read.len() as u64), (frames, KEPT - MARGIN));
        for (record, n) in read.iter().zip(frames - (KEPT - MARGIN)..) {
            let value = n as f32;
            assert_eq!((record.number, record.path, record.smoothed), (n, [value; 4], [-value; 4]));
            assert_eq!((record.age_ms, record.spent_ms[8], record.outcome()), (5.0, value, Outcome::Stabilized));
            assert!((record.time_s - 0.02 * n as f64).abs() < 1e-9);
        }
        assert_eq!(history.since(frames + 7), HistoryPart { frames: Vec::new(), next: frames }, "another daemon's numbers");
    }

    #[test]
    fn every_outcome_has_its_code() {
        for outcome in [
            Outcome::Stabilized,
            Outcome::PassedThrough(PassReason::First),
            Outcome::PassedThrough(PassReason::LostTrack),
            Outcome::PassedThrough(PassReason::SwitchedOff),
            Outcome::Held(HoldReason::Damaged),
        ] {
            assert_eq!(Outcome::from_code(outcome.code()), outcome);
        }
        assert_eq!(Outcome::from_code(99), Outcome::Pending, "of a newer daemon");
    }

    #[test]
    fn what_is_not_finite_becomes_0_and_the_reply_stays_readable() {
        let history = History::default();
        let mut bad = frame(1);
        bad.context.path = PathParameters([f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e300]);
        history.add(&bad, f64::NAN);
        let part = history.since(0);
        assert_eq!((part.frames[0].path, part.frames[0].age_ms), ([0.0; 4], 0.0));
        let json = serde_json::to_string(&part).unwrap();
        assert_eq!(serde_json::from_str::<HistoryPart>(&json).unwrap(), part);
    }

    #[test]
    fn a_record_that_is_read_while_it_is_overwritten_is_whole_or_left_out() {
        let history = History::default();
        std::thread::scope(|scope| {
            let writer = scope.spawn(|| (0..20 * KEPT).for_each(|n| history.add(&frame(n), 0.0)));
            while !writer.is_finished() {
                for record in history.since(0).frames {
                    let value = record.number as f32;
                    assert_eq!((record.path, record.smoothed, record.spent_ms[8]), ([value; 4], [-value; 4], value));
                }
            }
        });
    }
}
