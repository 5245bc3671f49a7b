//! Counters of the frame path: atomic numbers, written per frame, read by the status, Prometheus and the log.

use std::sync::atomic::{AtomicI64, AtomicU32, AtomicU64, Ordering::Relaxed};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use super::history::{History, HistoryPart};
use super::status::{CameraInfo, OutputInfo, PipewireInfo, RejectedFormat, Spread};
use crate::frame::{Frame, Outcome};
use crate::geometry::{Calibration, Estimate};
use crate::rt::clock::monotonic_ns;

/// What a daemon is at.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Phase {
    /// It has begun, and nothing is known yet.
    #[default]
    Starting,
    /// What it needs is not there.
    Waiting,
    /// No viewers: the camera is left alone.
    Idle,
    /// Frames go through.
    Streaming,
    /// It ends.
    Stopping,
}

impl Phase {
    /// Every state.
    pub const ALL: [Self; 5] = [Self::Starting, Self::Waiting, Self::Idle, Self::Streaming, Self::Stopping];

    /// Its name in answers.
    pub fn name(self) -> &'static str {
        match self {
            Self::Starting => "starting",
            Self::Waiting => "waiting",
            Self::Idle => "idle",
            Self::Streaming => "streaming",
            Self::Stopping => "stopping",
        }
    }
}

/// Upper bounds of the histogram of frames' ages (ms); above the last there is one more.
pub(super) const AGE_BOUNDS_MS: [f64; 16] =
    [1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 33.0, 50.0, 75.0, 100.0, 200.0, 500.0, 1000.0];
/// Frames of which each measure is remembered: 17 seconds at 30 a second.
const REMEMBERED: usize = 512;
/// What a new interval between frames counts for in their rate.
const NEWS: f64 = 0.05;
/// The rate counts as nothing when no frame came for so many of its intervals, and at least this long (seconds).
const SILENCE: (f64, f64) = (4.0, 1.0);

/// What went wrong between a camera and its driver, since it was opened.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Losses {
    /// Frames that the driver counted but did not give.
    pub missing: u64,
    /// Frames that were skipped because a newer one was there.
    pub stale: u64,
    /// Transfers that failed.
    pub failed_transfers: u64,
    /// Times the stream was stopped and started.
    pub restarts: u64,
}

/// The counts of a daemon's life.
#[derive(Debug)]
pub struct Metrics {
    born: Instant,
    sent: AtomicU64,
    stabilized: AtomicU64,
    held: AtomicU64,
    passed_through: AtomicU64,
    missing: AtomicU64,
    stale: AtomicU64,
    failed_transfers: AtomicU64,
    restarts: AtomicU64,
    cameras: AtomicU64,
    /// Frames' ages when they were sent: how many within each bound, and their sum (ns).
    ages: [AtomicU64; AGE_BOUNDS_MS.len() + 1],
    age_sum_ns: AtomicU64,
    recent_age_ms: Recent,
    recent_work_ms: Recent,
    recent_crop_use: Recent,
    last_sent_ns: AtomicI64,
    /// Smoothed interval between frames sent (bits of seconds); 0 before the second.
    interval_s: AtomicU64,
    inliers: AtomicU64,
    tracks: AtomicU64,
    confidence: AtomicU64,
    trust: AtomicU64,
    calibration: [AtomicU64; 6],
    history: History,
    now: Mutex<Current>,
}

/// What changes with devices, not with frames.
struct Current {
    state: Phase,
    what: String,
    since: Instant,
    camera: Option<CameraInfo>,
    output: Option<OutputInfo>,
    formats_left: Vec<RejectedFormat>,
    /// Counts the loopback's readers.
    watchers: Option<Box<dyn Fn() -> u32 + Send>>,
    /// Counts PipeWire companions.
    pipewire: Option<Box<dyn Fn() -> PipewireInfo + Send>>,
}

impl std::fmt::Debug for Current {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Current").field("state", &self.state).field("what", &self.what).finish_non_exhaustive()
    }
}

/// The last values of a measure, in no order.
#[derive(Debug)]
struct Recent {
    values: [AtomicU32; REMEMBERED],
    count: AtomicU64,
}

impl Recent {
    fn new() -> Self {
        Self { values: std::array::from_fn(|_| AtomicU32::new(0)), count: AtomicU64::new(0) }
    }

    /// One writer at a time.
    fn add(&self, value: f64) {
        let count = self.count.load(Relaxed);
        self.values[count as usize % REMEMBERED].store((value as f32).to_bits(), Relaxed);
        self.count.store(count + 1, Relaxed);
    }

    fn spread(&self) -> Option<Spread> {
        let count = self.count.load(Relaxed).min(REMEMBERED as u64) as usize;
        let mut values: Vec<f32> = self.values[..count].iter().map(|value| f32::from_bits(value.load(Relaxed))).collect();
        values.sort_unstable_by(f32::total_cmp);
        let at = |share: f64| f64::from(values[((count - 1) as f64 * share).round() as usize]);
        (count > 0).then(|| Spread { p50: at(0.5), p99: at(0.99), max: at(1.0) })
    }
}

impl Default for Metrics {
    fn default() -> Self {
        let born = Instant::now();
        let now = Current {
            state: Phase::default(),
            what: String::new(),
            since: born,
            camera: None,
            output: None,
            formats_left: Vec::new(),
            watchers: None,
            pipewire: None,
        };
        Self {
            born,
            sent: AtomicU64::new(0),
            stabilized: AtomicU64::new(0),
            held: AtomicU64::new(0),
            passed_through: AtomicU64::new(0),
            missing: AtomicU64::new(0),
            stale: AtomicU64::new(0),
            failed_transfers: AtomicU64::new(0),
            restarts: AtomicU64::new(0),
            cameras: AtomicU64::new(0),
            ages: Default::default(),
            age_sum_ns: AtomicU64::new(0),
            recent_age_ms: Recent::new(),
            recent_work_ms: Recent::new(),
            recent_crop_use: Recent::new(),
            last_sent_ns: AtomicI64::new(i64::MIN),
            interval_s: AtomicU64::new(0),
            inliers: AtomicU64::new(0),
            tracks: AtomicU64::new(0),
            confidence: AtomicU64::new(0),
            trust: AtomicU64::new(0),
            calibration: Default::default(),
            history: History::default(),
            now: Mutex::new(now),
        }
    }
}

impl Metrics {
    /// A frame was sent. On the frame path: a few atomic stores.
    pub fn sent(&self, frame: &Frame) {
        let (now, context) = (monotonic_ns(), &frame.context);
        self.sent.fetch_add(1, Relaxed);
        let outcome = match context.outcome {
            Outcome::Stabilized | Outcome::Pending => &self.stabilized,
            Outcome::Held(_) => &self.held,
            Outcome::PassedThrough(_) => &self.passed_through,
        };
        outcome.fetch_add(1, Relaxed);
        let age_ns = now.saturating_sub(frame.stamp.time_ns).max(0);
        let age_ms = age_ns as f64 * 1e-6;
        self.ages[AGE_BOUNDS_MS.partition_point(|bound| *bound < age_ms)].fetch_add(1, Relaxed);
        self.age_sum_ns.fetch_add(age_ns.unsigned_abs(), Relaxed);
        self.recent_age_ms.add(age_ms);
        self.recent_work_ms.add(context.spent_ns.iter().sum::<u64>() as f64 * 1e-6);
        self.recent_crop_use.add(context.crop_use);
        let before = self.last_sent_ns.swap(now, Relaxed);
        if before != i64::MIN {
            let (mean, new) = (load(&self.interval_s), now.saturating_sub(before) as f64 * 1e-9);
            // after a pause the rate is measured from its start again
            let pause = mean == 0.0 || new > SILENCE.1.max(SILENCE.0 * mean);
            store(&self.interval_s, if pause { new.min(1.0) } else { mean + NEWS * (new - mean) });
        }
        self.inliers.store(u64::from(context.fit.inliers), Relaxed);
        self.tracks.store(u64::from(context.fit.tracks), Relaxed);
        store(&self.confidence, context.confidence);
        store(&self.trust, context.trust);
        let Calibration { readout_s, hfov_deg, lens_k1 } = context.calibration.unwrap_or_default();
        for (kept, estimate) in self.calibration.chunks(2).zip([readout_s, hfov_deg, lens_k1]) {
            store(&kept[0], estimate.value);
            store(&kept[1], estimate.sigma);
        }
        self.history.add(frame, age_ms);
    }

    /// What happened to the last frames, from number `first` on.
    pub(super) fn history_since(&self, first: u64) -> HistoryPart {
        self.history.since(first)
    }

    /// A camera says what it lost since it was opened; `known` is what it said before, and is brought up to date.
    pub fn add_losses(&self, now: Losses, known: &mut Losses) {
        if now != *known {
            self.missing.fetch_add(now.missing.saturating_sub(known.missing), Relaxed);
            self.stale.fetch_add(now.stale.saturating_sub(known.stale), Relaxed);
            self.failed_transfers.fetch_add(now.failed_transfers.saturating_sub(known.failed_transfers), Relaxed);
            self.restarts.fetch_add(now.restarts.saturating_sub(known.restarts), Relaxed);
            *known = now;
        }
    }

    /// Frames sent since the daemon started, and how many of them were stabilized.
    pub fn frames_sent(&self) -> (u64, u64) {
        (self.sent.load(Relaxed), self.stabilized.load(Relaxed))
    }

    /// The sum of all sent frames' ages when they were sent, seconds.
    pub fn latency_sum_s(&self) -> f64 {
        self.age_sum_ns.load(Relaxed) as f64 * 1e-9
    }

    /// What the newest frame says of the camera; `None` where no camera is open or its model estimates nothing. Its numbers are not read as one, but they move
    /// slowly: a few that are a frame older than the rest do no harm.
    pub fn calibration(&self) -> Option<Calibration> {
        let [readout_s, hfov_deg, lens_k1] = std::array::from_fn(|i| {
            let [value, sigma] = [0, 1].map(|j| load(&self.calibration[2 * i + j]));
            Estimate { value, sigma }
        });
        // every camera sees something
        (hfov_deg.value > 0.0).then_some(Calibration { readout_s, hfov_deg, lens_k1 })
    }

    /// What the daemon is doing, with a sentence for people.
    pub fn activity(&self) -> (Phase, String) {
        let now = self.now();
        (now.state, now.what.clone())
    }

    /// Sets what the daemon is doing, with a sentence for people.
    pub fn set_phase(&self, state: Phase, what: &str) {
        let mut now = self.now();
        if now.state != state {
            now.since = Instant::now();
        }
        (now.state, now.what) = (state, what.to_owned());
    }

    /// A camera was opened.
    pub fn set_camera(&self, camera: CameraInfo) {
        self.cameras.fetch_add(1, Relaxed);
        self.now().camera = Some(camera);
    }

    /// The camera was closed, or went away.
    pub fn clear_camera(&self) {
        self.now().camera = None;
        self.calibration.iter().for_each(|kept| store(kept, 0.0));
    }

    /// Formats that were left for another because they gave no usable frame.
    pub fn set_rejected_formats(&self, formats: Vec<RejectedFormat>) {
        self.now().formats_left = formats;
    }

    /// The output was opened; `watchers` counts the loopback's readers, where there is one.
    pub fn set_output(&self, output: OutputInfo, watchers: Option<Box<dyn Fn() -> u32 + Send>>) {
        let mut now = self.now();
        (now.output, now.watchers) = (Some(output), watchers);
    }

    /// PipeWire companions may connect; `companions` counts them.
    pub fn set_pipewire(&self, companions: Box<dyn Fn() -> PipewireInfo + Send>) {
        self.now().pipewire = Some(companions);
    }

    /// The output was closed, or went away.
    pub fn clear_output(&self) {
        let mut now = self.now();
        (now.output, now.watchers) = (None, None);
    }

    fn now(&self) -> MutexGuard<'_, Current> {
        self.now.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes the parts of a [`super::Status`] that are counted here.
    pub(super) fn fill(&self, status: &mut super::Status) {
        let of = |count: &AtomicU64| count.load(Relaxed);
        {
            let now = self.now();
            status.state = now.state.name().to_owned();
            status.what.clone_from(&now.what);
            status.since_s = now.since.elapsed().as_secs_f64();
            (status.camera, status.output) = (now.camera.clone(), now.output.clone());
            // One that is tried again is not left while it is.
            let is_used = |left: &RejectedFormat| {
                now.camera.as_ref().is_some_and(|camera| camera.name == left.camera && camera.format == left.format)
            };
            status.formats_left = now.formats_left.iter().filter(|left| !is_used(left)).cloned().collect();
            status.watchers = now.watchers.as_ref().map(|watchers| watchers());
            status.pipewire = now.pipewire.as_ref().map(|companions| companions());
            let nodes = status.pipewire.map_or(0, |pipewire| pipewire.watched + pipewire.pages);
            status.watched = now.output.as_ref().map(|_| status.watchers.unwrap_or(0) + nodes > 0);
        }
        status.uptime_s = self.born.elapsed().as_secs_f64();
        status.fps = self.rate();
        status.latency_ms = self.recent_age_ms.spread();
        status.work_ms = self.recent_work_ms.spread();
        status.crop_use = self.recent_crop_use.spread();
        let frames = &mut status.frames;
        (frames.sent, frames.stabilized) = (of(&self.sent), of(&self.stabilized));
        (frames.held, frames.passed_through) = (of(&self.held), of(&self.passed_through));
        let drops = &mut status.drops;
        (drops.camera_missing, drops.camera_stale) = (of(&self.missing), of(&self.stale));
        (drops.failed_transfers, drops.restarts) = (of(&self.failed_transfers), of(&self.restarts));
        status.cameras_opened = of(&self.cameras);
        (status.inliers, status.tracks) = (of(&self.inliers), of(&self.tracks));
        (status.confidence, status.trust) = (load(&self.confidence), load(&self.trust));
        status.found = self.calibration().map(|Calibration { readout_s, hfov_deg, lens_k1 }| super::Found {
            readout_ms: 1e3 * readout_s.value,
            readout_deviation_ms: 1e3 * readout_s.sigma,
            hfov_deg: hfov_deg.value,
            hfov_deviation_deg: hfov_deg.sigma,
            lens_k1: lens_k1.value,
            lens_k1_deviation: lens_k1.sigma,
        });
    }

    /// Frames sent a second of late; 0 where none were.
    fn rate(&self) -> f64 {
        let (interval_s, last) = (load(&self.interval_s), self.last_sent_ns.load(Relaxed));
        if last == i64::MIN || interval_s <= 0.0 {
            return 0.0;
        }
        let silent_s = monotonic_ns().saturating_sub(last) as f64 * 1e-9;
        if silent_s > SILENCE.1.max(SILENCE.0 * interval_s) { 0.0 } else { 1.0 / interval_s }
    }

    /// Frames within each bound of [`AGE_BOUNDS_MS`] and above, and the sum of their ages (seconds).
    pub(super) fn ages(&self) -> ([u64; AGE_BOUNDS_MS.len() + 1], f64) {
        (std::array::from_fn(|i| self.ages[i].load(Relaxed)), self.latency_sum_s())
    }
}

fn load(number: &AtomicU64) -> f64 {
    f64::from_bits(number.load(Relaxed))
}

fn store(number: &AtomicU64, value: f64) {
    number.store(value.to_bits(), Relaxed);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::Status;
    use crate::frame::{HoldReason, PassReason};

    fn status_of(metrics: &Metrics) -> Status {
        let mut status = Status::default();
        metrics.fill(&mut status);
        status
    }

    #[test]
    fn frames_are_counted_by_what_became_of_them() {
        let metrics = Metrics::default();
        assert_eq!((status_of(&metrics).fps, status_of(&metrics).latency_ms), (0.0, None));
        let mut frame = Frame::default();
        for outcome in [
            Outcome::Stabilized,
            Outcome::Stabilized,
            Outcome::Held(HoldReason::Damaged),
            Outcome::PassedThrough(PassReason::SwitchedOff),
        ] {
            frame.context.outcome = outcome;
            frame.context.crop_use = 0.5;
            frame.context.spent_ns[2] = 3_000_000;
            frame.stamp.time_ns = monotonic_ns() - 20_000_000;
            metrics.sent(&frame);
        }
        let status = status_of(&metrics);
        let frames = status.frames;
        assert_eq!((frames.sent, frames.stabilized, frames.held, frames.passed_through), (4, 2, 1, 1));
        assert_eq!(status.crop_use, Some(Spread { p50: 0.5, p99: 0.5, max: 0.5 }));
        assert_eq!(status.work_ms.map(|work| work.max), Some(3.0));
        assert!(status.latency_ms.is_some_and(|age| age.p50 >= 20.0), "{status:?}");
        assert!(status.fps > 0.0 && status.found.is_none());
        let (ages, sum_s) = metrics.ages();
        assert_eq!(ages.iter().sum::<u64>(), 4);
        assert_eq!(ages[..8].iter().sum::<u64>(), 0, "none is younger than 16 ms");
        assert!(sum_s >= 0.08);
    }

    #[test]
    fn the_newest_values_are_remembered() {
        let recent = Recent::new();
        (0..3 * REMEMBERED).for_each(|n| recent.add(n as f64));
        let spread = recent.spread().unwrap();
        assert_eq!(spread.max, (3 * REMEMBERED - 1) as f64);
        assert!((spread.p50 - 2.5 * REMEMBERED as f64).abs() < 2.0, "{spread:?}");
    }

    #[test]
    fn a_camera_that_is_opened_anew_counts_on() {
        let metrics = Metrics::default();
        for _ in 0..2 {
            let mut known = Losses::default();
            let three = Losses { missing: 3, ..Losses::default() };
            metrics.add_losses(three, &mut known);
            metrics.add_losses(three, &mut known);
            metrics.add_losses(Losses { missing: 5, stale: 1, failed_transfers: 2, restarts: 3 }, &mut known);
        }
        let drops = status_of(&metrics).drops;
        assert_eq!((drops.camera_missing, drops.camera_stale), (10, 2));
        assert_eq!((drops.failed_transfers, drops.restarts), (4, 6));
    }

    #[test]
    fn a_state_is_as_old_as_it_is_whatever_is_said_of_it() {
        let metrics = Metrics::default();
        metrics.set_phase(Phase::Waiting, "for a camera");
        let since = metrics.now().since;
        metrics.set_phase(Phase::Waiting, "for another");
        assert_eq!(metrics.now().since, since);
        metrics.set_phase(Phase::Streaming, "a to b");
        assert!(metrics.now().since > since);
        let status = status_of(&metrics);
        assert_eq!((status.state.as_str(), status.what.as_str()), ("streaming", "a to b"));
    }
}
