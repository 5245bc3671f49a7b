//! The heartbeat: the frame path and the supervisor write time stamps, the watchdog thread checks them.

use std::sync::atomic::{AtomicI64, Ordering::Relaxed};
use std::time::Duration;

use crate::control::{DaemonState, Losses, Phase};
use crate::frame::Frame;
use crate::image::PictureRef;
use crate::pipeline::{Observer, Reasons};
use crate::rt::clock::monotonic_ns;
use crate::rt::notifier::Notifier;

use super::calibration_store::CalibrationStore;

/// How often systemd's status line is refreshed.
const STATUS_EVERY: Duration = Duration::from_secs(5);

/// A frame that was captured this long before the last (nanoseconds) must have been sent: more than the pipeline ever holds back.
const LATE_NS: i64 = 1_000_000_000;

/// Written by the frame path (a few atomic stores a frame), read by [`run_watchdog`].
#[derive(Debug)]
pub(super) struct Heartbeat<'a> {
    state: &'a DaemonState,
    /// When there was progress last, or nothing to do.
    beat_ns: AtomicI64,
    captured_ns: AtomicI64,
    sent_ns: AtomicI64,
}

impl<'a> Heartbeat<'a> {
    pub(super) fn new(state: &'a DaemonState) -> Self {
        Self {
            state,
            beat_ns: AtomicI64::new(monotonic_ns()),
            captured_ns: AtomicI64::new(i64::MIN),
            sent_ns: AtomicI64::new(i64::MIN),
        }
    }

    /// There is progress, or a wait for something that can be named.
    pub(super) fn beat(&self) {
        self.beat_ns.store(monotonic_ns(), Relaxed);
    }

    /// What the daemon is doing, for `systemctl status` and `gimbald status`; while it streams, its rate is added.
    pub(super) fn set_activity(&self, what: String, phase: Phase) {
        self.state.systemd().status(&what);
        self.state.metrics.set_phase(phase, &what);
    }

    /// The camera gave a frame at `now_ns`.
    pub(super) fn frame_captured(&self, now_ns: i64) {
        self.captured_ns.store(now_ns, Relaxed);
    }

    /// What the camera lost since it was opened; `reported` as [`crate::control::Metrics::add_losses`].
    pub(super) fn add_losses(&self, now: Losses, reported: &mut Losses) {
        self.state.metrics.add_losses(now, reported);
    }

    /// Frames of which a part was shown, in all streams.
    pub(super) fn cut(&self) -> u64 {
        self.state.live.counts().cut
    }

    /// Frames of the present stream, and how many of them could not be used.
    pub(super) fn stream_counts(&self) -> (u64, u64) {
        self.state.live.stream_counts()
    }

    /// The same with the reasons.
    pub(super) fn stream(&self) -> (u64, Reasons) {
        self.state.live.stream()
    }

    /// The camera gives nothing. That is progress only if what it gave before has been sent.
    pub(super) fn camera_idle(&self) {
        if self.sent_ns.load(Relaxed) >= self.captured_ns.load(Relaxed).saturating_sub(LATE_NS) {
            self.beat();
        }
    }

    fn frame_sent(&self) {
        let now = monotonic_ns();
        self.beat_ns.store(now, Relaxed);
        self.sent_ns.store(now, Relaxed);
        self.state.ready();
    }
}

/// Feeds systemd's watchdog while there are beats, refreshes its status line, and records calibrations in `store`, until `done` is
/// notified.
pub(super) fn run_watchdog(heartbeat: &Heartbeat<'_>, store: &CalibrationStore, done: &Notifier) {
    let (systemd, metrics) = (heartbeat.state.systemd(), &heartbeat.state.metrics);
    let watchdog = systemd.watchdog();
    let period = watchdog.map_or(STATUS_EVERY, |limit| (limit / 4).min(STATUS_EVERY));
    let (mut shown_ns, mut shown_sent, mut shown_age_s) = (monotonic_ns(), 0, 0.0);
    while !done.wait(period) {
        let now = monotonic_ns();
        let silent_ns = now.saturating_sub(heartbeat.beat_ns.load(Relaxed));
        if let Some(limit) = watchdog {
            if i128::from(silent_ns) < (limit / 2).as_nanos() as i128 {
                systemd.alive();
            } else {
                tracing::error!(seconds = silent_ns / 1_000_000_000, "pipeline stalled, watchdog withheld");
            }
        }
        metrics.calibration().inspect(|found| store.record(found));
        if now - shown_ns >= STATUS_EVERY.as_nanos() as i64 {
            let (sent, age_s) = (metrics.frames_sent().0, metrics.latency_sum_s());
            let frames = sent - shown_sent;
            let (phase, activity) = metrics.activity();
            if frames > 0 && phase == Phase::Streaming {
                let fps = frames as f64 * 1e9 / (now - shown_ns) as f64;
                let latency_ms = 1e3 * (age_s - shown_age_s) / frames as f64;
                systemd.status(&format!("{activity}; {fps:.1} fps, latency {latency_ms:.0} ms, {sent} frames sent"));
            }
            (shown_ns, shown_sent, shown_age_s) = (now, sent, age_s);
        }
    }
}

/// Marks each frame that was sent.
impl Observer for &Heartbeat<'_> {
    fn drawn(&mut self, _: &Frame, _: PictureRef<'_>) {}

    fn sent(&mut self, frame: &Frame) {
        self.state.metrics.sent(frame);
        self.frame_sent();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Settings;
    use crate::systemd::Systemd;

    #[test]
    fn an_idle_camera_is_progress_only_when_its_frames_were_sent() {
        let state = DaemonState::new(Settings::default(), Systemd::disconnected(), Box::new(|| Err("there is no file".into())));
        let heartbeat = Heartbeat::new(&state);
        heartbeat.beat_ns.store(0, Relaxed);
        heartbeat.camera_idle();
        assert_ne!(heartbeat.beat_ns.load(Relaxed), 0, "nothing was ever captured");
        heartbeat.frame_captured(monotonic_ns());
        heartbeat.beat_ns.store(0, Relaxed);
        heartbeat.camera_idle();
        assert_eq!(heartbeat.beat_ns.load(Relaxed), 0, "what was captured is stuck");
        (&mut &heartbeat).sent(&Frame::default());
        heartbeat.beat_ns.store(0, Relaxed);
        heartbeat.camera_idle();
        assert_ne!(heartbeat.beat_ns.load(Relaxed), 0);
        assert_eq!(state.metrics.frames_sent().0, 1);
    }
}
