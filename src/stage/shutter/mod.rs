//! Rolling shutter: from tracks to the motion of the camera between frames and of the rows within them.
//!
//! Two questions are put to every model: what a pair of frames shows ([`Shutter::observe`]), and where each output pixel of a
//! frame comes from once the virtual camera's path is chosen ([`Shutter::map`]).

pub(crate) mod certainty;
pub(crate) mod continuous;

use crate::frame::{Fit, PathParameters, Track};
use crate::geometry::{Calibration, Estimate, OutputMap, Pose, RowMotion, View};

use crate::kernel::Level;
use crate::stage::paper::Cho2007;
use continuous::Continuous;

/// Which model of the camera's motion is used.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Model {
    /// "CMOS digital image stabilization" (Cho, Kim, Hong 2007): zoom and translation, constant within a frame interval.
    Cho2007,
    /// The camera's path in continuous time: each row has its own pose; no latency.
    #[default]
    Continuous,
}

/// Which of the two parameter sets of cho2007 describes a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Parameters {
    /// Eq. (11), from the homography to the frame after: one frame late, the paper's choice.
    #[default]
    TimeT,
    /// Eq. (12), from the homography to the frame before: no latency.
    TimeT1,
}

/// Settings of the rolling-shutter model.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Params {
    /// Which model.
    pub model: Model,
    /// cho2007 alone: which parameter set.
    pub parameters: Parameters,
}

/// What is known beforehand of one of the camera's constants.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Prior {
    /// Nothing is known: it is estimated.
    #[default]
    Unknown,
    /// A mean and its standard deviation: the estimate starts from them.
    Gaussian(f64, f64),
    /// Exactly this: nothing is estimated.
    Fixed(f64),
}

impl Prior {
    /// Value and standard deviation; those given where nothing is known.
    pub fn or(self, value: f64, sigma: f64) -> Estimate {
        match self {
            Self::Unknown => Estimate { value, sigma },
            Self::Gaussian(value, sigma) => Estimate { value, sigma },
            Self::Fixed(value) => Estimate::exact(value),
        }
    }

    /// The same in another unit.
    pub fn scaled(self, factor: f64) -> Self {
        match self {
            Self::Unknown => Self::Unknown,
            Self::Gaussian(value, deviation) => Self::Gaussian(value * factor, deviation * factor.abs()),
            Self::Fixed(value) => Self::Fixed(value * factor),
        }
    }
}

/// As logs and reports have it: with one digit after the point unless they ask for more.
impl std::fmt::Display for Prior {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let digits = f.precision().unwrap_or(1);
        match self {
            Self::Unknown => f.write_str("unknown"),
            Self::Gaussian(value, deviation) => write!(f, "{value:.digits$} ± {deviation:.digits$}"),
            Self::Fixed(value) => write!(f, "{value:.digits$}"),
        }
    }
}

/// What is known of a camera.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Optics {
    /// In how many seconds it reads a frame's rows; negative from bottom to top.
    pub readout_s: Prior,
    /// How many degrees it sees from left to right.
    pub hfov_deg: Prior,
    /// The lens's k1 ([`crate::geometry::Pinhole`]).
    pub lens_k1: Prior,
}

/// What a pair of frames, the reference and the newest, showed.
#[derive(Debug)]
pub struct Pair<'a> {
    /// Points seen in both.
    pub tracks: &'a mut [Track],
    /// Their homography.
    pub fit: &'a Fit,
    /// Time from one to the other, seconds; more than 0.
    pub interval_s: f64,
    /// By how much the frames' stamps say otherwise, seconds.
    pub off_s: f64,
    /// Whether the time is known, or no more than the best guess.
    pub is_certain: bool,
}

/// The camera's path where the reading of a frame's rows begins and ends.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RowSpan<T> {
    /// At the first row, and at the last.
    pub first: T,
    /// See `first`.
    pub last: T,
    /// At the last row of the frame before, as this frame shows it: what came after it was not known to that one.
    pub last_before: T,
    /// Seconds from the first row to the frame's reference time, and from there to the last.
    pub half_s: f64,
    /// Seconds since the frame before; 0 where nothing is known of it.
    pub interval_s: f64,
}

impl<T> RowSpan<T> {
    /// The same path, written otherwise.
    pub fn map<U>(self, mut f: impl FnMut(T) -> U) -> RowSpan<U> {
        let Self { first, last, last_before, half_s, interval_s } = self;
        RowSpan { first: f(first), last: f(last), last_before: f(last_before), half_s, interval_s }
    }
}

/// What is known of one frame's motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// Motion of the rows within the frame.
    pub rows: RowMotion,
    /// Motion since the frame before, the model's own four parameters.
    pub motion: PathParameters,
    /// The camera's path at the frame's reference time, the model's own four parameters.
    pub path: PathParameters,
    /// The same where the reading of the frame begins and ends.
    pub ends: RowSpan<PathParameters>,
    /// How far to believe it, 0 to 1.
    pub confidence: f64,
    /// The part of the rows' motion that is to be undone, 0 to 1.
    pub agreement: f64,
}

/// A rolling-shutter model at work.
#[expect(clippy::large_enum_variant, reason = "there is one in a pipeline")]
#[derive(Debug)]
pub enum Shutter {
    /// The paper's.
    Cho2007(Cho2007),
    /// Continuous time.
    Continuous(Continuous),
}

impl Shutter {
    /// The model that `params` names, for a camera of which `optics` is known. The same `seed` gives the same choices.
    pub fn new(params: &Params, optics: Optics, seed: u64, level: Level) -> Self {
        match params.model {
            Model::Cho2007 => Self::Cho2007(Cho2007::new(params.parameters, optics.readout_s, optics.hfov_deg)),
            Model::Continuous => Self::Continuous(Continuous::new(optics, seed, level)),
        }
    }

    /// What is believed of the camera; `None` where the model does not estimate it, and before the first pair of frames.
    pub fn calibration(&self) -> Option<Calibration> {
        match self {
            Self::Cho2007(_) => None,
            Self::Continuous(model) => model.calibration(),
        }
    }

    /// Whether the model is built on the pair's homography; one that is not says of each track how far it agrees.
    pub fn asks_homography(&self) -> bool {
        matches!(self, Self::Cho2007(_))
    }

    /// How many frames later a frame's motion is known.
    pub fn frames_late(&self) -> usize {
        match self {
            Self::Cho2007(model) => model.frames_late(),
            Self::Continuous(_) => 0,
        }
    }

    /// A stream of pictures of `size` (width, height) begins: forgets what was.
    pub fn begin(&mut self, size: [usize; 2]) {
        match self {
            Self::Cho2007(model) => model.begin(size),
            Self::Continuous(model) => model.begin(size),
        }
    }

    /// Takes in what a pair of frames showed.
    pub fn observe(&mut self, pair: Pair<'_>) {
        match self {
            Self::Cho2007(model) => model.observe(&pair),
            Self::Continuous(model) => model.observe(pair),
        }
    }

    /// The motion of the last pair's newest frame.
    pub fn newest(&self) -> Motion {
        match self {
            Self::Cho2007(model) => model.newest(),
            Self::Continuous(model) => model.newest(),
        }
    }

    /// The motion of the last pair's reference frame.
    pub fn reference(&self) -> Motion {
        match self {
            Self::Cho2007(model) => model.reference(),
            Self::Continuous(model) => model.newest(),
        }
    }

    /// A path's parameters as ones that do not mix zoom and place: what turns and what zooms, each for itself.
    pub fn pose(&self, path: PathParameters) -> Pose {
        match self {
            Self::Cho2007(model) => model.pose(path),
            Self::Continuous(_) => Pose(path.0),
        }
    }

    /// The path's parameters for what [`Shutter::pose`] gave.
    pub fn path(&self, pose: Pose) -> PathParameters {
        match self {
            Self::Cho2007(model) => model.path(pose),
            Self::Continuous(_) => PathParameters(pose.0),
        }
    }

    /// Where output pixels come from, for a frame with the given motion. `smoothed` is the virtual camera's path, `strength`
    /// the part of the rows' motion that is undone (0 to 1), `view` takes output pixels to the virtual camera's.
    pub fn map(&self, motion: &Motion, smoothed: PathParameters, strength: f64, view: &View) -> OutputMap {
        match self {
            Self::Cho2007(model) => model.map(motion, smoothed, strength, view),
            Self::Continuous(_) => continuous::map(motion, smoothed, strength, view),
        }
    }
}
