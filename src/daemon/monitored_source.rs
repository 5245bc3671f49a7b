//! A camera whose lost and unusable frames are counted and logged, and which is restarted when they persist.

use super::heartbeat::Heartbeat;
use super::recovery::{Recovery, Step};
use super::viewers::ViewerStatus;
use crate::control::{Losses, Phase};
use crate::device::v4l2::Capture;
use crate::device::{DeviceError, FrameSource, Lent, StreamFormat};
use crate::rt::log_throttle::LogThrottle;

/// Interval at which the counts of frames are checked (nanoseconds).
const LOOK_EVERY_NS: i64 = 250_000_000;

/// Unusable frames are logged this long after the first (nanoseconds), so that their number is meaningful.
const SAY_AFTER_NS: i64 = 750_000_000;

/// A camera without a frame for this long counts as silent (nanoseconds).
const SILENT_NS: i64 = 3_000_000_000;

/// The operations of a camera that are needed here.
pub(super) trait Camera: FrameSource {
    /// What it lost since it was opened.
    fn losses(&self) -> Losses;

    /// Stops and starts its stream.
    fn restart(&mut self) -> Result<(), DeviceError>;
}

impl Camera for Capture {
    fn losses(&self) -> Losses {
        let counts = self.counts();
        Losses {
            missing: counts.missing,
            stale: counts.dropped,
            failed_transfers: counts.failed_transfers,
            restarts: counts.restarts,
        }
    }

    fn restart(&mut self) -> Result<(), DeviceError> {
        Capture::restart(self)
    }
}

/// A camera whose frames and silences are recorded in a [`Heartbeat`].
pub(super) struct MonitoredSource<'a> {
    pub(super) camera: &'a mut dyn Camera,
    pub(super) heartbeat: &'a Heartbeat<'a>,
    /// The activity to report while frames are usable.
    pub(super) what: String,
    /// Those who want the camera, where there are no other viewers.
    pub(super) viewers: Option<ViewerStatus>,
    pub(super) recovery: &'a mut Recovery,
    pub(super) notes: Notes,
    /// Nanoseconds on CLOCK_MONOTONIC; a test has a clock of its own.
    pub(super) clock: fn() -> i64,
    /// Whether the camera ended the run.
    pub(super) failed: bool,
    /// The step for which the run was ended, where it was.
    pub(super) step: Step,
}

/// State of a [`MonitoredSource`].
#[derive(Debug, Default)]
pub(super) struct Notes {
    /// The losses that are counted so far.
    losses: Losses,
    /// Time of the last check; 0 before the first.
    looked_ns: i64,
    /// Frames and usable frames, and when these counts last changed.
    frames: u64,
    frames_ns: i64,
    usable: u64,
    usable_ns: i64,
    /// Whether the silence is reported.
    silent: bool,
    /// Unusable frames that were logged, and when the first one was seen that was not.
    logged: u64,
    first_ns: Option<i64>,
    some: LogThrottle,
    /// Why frames are no longer usable, as text.
    none_usable: Option<String>,
    none: LogThrottle,
    /// Cut frames before this stream, and those of it that were logged.
    cut: Option<u64>,
    cut_logged: u64,
    cuts: LogThrottle,
    restarts: LogThrottle,
}

impl MonitoredSource<'_> {
    /// Checks the counts of frames, logs changes, and returns what to do.
    fn look(&mut self, now_ns: i64) -> Step {
        self.heartbeat.add_losses(self.camera.losses(), &mut self.notes.losses);
        if self.notes.looked_ns == 0 {
            (self.notes.usable_ns, self.notes.frames_ns) = (now_ns, now_ns);
        } else if now_ns.saturating_sub(self.notes.looked_ns) < LOOK_EVERY_NS {
            return Step::GoOn;
        }
        self.notes.looked_ns = now_ns;
        let (frames, unusable) = self.heartbeat.stream_counts();
        self.watch_silence(now_ns, frames);
        self.watch_cuts(now_ns, frames);
        self.log_unusable(now_ns, frames, unusable);
        self.recovery.look(now_ns, frames, unusable)
    }

    /// Reports the activity and problems.
    fn tell(&self) {
        let what = match &self.notes {
            Notes { silent: true, .. } => format!("{}; no frames received", self.what),
            Notes { none_usable: Some(words), .. } => format!("{}; {words}", self.what),
            _ => self.what.clone(),
        };
        self.heartbeat.set_activity(what, Phase::Streaming);
    }

    /// Reports silence and its end; the capture logs it, and restarts the stream.
    fn watch_silence(&mut self, now_ns: i64, frames: u64) {
        let notes = &mut self.notes;
        if frames > notes.frames {
            (notes.frames, notes.frames_ns) = (frames, now_ns);
        }
        let silent = now_ns.saturating_sub(notes.frames_ns) >= SILENT_NS;
        if std::mem::replace(&mut notes.silent, silent) != silent {
            self.tell();
        }
    }

    /// Logs frames of which a part is shown, rarely.
    fn watch_cuts(&mut self, now_ns: i64, frames: u64) {
        let (notes, all) = (&mut self.notes, self.heartbeat.cut());
        let cut = all - *notes.cut.get_or_insert(all);
        if cut > notes.cut_logged && notes.cuts.is_due(now_ns) {
            notes.cut_logged = cut;
            tracing::warn!("{cut} of {frames} frames are cut off; the missing parts show the previous picture");
        }
    }

    /// Logs frames that cannot be used: a moment after the first, and when there are no others any more; then ever more rarely.
    fn log_unusable(&mut self, now_ns: i64, frames: u64, unusable: u64) {
        let (notes, usable) = (&mut self.notes, frames.saturating_sub(unusable));
        if usable > notes.usable {
            (notes.usable, notes.usable_ns) = (usable, now_ns);
            if notes.none_usable.take().is_some() {
                (notes.logged, notes.first_ns) = (unusable, None);
                tracing::info!("frames are usable again; {unusable} of {frames} were not");
                self.tell();
            }
        }
        let notes = &mut self.notes;
        if unusable == notes.logged {
            return;
        }
        let first_ns = *notes.first_ns.get_or_insert(now_ns);
        if now_ns.saturating_sub(first_ns) < SAY_AFTER_NS {
            return;
        }
        let ends = now_ns.saturating_sub(notes.usable_ns) >= SAY_AFTER_NS && notes.none_usable.is_none();
        let due = notes.some.is_due(now_ns) | (ends && notes.none.is_due(now_ns));
        if !due && !ends {
            return;
        }
        let (frames, reasons) = self.heartbeat.stream();
        let Some(words) = reasons.in_words(frames) else { return };
        if due {
            (notes.logged, notes.first_ns) = (unusable, None);
            tracing::warn!("{words}");
        }
        if ends {
            notes.none_usable = Some(words);
            self.tell();
        }
    }

    /// Restarts the stream, as [`Step::Restart`] wants it.
    fn restart(&mut self, now_ns: i64) -> Result<(), DeviceError> {
        if self.notes.restarts.is_due(now_ns) {
            tracing::warn!("no usable frames: restarting the stream");
        }
        self.camera.restart()
    }
}

impl FrameSource for MonitoredSource<'_> {
    fn format(&self) -> StreamFormat {
        self.camera.format()
    }

    fn lend(&mut self) -> Result<Lent<'_>, DeviceError> {
        let now_ns = (self.clock)();
        let step = self.look(now_ns);
        if self.viewers.as_ref().is_some_and(|viewers| !viewers.wants_camera()) {
            return Ok(Lent::End);
        }
        match step {
            Step::GoOn => {}
            Step::Restart => self.restart(now_ns).inspect_err(|_| self.failed = true)?,
            Step::NextFormat | Step::FirstFormat => {
                self.step = step;
                return Ok(Lent::End);
            }
        }
        match self.camera.lend() {
            Ok(Lent::Idle) => {
                self.heartbeat.camera_idle();
                Ok(Lent::Idle)
            }
            Ok(lent) => {
                self.heartbeat.frame_captured(now_ns);
                Ok(lent)
            }
            Err(error) => {
                self.failed = true;
                Err(error)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicI64, Ordering::Relaxed};

    use super::*;
    use crate::config::Settings;
    use crate::control::{DaemonState, Status};
    use crate::device::RawFrame;
    use crate::device::null::WithPlaceholder;
    use crate::frame::Stamp;
    use crate::image::PixelFormat;
    use crate::pipeline::run_live;
    use crate::rt::stop::Stop;
    use crate::systemd::Systemd;

    const SIZE: (u32, u32) = (64, 48);

    /// Gives a frame each 33 ms of a clock that goes on by that alone: raw ones that are whole while `is_whole` says so; none for `None`.
    struct Fake {
        format: StreamFormat,
        clock: &'static AtomicI64,
        bytes: Vec<u8>,
        given: u64,
        is_whole: fn(u64) -> Option<bool>,
        ends_at: u64,
        restarts: Vec<u64>,
    }

    impl FrameSource for Fake {
        fn format(&self) -> StreamFormat {
            self.format
        }

        fn lend(&mut self) -> Result<Lent<'_>, DeviceError> {
            if self.given == self.ends_at {
                return Ok(Lent::End);
            }
            // The other thread keeps up, mostly.
            std::thread::sleep(std::time::Duration::from_millis(1));
            let time_ns = self.clock.fetch_add(33_333_333, Relaxed);
            let stamp = Stamp { time_ns, sequence: self.given, ..Stamp::default() };
            self.given += 1;
            let Some(is_whole) = (self.is_whole)(self.given - 1) else { return Ok(Lent::Idle) };
            let len = if is_whole { self.bytes.len() } else { 7 };
            Ok(Lent::Frame(RawFrame { format: self.format, bytes: &self.bytes[..len], stamp }))
        }
    }

    impl Camera for Fake {
        fn losses(&self) -> Losses {
            Losses { restarts: self.restarts.len() as u64, ..Losses::default() }
        }

        fn restart(&mut self) -> Result<(), DeviceError> {
            self.restarts.push(self.given);
            Ok(())
        }
    }

    struct Ran {
        step: Step,
        restarts: Vec<u64>,
        drawn: u64,
        placeholders: u64,
        dropped: u64,
        status: Status,
    }

    fn run(clock: (fn() -> i64, &'static AtomicI64), is_whole: fn(u64) -> Option<bool>, ends_at: u64) -> Ran {
        let format = StreamFormat::tight(SIZE.0, SIZE.1, PixelFormat::Yuyv, (1, 30));
        let bytes = vec![128; format.frame_bytes().unwrap()];
        let mut camera = Fake { format, clock: clock.1, bytes, given: 0, is_whole, ends_at, restarts: Vec::new() };
        let state = DaemonState::new(Settings::default(), Systemd::disconnected(), Box::new(|| Err("there is no file".into())));
        let heartbeat = Heartbeat::new(&state);
        let mut recovery = Recovery::new();
        recovery.begin(clock.0(), true, false);
        let mut sink = WithPlaceholder::new(&format);
        let mut monitored_source = MonitoredSource {
            camera: &mut camera,
            heartbeat: &heartbeat,
            what: "a to b".into(),
            viewers: None,
            recovery: &mut recovery,
            notes: Notes::default(),
            clock: clock.0,
            failed: false,
            step: Step::GoOn,
        };
        let mut observer = &heartbeat;
        let params = state.live.params();
        let totals = run_live(&mut monitored_source, &mut sink, &params, &state.live, &Stop::default(), &mut observer).unwrap();
        let step = monitored_source.step;
        Ran {
            step,
            restarts: camera.restarts,
            drawn: sink.inner.submitted(),
            placeholders: sink.placeholders,
            dropped: totals.dropped,
            status: state.status(),
        }
    }

    #[test]
    fn a_camera_of_which_nothing_can_be_used_is_restarted_and_left_and_all_is_said() {
        static CLOCK: AtomicI64 = AtomicI64::new(1_000_000_000);
        let ran = run((|| CLOCK.load(Relaxed), &CLOCK), |_| Some(false), u64::MAX);
        assert_eq!((ran.step, ran.restarts.len()), (Step::NextFormat, 1));
        assert!((90..100).contains(&ran.restarts[0]), "after three seconds: {:?}", ran.restarts);
        assert_eq!(ran.drawn, 0, "neither black nor anything else is drawn");
        let Status { frames, unusable, unusable_frames, drops, what, .. } = ran.status;
        let unusable = unusable.unwrap();
        assert!((180..200).contains(&unusable.frames) && unusable.frames == unusable.of, "{unusable:?}");
        assert_eq!((frames.captured, drops.damaged, drops.restarts), (unusable.of, unusable.of, 1));
        assert_eq!((unusable.reason.as_str(), unusable_frames.get("truncated")), ("truncated", Some(&unusable.of)));
        assert_eq!(ran.placeholders + ran.dropped, unusable.of);
        let words = " frames cannot be decoded: the YUYV frame has 7 bytes, 6144 were expected";
        assert_eq!(unusable.what, format!("{0} of {0}{words}", unusable.of));
        assert!(what.starts_with("a to b; ") && what.ends_with(words), "{what}");
    }

    #[test]
    fn a_picture_is_held_for_two_seconds_and_what_comes_back_is_shown() {
        static CLOCK: AtomicI64 = AtomicI64::new(1_000_000_000);
        // Ten good seconds, four bad ones, two good ones.
        let ran = run((|| CLOCK.load(Relaxed), &CLOCK), |n| Some(!(300..420).contains(&n)), 480);
        assert_eq!((ran.step, ran.restarts.len()), (Step::GoOn, 1));
        assert_eq!(ran.drawn + ran.placeholders + ran.dropped, 480);
        // Some 60: the clock goes on while the other thread waits for its turn, so a few more on a busy machine. All 120 bad frames would
        // mean that the picture was not held.
        assert!(ran.placeholders <= 100, "{} in place of the last two seconds' frames", ran.placeholders);
        assert!(ran.placeholders > 0 || ran.dropped >= 59);
        assert_eq!((ran.status.what.as_str(), ran.status.unusable.unwrap().frames), ("a to b", 120));
    }

    #[test]
    fn a_camera_that_falls_silent_is_told_of_and_left_alone() {
        static CLOCK: AtomicI64 = AtomicI64::new(1_000_000_000);
        let silent = run((|| CLOCK.load(Relaxed), &CLOCK), |n| (n < 60).then_some(true), 300);
        assert_eq!((silent.step, silent.restarts.len()), (Step::GoOn, 0), "its capture restarts it");
        assert_eq!((silent.status.what.as_str(), silent.status.unusable), ("a to b; no frames received", None));
        let back = run((|| CLOCK.load(Relaxed), &CLOCK), |n| (!(60..240).contains(&n)).then_some(true), 300);
        assert_eq!(back.status.what, "a to b");
    }
}
