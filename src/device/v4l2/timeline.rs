//! Turns a driver's sequence numbers and time stamps into reliable ones.

use crate::frame::{FrameFlags, Stamp};

/// A time further than this from now (nanoseconds) is on another clock.
const MAX_OFFSET_NS: i64 = 10_000_000_000;

/// Carries a driver's 32-bit counts on as 64-bit ones, across its wrap and restarts, and puts times of odd clocks on
/// CLOCK_MONOTONIC.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Timeline {
    /// The driver's last count and count; `None` before the first frame.
    last: Option<(u32, u64)>,
    /// The stream was restarted: the driver counts from 0 again.
    restarted: bool,
    /// Frames whose time was not on CLOCK_MONOTONIC.
    pub(super) foreign_times: u64,
    /// Frames that the driver counted but did not deliver.
    pub(super) missing: u64,
}

impl Timeline {
    /// The stamp of a frame that the driver counts as `sequence`, taken at `time` (seconds, microseconds), seen by
    /// us at `now_ns`.
    pub(super) fn stamp(&mut self, sequence: u32, time: (i64, i64), now_ns: i64) -> Stamp {
        Stamp { time_ns: self.time(time, now_ns), sequence: self.count(sequence), flags: FrameFlags::default() }
    }

    /// To be told when the stream was stopped and started.
    pub(super) fn restart(&mut self) {
        self.restarted = true;
    }

    fn time(&mut self, (seconds, micros): (i64, i64), now_ns: i64) -> i64 {
        let time = seconds.checked_mul(1_000_000_000).and_then(|ns| ns.checked_add(micros.checked_mul(1000)?));
        match time {
            Some(time) if time > 0 && now_ns.abs_diff(time) < MAX_OFFSET_NS.unsigned_abs() => time,
            _ => {
                // No offset is learnt: an odd clock may also jump or wrap. The cost is the jitter of our own waking up, which
                // `stage::timing` takes out.
                self.foreign_times += 1;
                now_ns
            }
        }
    }

    fn count(&mut self, sequence: u32) -> u64 {
        let count = match self.last {
            None => u64::from(sequence),
            Some((_, count)) if self.restarted => count + 1,
            Some((last, count)) => match sequence.wrapping_sub(last) {
                // Drivers that always say 0, and those that restart their count: each frame is still the next.
                0 => count + 1,
                back if back > u32::MAX / 2 => count + 1,
                step => {
                    self.missing += u64::from(step) - 1;
                    count + u64::from(step)
                }
            },
        };
        self.restarted = false;
        self.last = Some((sequence, count));
        count
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn counts(from: &[u32]) -> (Vec<u64>, u64) {
        let mut line = Timeline::default();
        let counts = from.iter().map(|&n| line.stamp(n, (5, 0), 5_000_000_000).sequence).collect();
        (counts, line.missing)
    }

    #[test]
    fn counts_go_on_over_the_wrap() {
        let (count, missing) = counts(&[u32::MAX - 1, u32::MAX, 0, 1, 4]);
        let first = u64::from(u32::MAX) - 1;
        assert_eq!(count, [first, first + 1, first + 2, first + 3, first + 6]);
        assert_eq!(missing, 2);
    }

    #[test]
    fn a_driver_that_counts_nothing_is_counted_for() {
        assert_eq!(counts(&[0, 0, 0]), (vec![0, 1, 2], 0));
        assert_eq!(counts(&[900, 3, 4]), (vec![900, 901, 902], 0), "one that starts anew unasked");
    }

    #[test]
    fn a_restart_goes_on_where_it_was() {
        let mut line = Timeline::default();
        line.stamp(70, (1, 0), 0);
        line.restart();
        assert_eq!(line.stamp(90, (1, 0), 0).sequence, 71, "even where the new count lies ahead");
        assert_eq!(line.stamp(91, (1, 0), 0).sequence, 72);
        assert_eq!(line.missing, 0);
    }

    #[test]
    fn odd_clocks_are_put_on_ours() {
        let now = 100_000_000_000;
        let mut line = Timeline::default();
        assert_eq!(line.stamp(0, (99, 990_000), now).time_ns, 99_990_000_000);
        assert_eq!(line.foreign_times, 0);
        for time in [(0, 0), (9_223_372_020, 0), (i64::MAX, i64::MAX), (2_147_483_632, 0), (i64::MIN, -1), (1_700_000_000, 0)] {
            assert_eq!(line.stamp(1, time, now).time_ns, now, "{time:?}");
        }
        assert_eq!(line.foreign_times, 6);
    }
}
