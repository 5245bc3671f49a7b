//! Footage for the estimator: the tracks of each pair of frames, kept so that several starting points can be tried.

use crate::device::null::NullSink;
use crate::device::{DeviceError, FrameSource};
use crate::frame::{Fit, Frame, Outcome, Track};
use crate::geometry::{Calibration, Estimate, Pinhole, Pose, RowMotion, RowPoses};
use crate::image::PictureRef;
use crate::kernel::Level;
use crate::pipeline::{Camera, Observer, Params, Reasons, run_inline};
use crate::rt::stop::Stop;
use crate::stage::shutter::{self, Model, Pair, Prior, Shutter};

use super::super::progress::Progress;

/// Motion of the picture from one frame to the next below which the model learns next to nothing of the camera (pixels).
pub(super) const MIN_MOTION_PX: f64 = 0.65;
/// Readout times from which the search begins (frame intervals): the equations lead to the truth from within a third, and
/// astray from farther away.
const STARTS: [f64; 7] = [0.75, 0.4, 0.15, 0.0, -0.15, -0.4, -0.75];
/// Standard deviations with which each start is given (frame intervals; degrees; k1).
const SPREAD: (f64, f64, f64) = (0.25, 15.0, 0.1);
/// Distance at which a track stops counting against an answer, about (pixels).
const SCALE_PX: f64 = 0.5;
/// Maximum number of refinements of an answer; fewer where it moves by less than [`SETTLED`] of its deviation.
const ROUNDS: usize = 5;
const SETTLED: f64 = 0.1;

/// The tracks of a stream's frames.
#[derive(Debug, Default)]
pub(super) struct Footage {
    size: [usize; 2],
    pairs: Vec<Seen>,
    /// Frames that were looked at.
    pub(super) frames: u64,
    /// The picture changed its size: what came then was left aside.
    pub(super) cut: bool,
    /// Frames that could not be used, and why.
    pub(super) unusable: Reasons,
    progress: Progress,
}

#[derive(Debug)]
struct Seen {
    tracks: Vec<Track>,
    fit: Fit,
    interval_s: f64,
    off_s: f64,
    is_certain: bool,
}

/// How even the times of the frames are.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Evenness {
    /// Root mean square of what the stamps of neighbouring frames say otherwise than the camera's rhythm (seconds).
    pub(super) jitter_s: f64,
    /// Intervals between frames, and those of them of which it is not known how long they were.
    pub(super) intervals: usize,
    pub(super) doubtful: usize,
}

impl Evenness {
    /// Part of the intervals that is doubtful.
    pub(super) fn doubt(&self) -> f64 {
        self.doubtful as f64 / self.intervals.max(1) as f64
    }
}

/// An answer, and how well it agrees with the footage.
#[derive(Clone, Copy, Debug)]
pub(super) struct Answer {
    /// What is believed of the camera.
    pub(super) camera: Calibration,
    /// Mean of the tracks' robust misfits: Geman-McClure's, 0 (none) to 1.
    pub(super) misfit: f64,
    /// Root mean square motion of the picture's middle from frame to frame, pixels.
    pub(super) motion_px: f64,
    /// Time in which it moved by at least [`MIN_MOTION_PX`] a frame, seconds.
    pub(super) moving_s: f64,
}

impl Footage {
    /// Follows the points of `source`'s frames, for a camera known as `camera` says.
    ///
    /// # Errors
    /// What the source reports.
    pub(super) fn gather(
        source: &mut dyn FrameSource,
        params: &Params,
        camera: Camera,
        stop: &Stop,
        (what, frames): (&'static str, Option<u64>),
    ) -> Result<Self, DeviceError> {
        let mut params = Params { camera, ..*params };
        params.shutter.model = Model::Continuous;
        let mut sink = NullSink::new(&source.format());
        let mut footage = Self { progress: Progress::new(what, frames), ..Self::default() };
        let ran = run_inline(source, &mut sink, &params, stop, &mut footage);
        std::mem::take(&mut footage.progress).finish();
        ran.map(|totals| Self { unusable: totals.unusable, ..footage })
    }

    /// Usual time from one frame to the next, seconds; 0 where there are no two.
    pub(super) fn interval_s(&self) -> f64 {
        let mut intervals: Vec<f64> = self.pairs.iter().map(|pair| pair.interval_s).collect();
        intervals.sort_unstable_by(f64::total_cmp);
        intervals.get(intervals.len() / 2).copied().unwrap_or(0.0)
    }

    /// How even the frames' times are.
    pub(super) fn evenness(&self) -> Evenness {
        let sure = self.pairs.iter().filter(|pair| pair.is_certain);
        let (count, squares) = sure.fold((0, 0.0), |(count, squares), pair| (count + 1, squares + pair.off_s * pair.off_s));
        let intervals = self.pairs.len();
        Evenness { jitter_s: (squares / count.max(1) as f64).sqrt(), intervals, doubtful: intervals - count }
    }

    /// Time from the first frame to the last, seconds.
    pub(super) fn duration_s(&self) -> f64 {
        self.pairs.iter().map(|pair| pair.interval_s).sum()
    }

    /// The best answer, and the best of those that say something else; the search begins at several readout times, of either sign,
    /// and at `start` where one is given.
    pub(super) fn answers(&self, start: Option<&Calibration>) -> (Answer, Option<Answer>) {
        let interval_s = self.interval_s();
        let starts = STARTS.map(|part| Camera {
            readout_ms: Prior::Gaussian(1e3 * part * interval_s, 1e3 * SPREAD.0 * interval_s),
            hfov_deg: Prior::Unknown,
            lens_k1: Prior::Unknown,
        });
        let mut answers: Vec<Answer> =
            starts.into_iter().chain(start.map(|camera| self.about(camera))).map(|start| self.answer(start)).collect();
        answers.sort_by(|a, b| a.misfit.total_cmp(&b.misfit));
        let apart = |a: &Answer, b: &Answer| (a.camera.readout_s.value - b.camera.readout_s.value).abs() > 0.1 * interval_s;
        let best = self.settled(answers[0]);
        // what is on its way to the best answer is no other one
        let other = answers.into_iter().find(|other| apart(other, &best)).map(|other| self.settled(other));
        (best, other.filter(|other| apart(other, &best)))
    }

    /// Where an answer leads to as the start of another search.
    fn settled(&self, mut answer: Answer) -> Answer {
        for _ in 0..ROUNDS {
            let before = answer.camera;
            answer = self.answer(self.about(&before));
            let moved = |to: Estimate, from: Estimate| (to.value - from.value).abs() > SETTLED * to.sigma;
            let now = &answer.camera;
            if !moved(now.readout_s, before.readout_s)
                && !moved(now.hfov_deg, before.hfov_deg)
                && !moved(now.lens_k1, before.lens_k1)
            {
                break;
            }
        }
        answer
    }

    /// What was found as a start: the value is used, its certainty is not, or the same frames would count twice.
    pub(super) fn about(&self, camera: &Calibration) -> Camera {
        Camera {
            readout_ms: Prior::Gaussian(1e3 * camera.readout_s.value, 1e3 * SPREAD.0 * self.interval_s()),
            hfov_deg: Prior::Gaussian(camera.hfov_deg.value, SPREAD.1),
            lens_k1: Prior::Gaussian(camera.lens_k1.value, SPREAD.2),
        }
    }

    /// Goes through the footage with a model that knows the camera as `start` says.
    fn answer(&self, start: Camera) -> Answer {
        let params = shutter::Params { model: Model::Continuous, ..shutter::Params::default() };
        let mut model = Shutter::new(&params, start.optics(), 1, Level::detected());
        model.begin(self.size);
        let mut tracks = Vec::new();
        let (mut misfit, mut count) = (0.0, 0usize);
        let (mut squares, mut moving_s) = (0.0, 0.0);
        let mut before: Option<Rows> = None;
        for pair in &self.pairs {
            tracks.clone_from(&pair.tracks);
            let &Seen { ref fit, interval_s, off_s, is_certain, .. } = pair;
            model.observe(Pair { tracks: &mut tracks, fit, interval_s, off_s, is_certain });
            let newest = model.newest();
            let RowMotion::Poses { camera, rows } = newest.rows else { continue };
            let now = Rows { camera, rows, path: model.pose(newest.path) };
            let px = camera.focal * newest.motion[0].hypot(newest.motion[1]);
            squares += px * px;
            moving_s += if px >= MIN_MOTION_PX { pair.interval_s } else { 0.0 };
            if let Some(before) = before.replace(now) {
                misfit += pair.tracks.iter().map(|track| now.misfit(&before, track)).sum::<f64>();
                count += pair.tracks.len();
            }
        }
        Answer {
            camera: model.calibration().unwrap_or_default(),
            misfit: misfit / count.max(1) as f64,
            motion_px: (squares / self.pairs.len().max(1) as f64).sqrt(),
            moving_s,
        }
    }
}

/// The path over a frame's rows.
#[derive(Clone, Copy, Debug)]
struct Rows {
    camera: Pinhole,
    rows: RowPoses,
    path: Pose,
}

impl Rows {
    /// Robust misfit of a track from the frame before to this one.
    fn misfit(&self, before: &Self, track: &Track) -> f64 {
        let middle = [0.5 * (track.from[0] + track.to[0]), 0.5 * (track.from[1] + track.to[1])];
        let (sooner, later) = (before.rows.at(track.from[1]), self.rows.at(track.to[1]));
        let turned = self.path - before.path + later - sooner;
        let rows = self.camera.derivative(middle);
        let off = [0, 1].map(|axis: usize| track.to[axis] - track.from[axis] - turned.dot(&rows[axis]));
        let square = (off[0] * off[0] + off[1] * off[1]) / (SCALE_PX * SCALE_PX);
        square / (1.0 + square)
    }
}

impl Observer for Footage {
    fn drawn(&mut self, frame: &Frame, _: PictureRef<'_>) {
        self.frames += 1;
        let context = &frame.context;
        if matches!(context.outcome, Outcome::Held(_)) || context.repeat || self.cut {
            return;
        }
        let size = [frame.picture.width(), frame.picture.height()];
        if self.size != [0, 0] && self.size != size {
            self.cut = true;
            return;
        }
        self.size = size;
        if context.interval_s > 0.0 {
            self.pairs.push(Seen {
                tracks: context.tracks.clone(),
                fit: context.fit,
                interval_s: context.interval_s,
                off_s: frame.moment.off_s,
                is_certain: frame.moment.is_certain,
            });
        }
    }

    fn sent(&mut self, _: &Frame) {
        self.progress.step();
    }
}
