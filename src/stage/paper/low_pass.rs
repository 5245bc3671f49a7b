//! The paper's filter: a second-order Butterworth low-pass.
//!
//! `y'' + sqrt(2) w y' + w^2 y = w^2 u` with `w = 2 pi cutoff`, taken exactly from one moment to the next with `u` a straight
//! line between them. That is a second-order IIR filter whose coefficients follow the frames' timestamps: at a steady rate they
//! are constant. It lags a steady pan by `sqrt(2) / w` seconds and does not amplify.

use std::f64::consts::FRAC_1_SQRT_2;

/// One channel of the filter.
#[derive(Clone, Copy, Debug, Default)]
pub struct LowPass {
    /// What goes in.
    pub input: f64,
    /// What comes out.
    pub output: f64,
    /// Speed of the output, units / second.
    pub speed: f64,
}

impl LowPass {
    /// The exact solution after time `t` (seconds) in which the input went straight to `input`; `w` in radians / second.
    pub fn after(self, w: f64, input: f64, t: f64) -> Self {
        if t <= 0.0 {
            return Self { input, ..self };
        }
        let slope = (input - self.input) / t;
        // the particular solution of a ramp lags it by sqrt(2) / w
        let lag = slope * 2.0 * FRAC_1_SQRT_2 / w;
        let (decay, turn) = (w * FRAC_1_SQRT_2, w * FRAC_1_SQRT_2);
        let start = self.output - (self.input - lag);
        let across = (self.speed - slope + decay * start) / turn;
        let (sin, cos) = (turn * t).sin_cos();
        let fade = (-decay * t).exp();
        let swing = fade * (start * cos + across * sin);
        let swing_speed = fade * ((across * turn - decay * start) * cos - (start * turn + decay * across) * sin);
        Self { input, output: input - lag + swing, speed: slope + swing_speed }
    }
}

/// Share of the window up to which a correction is left alone.
const KNEE: f64 = 0.7;
/// Seconds in which the gain returns.
const RELEASE_S: f64 = 2.0;

/// The part of a correction of `wanted` that a window of `edge` allows, `h` seconds after it was `gain`: falls at once, returns
/// slowly. Shake that is larger than the window is so made smaller and keeps its shape; cutting its tops off would make them
/// harder than they were.
pub fn gain(gain: f64, wanted: f64, edge: f64, h: f64) -> f64 {
    let use_ = wanted / edge.max(1e-12);
    let allowed = if use_ <= KNEE { 1.0 } else { (KNEE + (1.0 - KNEE) * ((use_ - KNEE) / (1.0 - KNEE)).tanh()) / use_ };
    allowed.min(gain + (1.0 - gain) * (1.0 - (-h / RELEASE_S).exp()))
}
