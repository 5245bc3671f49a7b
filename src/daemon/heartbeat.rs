//! Signs of life: what the frame path leaves behind in passing, and who looks at it from time to time.

use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicI64, AtomicU64, Ordering::Relaxed};
use std::time::Duration;

use crate::control::{DaemonState, Losses, Phase};
use crate::frame::{Frame, Outcome};
use crate::geometry::Calibration;
use crate::image::PictureRef;
use crate::pipeline::{Observer, Reasons};
use crate::rt::clock::monotonic_ns;
use crate::rt::notifier::Notifier;
use crate::systemd::Systemd;

use super::calibration_store::CalibrationStore;

/// How often the status line is told anew, at most.
const STATUS_EVERY: Duration = Duration::from_secs(5);

/// A frame that was lent this long before the last (nanoseconds) must have been sent: more than the pipeline ever holds back.
const LATE_NS: i64 = 1_000_000_000;

/// Written by the frame path (a few atomic stores a frame), read by [`run_watchdog`].
#[derive(Debug)]
pub(super) struct Heartbeat<'a> {
    systemd: Systemd,
    state: &'a DaemonState,
    ready: AtomicBool,
    streaming: AtomicBool,
    /// When the daemon last got on, or had nothing to do and knew it.
    beat_ns: AtomicI64,
    lent_ns: AtomicI64,
    sent_ns: AtomicI64,
    sent: AtomicU64,
    stabilized: AtomicU64,
    /// Sum of the frames' ages when they were sent.
    age_ns: AtomicI64,
    /// What the newest frame says of the camera: the bits of a [`Calibration`]'s numbers, in its order. They are not read and written
    /// as one; but they move slowly, so a few that are a frame older than the rest do no harm.
    calibration: [AtomicU64; 4],
    /// What the daemon is at; changes with the devices, not with frames.
    doing: Mutex<String>,
}

impl<'a> Heartbeat<'a> {
    pub(super) fn new(systemd: Systemd, state: &'a DaemonState) -> Self {
        Self {
            systemd,
            state,
            ready: AtomicBool::new(false),
            streaming: AtomicBool::new(false),
            beat_ns: AtomicI64::new(monotonic_ns()),
            lent_ns: AtomicI64::new(i64::MIN),
            sent_ns: AtomicI64::new(i64::MIN),
            sent: AtomicU64::new(0),
            stabilized: AtomicU64::new(0),
            age_ns: AtomicI64::new(0),
            calibration: Default::default(),
            doing: Mutex::new(String::new()),
        }
    }

    /// The daemon gets on, or waits for something it can name.
    pub(super) fn beat(&self) {
        self.beat_ns.store(monotonic_ns(), Relaxed);
    }

    /// Says what the daemon is at, for `systemctl status` and whoever asks; while it is streaming, its rate will be added.
    pub(super) fn set_activity(&self, what: String, state: Phase) {
        self.systemd.status(&what);
        self.state.metrics.set_phase(state, &what);
        self.streaming.store(state == Phase::Streaming, Relaxed);
        *self.doing.lock().unwrap_or_else(std::sync::PoisonError::into_inner) = what;
    }

    /// The service is ready, if it was not before.
    pub(super) fn ready(&self) {
        if !self.ready.load(Relaxed) && !self.ready.swap(true, Relaxed) {
            self.systemd.ready();
            self.state.set_ready();
        }
    }

    /// Frames sent so far, and how many of them were stabilized.
    pub(super) fn sent(&self) -> (u64, u64) {
        (self.sent.load(Relaxed), self.stabilized.load(Relaxed))
    }

    /// What is believed of the camera; all 0 where nothing is.
    pub(super) fn calibration(&self) -> Calibration {
        let [readout_s, readout_deviation_s, hfov_deg, hfov_deviation_deg] =
            [0, 1, 2, 3].map(|i: usize| f64::from_bits(self.calibration[i].load(Relaxed)));
        Calibration { readout_s, readout_deviation_s, hfov_deg, hfov_deviation_deg }
    }

    /// The same, where a stream has ended: the next one may be another camera's.
    pub(super) fn take_calibration(&self) -> Calibration {
        let found = self.calibration();
        self.keep_calibration(&Calibration::default());
        found
    }

    fn keep_calibration(&self, found: &Calibration) {
        let numbers = [found.readout_s, found.readout_deviation_s, found.hfov_deg, found.hfov_deviation_deg];
        self.calibration.iter().zip(numbers).for_each(|(kept, number)| kept.store(number.to_bits(), Relaxed));
    }

    /// The camera gave a frame at `now_ns`.
    pub(super) fn frame_captured(&self, now_ns: i64) {
        self.lent_ns.store(now_ns, Relaxed);
    }

    /// What the camera lost since it was opened; `told` as [`crate::control::Metrics::add_losses`].
    pub(super) fn add_losses(&self, now: Losses, told: &mut Losses) {
        self.state.metrics.add_losses(now, told);
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

    /// The camera gives nothing. That is life only if what it gave before has been sent.
    pub(super) fn camera_idle(&self) {
        if self.sent_ns.load(Relaxed) >= self.lent_ns.load(Relaxed).saturating_sub(LATE_NS) {
            self.beat();
        }
    }

    fn frame_sent(&self, taken_ns: i64, outcome: Outcome) {
        let now = monotonic_ns();
        self.beat_ns.store(now, Relaxed);
        self.sent_ns.store(now, Relaxed);
        self.sent.fetch_add(1, Relaxed);
        self.age_ns.fetch_add(now.saturating_sub(taken_ns), Relaxed);
        if outcome == Outcome::Stabilized {
            self.stabilized.fetch_add(1, Relaxed);
        }
        self.ready();
    }
}

/// Feeds systemd's watchdog while there are beats, and its status line, and records calibrations in `store`, until `done` is notified.
pub(super) fn run_watchdog(heartbeat: &Heartbeat<'_>, store: &CalibrationStore, done: &Notifier) {
    let watchdog = heartbeat.systemd.watchdog();
    let period = watchdog.map_or(STATUS_EVERY, |limit| (limit / 4).min(STATUS_EVERY));
    let (mut told_ns, mut told_sent, mut told_age) = (monotonic_ns(), 0, 0);
    while !done.wait(period) {
        let now = monotonic_ns();
        let silent_ns = now.saturating_sub(heartbeat.beat_ns.load(Relaxed));
        if let Some(limit) = watchdog {
            if i128::from(silent_ns) < (limit / 2).as_nanos() as i128 {
                heartbeat.systemd.alive();
            } else {
                tracing::error!(seconds = silent_ns / 1_000_000_000, "nothing gets on: the watchdog is not fed");
            }
        }
        store.record(&heartbeat.calibration());
        if now - told_ns >= STATUS_EVERY.as_nanos() as i64 {
            let (sent, age) = (heartbeat.sent.load(Relaxed), heartbeat.age_ns.load(Relaxed));
            let frames = sent - told_sent;
            if frames > 0 && heartbeat.streaming.load(Relaxed) {
                let fps = frames as f64 * 1e9 / (now - told_ns) as f64;
                let age_ms = (age - told_age) as f64 / frames as f64 / 1e6;
                let doing = heartbeat.doing.lock().unwrap_or_else(std::sync::PoisonError::into_inner).clone();
                heartbeat
                    .systemd
                    .status(&format!("{doing}; {fps:.1} frames a second, {age_ms:.0} ms old when sent, {sent} in all"));
            }
            (told_ns, told_sent, told_age) = (now, sent, age);
        }
    }
}

/// Marks each frame that was sent.
impl Observer for &Heartbeat<'_> {
    fn drawn(&mut self, _: &Frame, _: PictureRef<'_>) {}

    fn sent(&mut self, frame: &Frame) {
        self.state.metrics.sent(frame);
        self.frame_sent(frame.stamp.time_ns, frame.context.outcome);
        self.keep_calibration(&frame.context.calibration);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Settings;

    fn state() -> DaemonState {
        DaemonState::new(Settings::default(), Systemd::nobody(), Box::new(|| Err("there is no file".into())))
    }

    #[test]
    fn an_idle_camera_is_life_only_when_its_frames_were_sent() {
        let state = state();
        let heartbeat = Heartbeat::new(Systemd::from_env(), &state);
        heartbeat.beat_ns.store(0, Relaxed);
        heartbeat.camera_idle();
        assert_ne!(heartbeat.beat_ns.load(Relaxed), 0, "nothing was ever lent");
        heartbeat.frame_captured(monotonic_ns());
        heartbeat.beat_ns.store(0, Relaxed);
        heartbeat.camera_idle();
        assert_eq!(heartbeat.beat_ns.load(Relaxed), 0, "what was lent is stuck");
        heartbeat.frame_sent(0, Outcome::Stabilized);
        heartbeat.beat_ns.store(0, Relaxed);
        heartbeat.camera_idle();
        assert_ne!(heartbeat.beat_ns.load(Relaxed), 0);
        assert_eq!(heartbeat.sent(), (1, 1));
    }

    #[test]
    fn the_calibration_of_the_frame_sent_last_is_there_until_it_is_taken() {
        let state = state();
        let heartbeat = Heartbeat::new(Systemd::from_env(), &state);
        assert_eq!(heartbeat.calibration(), Calibration::default());
        let found = Calibration { readout_s: -0.02, readout_deviation_s: 1e-4, hfov_deg: 61.0, hfov_deviation_deg: 0.2 };
        let mut frame = Frame::default();
        frame.context.calibration = found;
        (&mut &heartbeat).sent(&frame);
        assert_eq!(
            (heartbeat.calibration(), heartbeat.take_calibration(), heartbeat.calibration()),
            (found, found, Calibration::default())
        );
    }
}
