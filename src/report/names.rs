//! The words and units under which reports show a model's parameters and a frame's outcome.

use crate::frame::{HoldReason, Outcome, PassReason};
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

/// How a model's four parameters are to be read; those beyond `axes` are not used by it.
#[derive(Clone, Copy, Debug)]
pub struct MotionNames {
    /// The model's name, as in the configuration.
    pub model: &'static str,
    /// The parameters that it has.
    pub axes: &'static [Axis],
    /// Name of the camera's path.
    pub path: &'static str,
    /// Name of the virtual camera's path.
    pub smoothed: &'static str,
    /// Motion that is left between two frames of the output.
    steadied: fn(&Step) -> [f64; 4],
}

/// What a frame and the frame before it say of the motion between them, in the model's four parameters.
#[derive(Clone, Copy, Debug)]
pub struct Step {
    /// Motion of the camera between the two.
    pub motion: [f64; 4],
    /// Camera's path at the frame before, and now.
    pub path: [[f64; 4]; 2],
    /// Virtual camera's path at the frame before, and now.
    pub smoothed: [[f64; 4]; 2],
}

impl MotionNames {
    /// The names for `model`.
    pub fn of(model: Model) -> &'static Self {
        match model {
            Model::Cho2007 => &CHO2007,
            Model::Continuous => &CONTINUOUS,
        }
    }

    /// The motion that is left between two frames of the output; eq. (14) for cho2007.
    pub fn steadied(&self, step: &Step) -> [f64; 4] {
        (self.steadied)(step)
    }
}

const CHO2007: MotionNames = MotionNames {
    model: "cho2007",
    axes: &[
        Axis { name: "a", meaning: "zoom", unit: "" },
        Axis { name: "c", meaning: "horizontal shift", unit: "px" },
        Axis { name: "d", meaning: "vertical shift", unit: "px" },
    ],
    path: "U",
    smoothed: "S",
    steadied: steadied_cho2007,
};

const CONTINUOUS: MotionNames = MotionNames {
    model: "continuous",
    axes: &[
        Axis { name: "yaw", meaning: "turn to the right", unit: "rad" },
        Axis { name: "pitch", meaning: "turn upwards", unit: "rad" },
        Axis { name: "roll", meaning: "turn about the view", unit: "rad" },
        Axis { name: "zoom", meaning: "logarithm of the zoom", unit: "" },
    ],
    path: "P",
    smoothed: "S",
    steadied: |step| std::array::from_fn(|i| step.smoothed[1][i] - step.smoothed[0][i]),
};

/// Eq. (14): `T^s_t = W_{t+1} T_t W_t^-1` with `W = S U^-1` of eq. (13), all of the form of eq. (2).
fn steadied_cho2007(step: &Step) -> [f64; 4] {
    let [before, now] = [0, 1].map(|i| after(step.smoothed[i], inverse(step.path[i])));
    after(after(now, step.motion), inverse(before))
}

/// The product `p q` of two matrices `[[a, 0, c], [0, a, d], [0, 0, 1]]`, each given as (a, c, d, 0).
fn after([a, c, d, _]: [f64; 4], [qa, qc, qd, _]: [f64; 4]) -> [f64; 4] {
    [a * qa, a * qc + c, a * qd + d, 0.0]
}

/// The inverse of such a matrix; not finite where `a` is 0.
fn inverse([a, c, d, _]: [f64; 4]) -> [f64; 4] {
    [1.0 / a, -c / a, -d / a, 0.0]
}

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

#[cfg(test)]
mod tests {
    use super::*;

    /// Where `p` takes the point (x, y).
    fn apply([a, c, d, _]: [f64; 4], [x, y]: [f64; 2]) -> [f64; 2] {
        [a * x + c, a * y + d]
    }

    #[test]
    fn eq_14_carries_an_output_point_from_frame_to_frame() {
        let step = Step {
            motion: [1.01, 3.0, -2.0, 0.0],
            path: [[0.9, 5.0, 1.0, 0.0], [1.2, -4.0, 2.5, 0.0]],
            smoothed: [[1.0, 1.0, 2.0, 0.0], [1.05, 2.0, 1.0, 0.0]],
        };
        // The long way: output point back to its frame, along the camera's motion, out again through the next correction.
        let point = [120.0, 45.0];
        let in_frame = apply(step.path[0], apply(inverse(step.smoothed[0]), point));
        let moved = apply(step.motion, in_frame);
        let expected = apply(step.smoothed[1], apply(inverse(step.path[1]), moved));
        let got = apply(MotionNames::of(Model::Cho2007).steadied(&step), point);
        assert!((got[0] - expected[0]).abs() < 1e-9 && (got[1] - expected[1]).abs() < 1e-9, "{got:?} {expected:?}");
    }

    #[test]
    fn a_held_virtual_camera_leaves_no_motion() {
        let motion = [1.02, 4.0, -1.0, 0.0];
        let start = [1.1, 7.0, 3.0, 0.0];
        let held = [1.0, 2.0, 2.0, 0.0];
        let left = steadied_cho2007(&Step { motion, path: [start, after(motion, start)], smoothed: [held, held] });
        for (value, expected) in left.into_iter().zip([1.0, 0.0, 0.0, 0.0]) {
            assert!((value - expected).abs() < 1e-12, "{left:?}");
        }
    }
}
