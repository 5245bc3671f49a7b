//! When a stream without frames is restarted: some cameras stop delivering after a bus error or a suspend.

use std::fmt;

const SECOND_NS: i64 = 1_000_000_000;

/// Silence after which the stream is restarted (nanoseconds): at first, and at most, after it was doubled with each restart that did
/// not help.
const PAUSE_NS: (i64, i64) = (5 * SECOND_NS, 60 * SECOND_NS);

/// The same after a failed transfer, which is known to silence cameras.
const AFTER_FAILURE_NS: i64 = SECOND_NS;

/// A restart helped when so many frames came after it. One alone is no stream: a camera whose frame markers (FID) never change gives
/// one with each start.
const HELPED: u64 = 10;

/// Follows the frames of a stream. Times are nanoseconds on any clock that does not run back.
#[derive(Clone, Copy, Debug)]
pub(super) struct Stall {
    /// When the stream was started or gave a frame.
    since_ns: i64,
    /// Frames since the start.
    frames: u64,
    pause_ns: i64,
    /// A transfer failed since the last frame.
    failure: bool,
    reported: bool,
}

/// A stream that is to be restarted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Stalled {
    /// For so long no frame came.
    seconds: i64,
    /// So many came after the start before.
    frames: u64,
    /// Whether it was not said of this series of restarts.
    pub(super) is_new: bool,
}

impl Stall {
    pub(super) fn new() -> Self {
        Self { since_ns: 0, frames: 0, pause_ns: PAUSE_NS.0, failure: false, reported: false }
    }

    /// The stream was started.
    pub(super) fn started(&mut self, now_ns: i64) {
        (self.since_ns, self.frames, self.failure) = (now_ns, 0, false);
    }

    /// A frame came.
    pub(super) fn frame(&mut self, now_ns: i64) {
        (self.since_ns, self.failure) = (now_ns, false);
        self.frames += 1;
        if self.frames == HELPED {
            (self.pause_ns, self.reported) = (PAUSE_NS.0, false);
        }
    }

    /// A transfer failed.
    pub(super) fn transfer_failed(&mut self) {
        self.failure = true;
    }

    /// To be asked when no frame came for a moment: says when the stream is to be restarted.
    pub(super) fn look(&mut self, now_ns: i64) -> Option<Stalled> {
        let silent_ns = now_ns.saturating_sub(self.since_ns);
        // Once: where the stream stays silent after that, the usual pauses count.
        let pause_ns = if self.failure { AFTER_FAILURE_NS } else { self.pause_ns };
        if silent_ns < pause_ns {
            return None;
        }
        let stalled = Stalled { seconds: silent_ns / SECOND_NS, frames: self.frames, is_new: !self.reported };
        if !self.failure {
            self.pause_ns = self.pause_ns.saturating_mul(2).min(PAUSE_NS.1);
        }
        self.reported = true;
        Some(stalled)
    }
}

impl fmt::Display for Stalled {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { seconds, frames, .. } = *self;
        match frames {
            0 => write!(f, "no frames for {seconds} s")?,
            1 => write!(
                f,
                "one frame when the stream started, then none for {seconds} s (if that happens at every start, \
                 the camera does not mark where a frame ends: try `options uvcvideo quirks=0x10` in /etc/modprobe.d)"
            )?,
            _ => write!(f, "no frames for {seconds} s, after {frames}")?,
        }
        write!(f, "; restarting the stream, and again after increasing pauses until frames arrive")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Restarts of a camera that gives, after each start, the frames at these times (seconds); asked each second.
    fn restarts(seconds: i64, frames: &[f64], fails: bool) -> Vec<(i64, bool)> {
        let (mut stall, mut started, mut next, mut reports) = (Stall::new(), 0, 0, Vec::new());
        stall.started(0);
        if fails {
            stall.transfer_failed();
        }
        for tick in 0..seconds * 10 {
            let now = tick * SECOND_NS / 10;
            while frames.get(next).is_some_and(|at| started + (at * 1e9) as i64 <= now) {
                stall.frame(now);
                next += 1;
            }
            if tick % 10 == 9
                && let Some(stalled) = stall.look(now)
            {
                reports.push((tick / 10, stalled.is_new));
                stall.started(now);
                (started, next) = (now, 0);
            }
        }
        reports
    }

    #[test]
    fn silence_is_said_once_and_tried_ever_more_rarely() {
        let reports = restarts(400, &[], false);
        assert_eq!(reports.iter().map(|(at, _)| *at).collect::<Vec<_>>(), [5, 15, 35, 75, 135, 195, 255, 315, 375]);
        assert_eq!(reports.iter().filter(|(_, new)| *new).count(), 1);
    }

    #[test]
    fn one_frame_with_each_start_does_not_count_as_help() {
        let reports = restarts(400, &[0.1], false);
        assert!(reports.len() <= 9, "{reports:?}");
        assert_eq!(reports.iter().filter(|(_, new)| *new).count(), 1, "{reports:?}");
    }

    #[test]
    fn a_stream_that_runs_for_a_while_is_restarted_soon_and_each_time_said() {
        let second: Vec<f64> = (0..30).map(|n| f64::from(n) / 30.0).collect();
        let reports = restarts(70, &second, false);
        assert!(reports.len() >= 9 && reports.iter().all(|(_, new)| *new), "{reports:?}");
    }

    #[test]
    fn after_a_failed_transfer_it_is_not_waited_for_long() {
        assert_eq!(restarts(20, &[], true), [(1, true), (6, false), (16, false)]);
    }

    #[test]
    fn what_happened_is_said_in_words() {
        let said = |frames| Stalled { seconds: 5, frames, is_new: true }.to_string();
        assert!(said(0).starts_with("no frames for 5 s; "));
        assert!(said(1).starts_with("one frame when") && said(1).contains("quirks=0x10"));
        assert!(said(700).starts_with("no frames for 5 s, after 700; "));
    }
}
