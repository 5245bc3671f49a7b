//! A frame on its way through the stages: the picture, when it was taken, and the results of each stage.

use std::ops::Index;

use crate::geometry::{Calibration, Homography, OutputMap, PerChannel, RowMotion};
use crate::image::{Picture, Plane};

/// When a frame was taken and what its source says of it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Stamp {
    /// Capture time of the first row, nanoseconds on the source's clock (V4L2: usually CLOCK_MONOTONIC).
    pub time_ns: i64,
    /// The source's own count; gaps are frames that the source lost.
    pub sequence: u64,
    /// What the source says of the frame.
    pub flags: FrameFlags,
}

/// When a frame was taken, as [`crate::stage::timing`] judges its stamp and those before.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Moment {
    /// Nanoseconds on the camera's own even clock; only differences mean something.
    pub time_ns: i64,
    /// By how much the stamps say that more time passed since the frame before (seconds).
    pub off_s: f64,
    /// Whether the time since the frame before is known: the camera's rhythm is, and the stamp agrees with it.
    pub is_certain: bool,
}

/// What a source says of a frame; a set of bits, stored as such in recordings.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FrameFlags(pub u32);

impl FrameFlags {
    /// The driver marked the frame's data as damaged (V4L2_BUF_FLAG_ERROR).
    pub const ERROR: Self = Self(1);
    /// The frame's data is shorter than it should be.
    pub const TRUNCATED: Self = Self(2);

    /// Whether every bit of `other` is set.
    pub fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }

    /// Both sets of bits.
    pub fn with(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

/// One point of the scene, seen in the frame before and in this one. Pixels of the input picture.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Track {
    /// Where the frame before showed it (x, y).
    pub from: [f64; 2],
    /// Where this frame shows it (x, y).
    pub to: [f64; 2],
    /// Name of the point, kept while it is followed.
    pub id: u32,
    /// Frames for which it has been followed, this one included.
    pub age: u32,
    /// Standard deviation of `to`, as the patch's texture and its difference suggest (pixels).
    pub sigma_px: f32,
    /// How it agreed with the camera's motion in the frames before: 1 wholly, 0 not at all.
    pub background: f32,
    /// What the shutter model made of it in this frame: 1 agrees wholly with the camera's motion, 0 not at all.
    pub weight: f32,
}

/// The pyramid of a frame's luma: level 0 is the picture, each further one half as wide and high.
#[derive(Clone, Debug, Default)]
pub struct Pyramid {
    /// Level 1 and up; level 0 is the picture's own luma plane.
    pub levels: Vec<Plane>,
}

/// What became of a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Outcome {
    /// Nothing yet.
    #[default]
    Pending,
    /// Shake and rolling shutter were removed, as far as the motion is known.
    Stabilized,
    /// The picture before was shown again.
    Held(HoldReason),
    /// Shown with no correction but the crop.
    PassedThrough(PassReason),
}

impl Outcome {
    /// A number for it, in records and shared memory: 0 stabilized (or pending), 1 first frame, 2 track lost, 3 switched off, 4 damaged.
    pub fn code(self) -> u8 {
        match self {
            Self::Stabilized | Self::Pending => 0,
            Self::PassedThrough(PassReason::First) => 1,
            Self::PassedThrough(PassReason::LostTrack) => 2,
            Self::PassedThrough(PassReason::SwitchedOff) => 3,
            Self::Held(HoldReason::Damaged) => 4,
        }
    }

    /// The outcome of this number; pending where there is none.
    pub fn from_code(code: u8) -> Self {
        match code {
            0 => Self::Stabilized,
            1 => Self::PassedThrough(PassReason::First),
            2 => Self::PassedThrough(PassReason::LostTrack),
            3 => Self::PassedThrough(PassReason::SwitchedOff),
            4 => Self::Held(HoldReason::Damaged),
            _ => Self::Pending,
        }
    }
}

/// Why a picture was shown again.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HoldReason {
    /// The frame's data was damaged.
    Damaged,
}

/// Why a frame was not stabilized.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PassReason {
    /// The stream begins, or its size changed: there is no frame to compare with. Nothing is corrected but, with a model that learns a frame's
    /// motion from the frame after it (cho2007 with "time-t"), rolling shutter.
    First,
    /// Too few points could be followed, for too long.
    LostTrack,
    /// Stabilization is switched off.
    SwitchedOff,
}

/// The stages whose time is taken, in journey order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(usize)]
pub enum Stage {
    /// Raw bytes to a planar picture, decoding included.
    Unpack,
    /// Luma pyramid.
    Pyramid,
    /// Corners.
    Detect,
    /// Lucas-Kanade.
    Track,
    /// Homography.
    Fit,
    /// Rolling-shutter model.
    Shutter,
    /// Path filter and crop window.
    Smooth,
    /// Warp into the canvas.
    Warp,
    /// The sink.
    Submit,
}

impl Stage {
    /// Every stage, in journey order.
    pub const ALL: [Self; 9] = [
        Self::Unpack,
        Self::Pyramid,
        Self::Detect,
        Self::Track,
        Self::Fit,
        Self::Shutter,
        Self::Smooth,
        Self::Warp,
        Self::Submit,
    ];

    /// The name under which reports show it.
    pub fn name(self) -> &'static str {
        ["unpack", "pyramid", "detect", "track", "fit", "shutter", "smooth", "warp", "submit"][self as usize]
    }
}

/// The homography from the frame before to this one, and how far to believe it.
#[derive(Clone, Copy, Debug, Default)]
pub struct Fit {
    /// Takes a pixel of the frame before to this frame (eq. 1).
    pub homography: Homography,
    /// Tracks that agree with it.
    pub inliers: u32,
    /// Tracks there were.
    pub tracks: u32,
    /// 0 (unknown) to 1: in the homography alone. The default model's motion has a confidence of its own ([`FrameContext::confidence`]).
    pub confidence: f64,
}

/// A motion or a path in the four parameters of the rolling-shutter model in use: yaw, pitch, roll (radians) and log zoom of `continuous`;
/// a, c and d (pixels) of eq. (2), then 0, of `cho2007`. Only the model computes with them; traces and reports show them.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PathParameters(pub [f64; 4]);

impl Index<usize> for PathParameters {
    type Output = f64;

    fn index(&self, parameter: usize) -> &f64 {
        &self.0[parameter]
    }
}

/// The results of the stages for a frame, in their order.
#[derive(Clone, Debug, Default)]
pub struct FrameContext {
    /// Frame's time after the frame before it by the camera's own clock, seconds (at most 1); 0 for a stream's first.
    pub interval_s: f64,
    /// The camera or its driver gave the frame before once more: it shows nothing new.
    pub repeat: bool,
    /// Points followed from the frame before into this one.
    pub tracks: Vec<Track>,
    /// Their homography.
    pub fit: Fit,
    /// Motion of the rows within the frame.
    pub rows: RowMotion,
    /// What the model believes of the camera at this frame; `None` where it does not estimate it.
    pub calibration: Option<Calibration>,
    /// Motion since the frame before.
    pub motion: PathParameters,
    /// The camera's path at the frame's reference time (cho2007: U).
    pub path: PathParameters,
    /// The virtual camera's path (cho2007: S).
    pub smoothed: PathParameters,
    /// How far the motion is believed, 0 (unknown) to 1; what [`FrameContext::trust`] follows.
    pub confidence: f64,
    /// How far the correction is believed, 0 to 1; moves slowly.
    pub trust: f64,
    /// The part of the rows' own motion that is undone, 0 to 1.
    pub rows_gain: f64,
    /// Largest share of the crop window's margin that the correction uses, 0 to 1.
    pub crop_use: f64,
    /// What each channel takes of the margin where least of it is left (yaw, pitch, roll, zoom); their sum is about `crop_use`, and one that
    /// makes room is negative.
    pub crop_shares: PerChannel,
    /// The crop's zoom: the part of the picture that is shown is 1 / zoom wide.
    pub crop_zoom: f64,
    /// Where each output pixel comes from.
    pub map: OutputMap,
    /// What became of the frame.
    pub outcome: Outcome,
    /// Time spent in each stage, nanoseconds, by [`Stage`].
    pub spent_ns: [u64; Stage::ALL.len()],
}

impl FrameContext {
    /// Forgets the results, keeps the memory and the time that unpacking took.
    pub fn reset(&mut self) {
        let mut tracks = std::mem::take(&mut self.tracks);
        tracks.clear();
        let mut spent_ns = [0; Stage::ALL.len()];
        spent_ns[Stage::Unpack as usize] = self.spent_ns[Stage::Unpack as usize];
        *self = Self { tracks, spent_ns, ..Self::default() };
    }
}

/// A frame on its way. Made once, in a pool; nothing in it is allocated per frame after the first few.
#[derive(Debug, Default)]
pub struct Frame {
    /// When it was taken, as its source says.
    pub stamp: Stamp,
    /// When it was taken, on the camera's own clock.
    pub moment: Moment,
    /// The picture as it was taken.
    pub picture: Picture,
    /// Whether `picture` holds this frame; false where its data was damaged.
    pub intact: bool,
    /// Whether the lower part of `picture` is the picture before's: the end of this frame's data was missing.
    pub cut: bool,
    /// Luma at lower resolutions.
    pub pyramid: Pyramid,
    /// The results of the stages.
    pub context: FrameContext,
}
