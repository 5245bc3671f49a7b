//! Tells failed transfers from frames.
//!
//! Where one USB transfer ends with an error, uvcvideo gives back every buffer that it has, all at once: marked as damaged, empty,
//! with sequence 0 and time 0. These are no frames and tell nothing of the stream's count or clock; the frames after them go on
//! with both as they were.

use super::queue::Returned;

/// Empty buffers further apart than this (nanoseconds) come from two failures.
const TOGETHER_NS: i64 = 20_000_000;

/// So many such buffers in a row, without a frame between, are no longer waited out.
const MAX: u32 = 100;

/// Counts them.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Transfers {
    /// Transfers that failed.
    pub(super) failed: u64,
    /// When the newest buffer of one came, where no frame came since.
    last_ns: Option<i64>,
    in_a_row: u32,
}

/// What a buffer is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Holds {
    /// A frame, damaged or not.
    Frame,
    /// Nothing: a transfer failed. `is_new` for the first buffer of each.
    Nothing { is_new: bool },
}

impl Transfers {
    /// Looks at a buffer that the driver gave back at `now_ns`.
    pub(super) fn look(&mut self, returned: &Returned, now_ns: i64) -> Holds {
        let nothing = returned.error && returned.bytes == 0 && returned.sequence == 0 && returned.time == (0, 0);
        if !nothing {
            (self.last_ns, self.in_a_row) = (None, 0);
            return Holds::Frame;
        }
        let is_new = self.last_ns.is_none_or(|last_ns| now_ns.saturating_sub(last_ns) > TOGETHER_NS);
        self.failed += u64::from(is_new);
        self.in_a_row = self.in_a_row.saturating_add(1);
        self.last_ns = Some(now_ns);
        Holds::Nothing { is_new }
    }

    /// Whether so many fail that the stream should be restarted; when this was answered with yes, they count from 0 again.
    pub(super) fn are_hopeless(&mut self) -> bool {
        let hopeless = self.in_a_row >= MAX;
        if hopeless {
            self.in_a_row = 0;
        }
        hopeless
    }
}

#[cfg(test)]
mod tests {
    use super::super::timeline::Timeline;
    use super::*;

    const MS: i64 = 1_000_000;
    const EMPTY: Returned = Returned { index: 0, bytes: 0, sequence: 0, time: (0, 0), error: true };

    fn frame(sequence: u32, ms: i64) -> Returned {
        Returned { index: 0, bytes: 9000, sequence, time: (ms / 1000, ms % 1000 * 1000), error: false }
    }

    /// Counts a stream as the capture does: (milliseconds, buffer). Gives our sequence of each frame, frames missing, times that
    /// were foreign, and failed transfers.
    fn counted(stream: &[(i64, Returned)]) -> (Vec<u64>, u64, u64, u64) {
        let (mut transfers, mut timeline) = (Transfers::default(), Timeline::default());
        let mut sequences = Vec::new();
        for (ms, returned) in stream {
            if transfers.look(returned, ms * MS) == Holds::Frame {
                sequences.push(timeline.stamp(returned.sequence, returned.time, ms * MS).sequence);
            }
        }
        (sequences, timeline.missing, timeline.foreign_times, transfers.failed)
    }

    #[test]
    fn one_failed_transfer_is_one_and_the_count_goes_on_as_it_was() {
        let mut stream: Vec<_> = (0..300).map(|n| (1000 + 33 * i64::from(n), frame(n, 1000 + 33 * i64::from(n)))).collect();
        let at = stream[299].0 + 5;
        stream.extend([(at, EMPTY), (at, EMPTY), (at + 1, EMPTY), (at + 1, EMPTY)]);
        // Two frames were lost with it; the driver counts them.
        stream.extend((302..400).map(|n| (1000 + 33 * i64::from(n), frame(n, 1000 + 33 * i64::from(n)))));
        let (sequences, missing, foreign, failed) = counted(&stream);
        assert_eq!(sequences, (0..300).chain(302..400).collect::<Vec<u64>>());
        assert_eq!((missing, foreign, failed), (2, 0, 1));
    }

    #[test]
    fn failures_are_told_apart_by_time_and_by_the_frames_between() {
        let (mut stream, mut n) = (Vec::new(), 0);
        for gap_ms in [100, 200] {
            stream.extend((0..3).map(|k| (n * 1000 + gap_ms + k, EMPTY)));
        }
        n += 1;
        stream.push((n * 1000, frame(70, n * 1000)));
        stream.extend([(n * 1000 + 1, EMPTY), (n * 1000 + 2, frame(71, n * 1000 + 2)), (n * 1000 + 3, EMPTY)]);
        assert_eq!(counted(&stream), (vec![70, 71], 0, 0, 4));
    }

    #[test]
    fn a_stream_that_begins_with_a_failure_begins_with_its_first_frame() {
        let stream = [(10, EMPTY), (10, EMPTY), (40, frame(0, 40)), (73, frame(1, 73))];
        assert_eq!(counted(&stream), (vec![0, 1], 0, 0, 1));
    }

    #[test]
    fn a_damaged_frame_is_a_frame() {
        let mut transfers = Transfers::default();
        let damaged = Returned { error: true, ..frame(0, 40) };
        let empty = Returned { bytes: 0, ..damaged };
        let counted = Returned { sequence: 8, ..EMPTY };
        let whole = Returned { error: false, ..EMPTY };
        for buffer in [damaged, empty, counted, whole] {
            assert_eq!(transfers.look(&buffer, 0), Holds::Frame, "{buffer:?}");
        }
        assert_eq!(transfers.failed, 0);
    }

    #[test]
    fn a_driver_that_gives_every_buffer_back_at_once_is_hopeless() {
        let mut transfers = Transfers::default();
        for n in 0..i64::from(MAX) {
            assert!(!transfers.are_hopeless(), "{n}");
            transfers.look(&EMPTY, n);
        }
        assert!(transfers.are_hopeless() && !transfers.are_hopeless());
        assert_eq!(transfers.failed, 1);
        for n in 0..200 {
            transfers.look(&EMPTY, n * 100 * MS);
            transfers.look(&frame(n as u32, n * 100), n * 100 * MS + 50 * MS);
        }
        assert!(!transfers.are_hopeless());
    }
}
