//! The virtual camera's path: a causal low-pass of the camera's own.
//!
//! A second-order Butterworth low-pass, `y'' + sqrt(2) w y' + w^2 y = w^2 u` with `w = 2 pi cutoff`, taken exactly from one frame's
//! time to the next with `u` a straight line between them. That is a second-order IIR filter whose coefficients follow the
//! frames' timestamps: at a steady rate they are constant. It lags a steady pan by `sqrt(2) / w` seconds and does not amplify.

use std::f64::consts::{FRAC_1_SQRT_2, TAU};

/// Settings of the path filter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Params {
    /// Motion slower than this is followed, faster is taken out (Hz, 0.05 to 10).
    pub cutoff_hz: f64,
}

impl Default for Params {
    fn default() -> Self {
        Self { cutoff_hz: 0.6 }
    }
}

/// Filters a path of four parameters.
#[derive(Clone, Debug)]
pub struct Smoother {
    /// w, radians / second.
    angular: f64,
    state: Option<[Channel; 4]>,
}

#[derive(Clone, Copy, Debug, Default)]
struct Channel {
    input: f64,
    output: f64,
    /// Speed of the output, units / second.
    speed: f64,
}

impl Smoother {
    /// A filter that has seen nothing.
    pub fn new(params: &Params) -> Self {
        Self { angular: TAU * params.cutoff_hz, state: None }
    }

    /// A stream begins: the next path is followed from where it is.
    pub fn begin(&mut self) {
        self.state = None;
    }

    /// The smoothed path after `interval_s` seconds in which the path went to `path`.
    pub fn step(&mut self, path: [f64; 4], interval_s: f64) -> [f64; 4] {
        let Some(state) = &mut self.state else {
            self.state = Some(path.map(|input| Channel { input, output: input, speed: 0.0 }));
            return path;
        };
        for (channel, input) in state.iter_mut().zip(path) {
            *channel = channel.after(self.angular, input, interval_s.clamp(0.0, 10.0));
        }
        state.map(|channel| channel.output)
    }
}

impl Channel {
    /// The exact solution after time `t` in which the input went straight to `input`.
    fn after(self, w: f64, input: f64, t: f64) -> Self {
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

#[cfg(test)]
mod tests {
    use super::*;

    fn run(rate: f64, seconds: f64, cutoff_hz: f64, path: impl Fn(f64) -> f64) -> f64 {
        let mut smoother = Smoother::new(&Params { cutoff_hz });
        let mut out = 0.0;
        for k in 0..=(rate * seconds) as usize {
            out = smoother.step([path(k as f64 / rate); 4], 1.0 / rate)[0];
        }
        out
    }

    #[test]
    fn a_still_path_stays_exactly_where_it_is() {
        assert_eq!(run(30.0, 5.0, 0.6, |_| 3.25), 3.25);
    }

    #[test]
    fn a_step_settles_with_the_overshoot_of_butterworth() {
        let step = |t: f64| if t > 0.5 { 1.0 } else { 0.0 };
        let most = (0..200).map(|i| run(100.0, i as f64 * 0.02, 1.0, step)).fold(0.0, f64::max);
        assert!((most - 1.0432).abs() < 2e-3, "overshoot to {most}, exp(-pi) = 0.0432 above 1 expected");
        assert!((run(100.0, 8.0, 1.0, step) - 1.0).abs() < 1e-6);
    }

    #[test]
    fn the_rate_of_frames_changes_nothing_for_a_path_of_straight_lines() {
        let path = |t: f64| if t < 1.0 { t } else { 2.0 - t };
        let (slow, fast) = (run(15.0, 3.0, 0.6, path), run(60.0, 3.0, 0.6, path));
        assert!((slow - fast).abs() < 1e-9, "{slow} {fast}");
    }

    #[test]
    fn a_sine_at_the_cutoff_loses_three_decibels() {
        let mut smoother = Smoother::new(&Params { cutoff_hz: 0.6 });
        let mut most = 0.0f64;
        for k in 0..3000 {
            let t = k as f64 / 200.0;
            let out = smoother.step([(TAU * 0.6 * t).sin(); 4], 0.005)[0];
            if t > 10.0 {
                most = most.max(out);
            }
        }
        assert!((most - FRAC_1_SQRT_2).abs() < 2e-3, "{most}");
    }
}
