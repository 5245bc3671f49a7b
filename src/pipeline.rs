//! The journey of a frame: capture -> estimate -> render -> release.
//!
//! [`Stabilizer`] has the steps. [`run_inline`] takes them on one thread, for files and tests. [`run_live`], for the service, uses two:
//! capture and decoding on one, the rest on the other. Both give the same pictures.

mod decode;
mod inline;
mod live;
mod settings;
mod threaded;

use std::collections::VecDeque;

use crate::device::{DeviceError, FrameSink, StreamFormat};
use crate::frame::{Frame, FrameContext, HoldReason, Moment, Outcome, PassReason, Stage};
use crate::geometry::{Calibration, Pose, View};
use crate::image::{PictureRef, Sampling};
use crate::kernel::Level;
use crate::rt::clock;
use crate::stage::gains::Gains;
use crate::stage::paper::homography;
use crate::stage::shutter::{Motion, Pair, Shutter};
use crate::stage::timing::{self, Timing};
use crate::stage::{crop, detect, presence, pyramid, repeat, smooth, track, trust, warp};

pub(crate) use decode::Reasons;
pub use decode::{Decoder, Reason};
use inline::Capture;
pub use inline::{Totals, run_at_level, run_inline};
pub use live::{Counts, Live};
pub use settings::{Camera, Params};
pub use threaded::{Pace, run_live, run_threaded};

/// Is shown each frame between its drawing and its sending: for traces, reports, counts.
pub trait Observer {
    /// `frame` with its whole context, and the picture that was drawn of it. Not called for a frame in whose place the sink sent a
    /// picture of its own ([`FrameSink::submit_placeholder`]).
    fn drawn(&mut self, frame: &Frame, output: PictureRef<'_>);

    /// `frame` was sent; its context now has the times of every stage.
    fn sent(&mut self, frame: &Frame) {
        let _ = frame;
    }
}

/// Watches nothing.
impl Observer for () {
    fn drawn(&mut self, _: &Frame, _: PictureRef<'_>) {}
}

/// The steps of the journey, and what each remembers. Holds a frame only for as long as it is looked back at.
#[derive(Debug)]
pub struct Stabilizer {
    params: Params,
    level: Level,
    input: [usize; 2],
    sampling: Sampling,
    output: [usize; 2],
    nominal_s: f64,
    timing: Timing,
    /// Judges the frames since the last usable one, whose stamps may be as damaged as they are: what it learns is dropped with the next
    /// usable frame.
    unusable: Option<Timing>,
    window: crop::Window,
    detector: detect::Detector,
    tracker: track::Tracker,
    features: Vec<track::Feature>,
    fitter: homography::Fitter,
    shutter: Shutter,
    smoother: smooth::Smoother,
    trust: trust::Trust,
    presence: presence::Presence,
    straightening: presence::Presence,
    warper: warp::Warper,
    /// Frames under way, oldest first: some sent and still looked back at, then those that wait.
    slots: VecDeque<Slot>,
    /// Seconds by which frames may be late so that what comes is known.
    lookahead_s: f64,
    /// Time of the frame whose motion became known last, that time in seconds of motion, and the interval before it.
    known_ns: Option<i64>,
    known_s: f64,
    interval_s: f64,
}

/// A frame under way.
#[derive(Debug)]
struct Slot {
    frame: Box<Frame>,
    progress: Progress,
}

#[expect(clippy::large_enum_variant, reason = "a few of them, kept where they are")]
#[derive(Clone, Copy, Debug, PartialEq)]
enum Progress {
    /// Its motion is not known yet.
    Waiting,
    /// Its motion is known, `time_s` seconds of motion after the stream's first frame and `interval_s` after the frame before; it has no
    /// place on the path yet.
    Known { motion: Motion, time_s: f64, interval_s: f64 },
    /// It can be drawn.
    Ready,
    /// It was drawn and sent.
    Sent,
}

/// Frames that are under way at a time without look-ahead, at most.
const FRAMES: usize = 10;
/// For this long after the last usable frame its picture is shown in place of unusable ones (nanoseconds); then the sink's own, if it
/// has one. Most faults are over before, and a frozen picture that is shown for longer looks as if it were live.
const LONGEST_HELD_NS: i64 = 2_000_000_000;
/// Frames that may wait for their motion, or behind one that does; with more of them, what is known is enough. With look-ahead, more by
/// what it holds.
const MAX_WAITING: usize = 3;
/// Frames that look-ahead may hold: half a second, the longest that can be set, at 480 a second. The header of a recording may claim any rate,
/// and memory is allocated for as many.
const MAX_AHEAD: usize = 240;

/// The name of the instruction set that pixel loops use here: `scalar`, `avx2` or `neon`.
pub fn simd() -> &'static str {
    Level::detected().name()
}

impl Stabilizer {
    /// Steps from frames of `input`'s format to pictures of `output`'s size, at this processor's best SIMD level.
    pub fn new(params: &Params, input: &StreamFormat, output: &StreamFormat) -> Self {
        Self::with_level(Level::detected(), params, input, output)
    }

    /// The same at `level`; the pictures do not depend on it.
    pub fn with_level(level: Level, params: &Params, input: &StreamFormat, output: &StreamFormat) -> Self {
        let nominal_s = if input.rate() > 0.0 { 1.0 / input.rate() } else { 1.0 / 30.0 };
        let lookahead_s = params.smooth.lookahead_s();
        let mut warper = warp::Warper::new(&params.warp, level, input.colour.siting);
        warper.set_border(params.crop.border);
        Self {
            params: *params,
            level,
            input: [input.width as usize, input.height as usize],
            sampling: input.sampling(),
            output: [output.width as usize, output.height as usize],
            nominal_s,
            timing: Timing::new(nominal_s),
            unusable: None,
            window: crop::Window::default(),
            detector: detect::Detector::with_level(params.detect, level),
            tracker: track::Tracker::new(params.track, level),
            features: Vec::with_capacity(2 * params.detect.points as usize),
            fitter: homography::Fitter::new(params.fit),
            shutter: Shutter::new(&params.shutter, params.camera.optics(), params.fit.seed, level),
            smoother: smooth::Smoother::new(&params.smooth),
            trust: trust::Trust::default(),
            presence: presence::Presence::new(params.enabled),
            straightening: presence::Presence::new(params.straighten),
            warper,
            slots: VecDeque::with_capacity(FRAMES + ahead(lookahead_s, nominal_s)),
            lookahead_s,
            known_ns: None,
            known_s: 0.0,
            interval_s: 0.0,
        }
    }

    /// Frames that are under way at a time, at most: what a pool needs.
    pub fn frames(&self) -> usize {
        FRAMES + ahead(self.lookahead_s, self.nominal_s)
    }

    /// What is believed of the camera; `None` where the model does not estimate it, and before the first pair of frames.
    pub fn calibration(&self) -> Option<Calibration> {
        self.shutter.calibration()
    }

    /// Takes new settings while running: stabilization on or off, the path and the crop window glide to them; what tells good
    /// points and tracks from bad ones counts from the next frame. What memory or a calibration was made for stays as it was: the
    /// camera, the count of points, their window, the seed, the shutter model. Takes no memory.
    pub fn set_params(&mut self, params: &Params) {
        let Params { enabled, straighten, camera: _, detect, track, fit, shutter: _, smooth, crop, warp } = params;
        (self.params.enabled, self.params.straighten) = (*enabled, *straighten);
        (self.params.smooth, self.params.crop, self.params.warp) = (*smooth, *crop, *warp);
        self.presence.switch(*enabled);
        self.straightening.switch(*straighten);
        self.detector.set_params(detect);
        self.tracker.set_params(track);
        self.fitter.set_params(fit);
        self.smoother.set_params(smooth);
        self.window.set_params(crop);
        self.warper.set_params(warp);
        self.warper.set_border(crop.border);
    }

    /// A frame to fill, with room for all that it will hold: whenever it is first used, it takes no memory then.
    pub fn empty_frame(&self) -> Box<Frame> {
        let mut frame = Box::<Frame>::default();
        let [width, height] = self.input;
        frame.picture.reshape(self.sampling, width, height);
        pyramid::build(self.level, frame.picture.luma(), &mut frame.pyramid);
        frame.context.tracks.reserve(2 * self.params.detect.points as usize);
        frame
    }

    /// Takes a frame and estimates how the camera moved.
    pub fn push(&mut self, mut frame: Box<Frame>) {
        frame.context.reset();
        let waiting = self.slots.iter().position(|slot| slot.progress == Progress::Waiting);
        if waiting.is_some_and(|first| self.slots.len() - first >= MAX_WAITING) {
            self.settle_waiting(self.shutter.newest());
        }
        // behind a row of damaged frames nothing new becomes known
        self.plan_known(self.lookahead_s);
        let reference = self.reference();
        if !frame.intact {
            frame.moment = self.unusable.get_or_insert_with(|| self.timing.clone()).judge(&frame.stamp);
            frame.context.outcome = Outcome::Held(HoldReason::Damaged);
            self.slots.push_back(Slot { frame, progress: Progress::Ready });
            return;
        }
        self.unusable = None;
        frame.moment = self.timing.judge(&frame.stamp);
        match reference.filter(|&i| size(&self.slots[i].frame) == size(&frame)) {
            None => self.begin(&mut frame),
            Some(reference) => {
                self.compare(reference, &mut frame);
                if self.shutter.frames_late() == 1 && !frame.context.repeat {
                    self.settle_waiting(self.shutter.reference());
                }
            }
        }
        self.slots.push_back(Slot { frame, progress: Progress::Waiting });
        if self.shutter.frames_late() == 0 {
            self.settle_waiting(self.shutter.newest());
        }
    }

    /// The newest frame with a picture of its own: what the next is compared with.
    fn reference(&self) -> Option<usize> {
        self.slots.iter().rposition(|slot| slot.frame.intact && !slot.frame.context.repeat)
    }

    /// A stream begins, or goes on in another size: there is nothing to compare the frame with.
    fn begin(&mut self, frame: &mut Frame) {
        self.end();
        self.window = crop::Window::new(&self.params.crop, size(frame), self.output);
        self.features.clear();
        self.shutter.begin(size(frame));
        self.smoother.begin();
        self.trust = trust::Trust::default();
        self.presence = presence::Presence::new(self.params.enabled);
        self.straightening = presence::Presence::new(self.params.straighten);
        (self.known_ns, self.known_s, self.interval_s) = (None, 0.0, 0.0);
        frame.context.outcome = Outcome::PassedThrough(PassReason::First);
        timed(frame, Stage::Pyramid, |frame| pyramid::build(self.level, frame.picture.luma(), &mut frame.pyramid));
    }

    /// Compares the frame with the reference: pyramid, corners, tracks, homography, camera motion.
    fn compare(&mut self, reference: usize, frame: &mut Frame) {
        let before = &*self.slots[reference].frame;
        let interval_s = timing::seconds_between(before.moment.time_ns, frame.moment.time_ns);
        let Moment { off_s, is_certain, .. } = frame.moment;
        frame.context.interval_s = interval_s;
        timed(frame, Stage::Pyramid, |frame| pyramid::build(self.level, frame.picture.luma(), &mut frame.pyramid));
        timed(frame, Stage::Detect, |_| self.detector.replenish(before, &mut self.features));
        timed(frame, Stage::Track, |frame| self.tracker.follow(before, frame, &mut self.features));
        timed(frame, Stage::Fit, |frame| {
            let FrameContext { tracks, fit, repeat, .. } = &mut frame.context;
            *repeat = repeat::is_repeat(tracks, &before.context.tracks);
            if *repeat || self.shutter.asks_homography() {
                *fit = self.fitter.fit(tracks);
            }
        });
        timed(frame, Stage::Shutter, |frame| {
            let FrameContext { tracks, fit, repeat, .. } = &mut frame.context;
            if !*repeat {
                self.shutter.observe(Pair { tracks, fit, interval_s, off_s, is_certain });
                track::remember(&mut self.features, tracks, self.shutter.newest().confidence);
            }
        });
        if !frame.context.repeat && !self.shutter.asks_homography() {
            let believed = self.shutter.newest().confidence > 0.0;
            timed(frame, Stage::Fit, |frame| {
                let FrameContext { tracks, fit, .. } = &mut frame.context;
                *fit = if believed { self.fitter.agree(tracks) } else { self.fitter.fit(tracks) };
            });
        }
    }

    /// Gives every frame that waits its motion, and those a place on the path behind which enough is known.
    fn settle_waiting(&mut self, motion: Motion) {
        for i in 0..self.slots.len() {
            if self.slots[i].progress == Progress::Waiting {
                let now_ns = self.slots[i].frame.moment.time_ns;
                let interval_s = self.known_ns.map_or(0.0, |before| timing::seconds_between(before, now_ns));
                self.interval_s = timing::step_s(interval_s, self.nominal_s);
                self.known_s += self.interval_s;
                self.known_ns = Some(now_ns);
                let (pose, interval_s) = (self.shutter.pose(motion.path), self.interval_s);
                let ends = motion.ends.map(|end| self.shutter.pose(end));
                timed(&mut self.slots[i].frame, Stage::Smooth, |_| self.smoother.observe(pose, interval_s, ends));
                self.slots[i].progress = Progress::Known { motion, time_s: self.known_s, interval_s };
            }
        }
        self.plan_known(self.lookahead_s);
    }

    /// Gives frames their places, oldest first, that would be later than `lookahead_s` if they waited for one more, or behind which too
    /// many wait.
    fn plan_known(&mut self, lookahead_s: f64) {
        let most = ahead(self.lookahead_s, self.nominal_s) + MAX_WAITING;
        for i in 0..self.slots.len() {
            let Progress::Known { motion, time_s, interval_s } = self.slots[i].progress else { continue };
            let known_s = self.known_s - time_s;
            let next_s = if self.interval_s > 0.0 { self.interval_s } else { self.nominal_s };
            let behind = self.slots.len() - i;
            if lookahead_s > 0.0 && known_s + next_s <= lookahead_s + 1e-3 && behind < most {
                break;
            }
            self.plan(i, motion, interval_s, known_s);
            self.slots[i].progress = Progress::Ready;
        }
    }

    /// Chooses the virtual camera's place for a frame, and with it where each output pixel comes from. `interval_s` is the time since
    /// the frame before, `known_s` that for which it is known how the camera goes on.
    fn plan(&mut self, index: usize, motion: Motion, interval_s: f64, known_s: f64) {
        let frame = &mut *self.slots[index].frame;
        timed(frame, Stage::Smooth, |frame| {
            let context = &mut frame.context;
            let (trust, presence) = (self.trust.step(motion.confidence, interval_s), self.presence.step(interval_s));
            let mut gains = Gains::new(trust, presence, motion.agreement);
            let fade = gains.fade();
            self.window.glide(interval_s);
            let view = View { window: self.window.view(), straighten: self.straightening.step(interval_s) };
            gains.rows_margin =
                self.window.rows_margin(&view, |part| self.shutter.map(&motion, motion.path, part * fade, &view));
            let rows = gains.rows();
            let pose = self.shutter.pose(motion.path);
            // the path's parameters for a correction, and the map that it gives
            let path = |correction: Pose| self.shutter.path(pose + correction);
            let map = |correction: Pose| self.shutter.map(&motion, path(correction), rows, &view);
            let bounds = self.window.bounds(&view, self.smoother.correction(), map);
            let place = self.smoother.step(pose, interval_s, known_s, &bounds);
            let wanted = place - pose;
            gains.margin = self.window.correction_part(&view, |margin| map(Gains { margin, ..gains }.correction(wanted)));
            let correction = gains.correction(wanted);
            (context.motion, context.rows, context.path) = (motion.motion, motion.rows, motion.path);
            context.smoothed = path(correction);
            (context.confidence, context.trust, context.rows_gain) = (motion.confidence, trust, rows);
            context.calibration = self.shutter.calibration();
            context.map = self.shutter.map(&motion, context.smoothed, rows, &view);
            context.crop_use = self.window.crop_use(&context.map, &view);
            context.crop_shares = bounds.crop_shares(&correction);
            context.crop_zoom = self.window.zoom();
            if fade == 1.0 {
                self.window.follow_use(context.crop_use, interval_s);
            }
            if context.outcome == Outcome::Pending {
                context.outcome = match () {
                    () if presence == 0.0 => Outcome::PassedThrough(PassReason::SwitchedOff),
                    () if trust == 0.0 => Outcome::PassedThrough(PassReason::LostTrack),
                    () => Outcome::Stabilized,
                };
            }
        });
    }

    /// The stream ends: what still waits is settled with what is known.
    pub fn end(&mut self) {
        self.settle_waiting(self.shutter.newest());
        self.plan_known(0.0);
    }

    /// Draws and sends the oldest frame that was not, if it is ready. Gives back its outcome.
    ///
    /// # Errors
    /// What the sink reports.
    pub fn emit(&mut self, sink: &mut dyn FrameSink, observer: &mut dyn Observer) -> Result<Option<Outcome>, DeviceError> {
        let Some(index) = self.slots.iter().position(|slot| slot.progress != Progress::Sent) else { return Ok(None) };
        if self.slots[index].progress != Progress::Ready {
            return Ok(None);
        }
        // a damaged frame shows the last intact one again, from the same place
        let shown = self.slots.iter().take(index + 1).rposition(|slot| slot.frame.intact);
        let Frame { stamp, moment, .. } = *self.slots[index].frame;
        let age_ns = |shown: usize| moment.time_ns.saturating_sub(self.slots[shown].frame.moment.time_ns);
        if shown.is_none_or(|shown| age_ns(shown) > LONGEST_HELD_NS) && sink.submit_placeholder(&stamp)? {
            observer.sent(&self.slots[index].frame);
            self.slots[index].progress = Progress::Sent;
            return Ok(Some(self.slots[index].frame.context.outcome));
        }
        if let Some(shown) = shown.filter(|&shown| shown != index) {
            let FrameContext { map, crop_use, crop_shares, crop_zoom, .. } = self.slots[shown].frame.context;
            let context = &mut self.slots[index].frame.context;
            (context.map, context.crop_use, context.crop_shares, context.crop_zoom) = (map, crop_use, crop_shares, crop_zoom);
        }
        let started = clock::monotonic_ns();
        let mut canvas = sink.canvas()?;
        match shown.map(|shown| &self.slots[shown].frame) {
            Some(frame) => self.warper.draw(&self.slots[index].frame.context.map, frame.picture.as_ref(), &mut canvas),
            None => canvas.blacken(),
        }
        let frame = &mut *self.slots[index].frame;
        let drawn = clock::monotonic_ns();
        observer.drawn(frame, canvas.as_ref());
        let seen = clock::monotonic_ns();
        sink.submit(&frame.stamp)?;
        frame.context.spent_ns[Stage::Warp as usize] = drawn.saturating_sub(started) as u64;
        frame.context.spent_ns[Stage::Submit as usize] = clock::monotonic_ns().saturating_sub(seen) as u64;
        observer.sent(frame);
        self.slots[index].progress = Progress::Sent;
        Ok(Some(self.slots[index].frame.context.outcome))
    }

    /// A frame that no later one is compared with any more, to be filled again.
    pub fn give_back(&mut self) -> Option<Box<Frame>> {
        let reference = self.reference();
        let shown_again = |i: usize| {
            let behind = self.slots.range(i + 1..).take_while(|slot| !slot.frame.intact);
            self.slots[i].frame.intact && behind.into_iter().any(|slot| slot.progress != Progress::Sent)
        };
        let free = (0..self.slots.len())
            .find(|&i| self.slots[i].progress == Progress::Sent && Some(i) != reference && !shown_again(i))?;
        self.slots.remove(free).map(|slot| slot.frame)
    }
}

/// Takes the time of a stage; of one that is walked in parts, adds it up.
fn timed(frame: &mut Frame, stage: Stage, step: impl FnOnce(&mut Frame)) {
    let started = clock::monotonic_ns();
    step(frame);
    frame.context.spent_ns[stage as usize] += clock::monotonic_ns().saturating_sub(started) as u64;
}

/// Frames that wait for what comes, at most.
fn ahead(lookahead_s: f64, nominal_s: f64) -> usize {
    ((lookahead_s / nominal_s).ceil() as usize).min(MAX_AHEAD)
}

fn size(frame: &Frame) -> [usize; 2] {
    [frame.picture.width(), frame.picture.height()]
}

#[cfg(test)]
mod tests;
