//! Names and units of a model's parameters and of a frame's outcome in reports.

use crate::frame::{HoldReason, Outcome, PassReason, PathParameters};
use crate::stage::paper;
use crate::stage::shutter::Model;

/// One parameter of a motion model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Axis {
    /// Its name in formulas and column heads.
    pub name: &'static str,
    /// What it is, for a plot's title.
    pub meaning: &'static str,
    /// Its unit; empty for a ratio.
    pub unit: &'static str,
}

/// A model's parameters at the frame before, and now.
pub type BeforeAndNow = [PathParameters; 2];

/// How a model's four parameters are to be read; those beyond `axes` are not used by it.
#[derive(Clone, Copy, Debug)]
pub struct MotionNames {
    /// The model.
    pub model: Model,
    /// Its name, as in the configuration.
    pub name: &'static str,
    /// The parameters that it has.
    pub axes: &'static [Axis],
    /// Name of the camera's path.
    pub path: &'static str,
    /// Name of the virtual camera's path.
    pub smoothed: &'static str,
    /// Motion that is left between two frames of the output.
    steadied: fn(BeforeAndNow, BeforeAndNow) -> PathParameters,
}

impl MotionNames {
    /// The names for `model`.
    pub fn of(model: Model) -> &'static Self {
        match model {
            Model::Cho2007 => &CHO2007,
            Model::Continuous => &CONTINUOUS,
        }
    }

    /// The motion that is left between two frames of the output (eq. (14) for cho2007), from the camera's and the virtual
    /// camera's path, before and now.
    pub fn steadied(&self, path: BeforeAndNow, smoothed: BeforeAndNow) -> PathParameters {
        (self.steadied)(path, smoothed)
    }
}

const CHO2007: MotionNames = MotionNames {
    model: Model::Cho2007,
    name: "cho2007",
    axes: &[
        Axis { name: "a", meaning: "zoom", unit: "" },
        Axis { name: "c", meaning: "horizontal shift", unit: "px" },
        Axis { name: "d", meaning: "vertical shift", unit: "px" },
    ],
    path: "U",
    smoothed: "S",
    steadied: paper::stabilized_motion,
};

const CONTINUOUS: MotionNames = MotionNames {
    model: Model::Continuous,
    name: "continuous",
    axes: &[
        Axis { name: "yaw", meaning: "turn to the right", unit: "rad" },
        Axis { name: "pitch", meaning: "turn upwards", unit: "rad" },
        Axis { name: "roll", meaning: "turn about the view", unit: "rad" },
        Axis { name: "zoom", meaning: "logarithm of the zoom", unit: "" },
    ],
    path: "P",
    smoothed: "S",
    steadied: |_, smoothed| PathParameters(std::array::from_fn(|i| smoothed[1][i] - smoothed[0][i])),
};

/// A frame's outcome and its reason.
pub fn outcome_name(outcome: Outcome) -> &'static str {
    match outcome {
        Outcome::Pending => "pending",
        Outcome::Stabilized => "stabilized",
        Outcome::Held(HoldReason::Damaged) => "held: damaged",
        Outcome::PassedThrough(PassReason::First) => "passed through: first",
        Outcome::PassedThrough(PassReason::LostTrack) => "passed through: lost track",
        Outcome::PassedThrough(PassReason::SwitchedOff) => "passed through: switched off",
    }
}
