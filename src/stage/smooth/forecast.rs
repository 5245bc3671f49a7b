//! Where the camera will go: a linear prediction that is learned from the last seconds.
//!
//! The camera's ways from tick to tick are taken for an autoregressive process, whose weights Burg's method finds (J. P. Burg,
//! "Maximum entropy spectral analysis", 1975; here with weights that fade with age). It is stable whatever it is given, does well with
//! few samples, and sees the turning points of shake, which is a narrow band. How wrong the forecasts were of late is measured for each
//! tick ahead, not derived.
//!
//! Ticks are frames, or a few of them at high rates. Frames whose times are uneven are read at ticks by interpolation.

use super::Tuning;

/// Ticks that are looked ahead.
pub const AHEAD: usize = 24;
/// Weights of the prediction.
const ORDER: usize = 12;
/// Ticks that are learned from, at most.
const PAST: usize = 120;
/// Frames that are remembered.
const HISTORY: usize = 256;
/// Ticks ahead for which [`Tuning::first_error`] is the error that is expected at first.
const FIRST: f64 = 6.0;

/// A frame as it was seen.
#[derive(Clone, Copy, Debug)]
struct Sample {
    /// Ticks.
    time: f64,
    place: f64,
    /// Ways that were then expected, from there to 1, 2 .. ticks on.
    expected: [f32; AHEAD],
}

/// A channel's forecast.
#[derive(Clone, Debug)]
pub struct Forecast {
    /// A ring; `newest` is the index of the newest, `seen` how many there are.
    history: Vec<Sample>,
    newest: usize,
    seen: usize,
    /// Mean squares of the errors, 1, 2 .. ticks on.
    squares: [f64; AHEAD],
}

impl Forecast {
    /// Knows nothing.
    pub fn new() -> Self {
        let sample = Sample { time: 0.0, place: 0.0, expected: [0.0; AHEAD] };
        Self { history: vec![sample; HISTORY], newest: 0, seen: 0, squares: [0.0; AHEAD] }
    }

    /// The camera is seen for the first time, at `place`; `unit` is half of the crop window.
    pub fn begin(&mut self, tuning: &Tuning, place: f64, unit: f64) {
        self.newest = 0;
        self.seen = 1;
        self.history[0] = Sample { time: 0.0, place, expected: [0.0; AHEAD] };
        self.squares = std::array::from_fn(|j| (tuning.first_error * unit * ((j + 1) as f64 / FIRST).min(1.0)).powi(2));
    }

    /// Standard deviations of the forecasts, 1, 2 .. ticks on.
    pub fn deviations(&self) -> [f64; AHEAD] {
        self.squares.map(f64::sqrt)
    }

    /// The camera is at `place`, `ticks` of `tick_s` seconds after the frame before; gives how far it will have gone 1, 2 .. ticks on.
    pub fn step(&mut self, tuning: &Tuning, place: f64, ticks: f64, tick_s: f64, unit: f64) -> [f64; AHEAD] {
        let time = self.history[self.newest].time + ticks;
        self.newest = (self.newest + 1) % HISTORY;
        self.seen = (self.seen + 1).min(HISTORY);
        self.history[self.newest] = Sample { time, place, expected: [0.0; AHEAD] };
        self.compare(1.0 - (-ticks * tick_s / tuning.error_s).exp(), ticks);
        let mut ways = [0.0; PAST];
        let count = self.ways(&mut ways);
        let weights = burg(&ways[..count], (-tick_s / tuning.forget_s).exp(), tuning.ridge * unit * unit);
        let expected = predict(&weights, &ways[..count]);
        self.history[self.newest].expected = expected.map(|way| way as f32);
        expected
    }

    fn frame(&self, age: usize) -> &Sample {
        &self.history[(self.newest + HISTORY - age) % HISTORY]
    }

    /// The ways of the last ticks, the newest first; gives how many there are.
    fn ways(&self, ways: &mut [f64; PAST]) -> usize {
        let newest = self.frame(0);
        let (mut after, mut age) = (newest.place, 1);
        for (i, way) in ways.iter_mut().enumerate() {
            let time = newest.time - (i + 1) as f64;
            while age < self.seen && self.frame(age).time > time + 1e-6 {
                age += 1;
            }
            if age >= self.seen {
                return i;
            }
            let (sooner, later) = (self.frame(age), self.frame(age - 1));
            let part = ((time - sooner.time) / (later.time - sooner.time)).clamp(0.0, 1.0);
            let place = sooner.place + part * (later.place - sooner.place);
            *way = after - place;
            after = place;
        }
        PAST
    }

    /// Holds what was expected of now against what is.
    fn compare(&mut self, news: f64, ticks: f64) {
        let Sample { time, place, .. } = *self.frame(0);
        let mut age = 1;
        for j in 0..AHEAD {
            let then = time - (j + 1) as f64;
            while age < self.seen && self.frame(age).time > then + 0.5 * ticks.min(1.0) {
                age += 1;
            }
            if age >= self.seen {
                return;
            }
            let sample = self.frame(age);
            let error = place - sample.place - f64::from(sample.expected[j]);
            self.squares[j] += news * (error * error - self.squares[j]);
        }
    }
}

/// Weights of the last ways in the next, by Burg's recursion. `ways` are the newest first; each counts `keep` times less than the one
/// after it. `ridge` is how much way squared must be seen before any of it is believed.
fn burg(ways: &[f64], keep: f64, ridge: f64) -> [f64; ORDER] {
    let mut weights = [0.0; ORDER];
    let n = ways.len();
    // prediction errors: of a way by those before it, and by those after it
    let (mut forth, mut back, mut share) = ([0.0; PAST], [0.0; PAST], [0.0; PAST]);
    forth[..n].copy_from_slice(ways);
    back[..n].copy_from_slice(ways);
    let mut weight = 1.0;
    for share in &mut share[..n] {
        *share = weight;
        weight *= keep;
    }
    for m in 0..ORDER.min(n / 2) {
        // newest first: the way before is the next in the list
        let pairs = n - m - 1;
        let (mut both, mut across) = (ridge, 0.0);
        for i in 0..pairs {
            let (f, b) = (forth[i], back[i + 1]);
            both += share[i] * (f * f + b * b);
            across += share[i] * f * b;
        }
        if both <= 0.0 {
            break;
        }
        let reflection = 2.0 * across / both;
        let before = weights;
        weights[m] = reflection;
        for i in 0..m {
            weights[i] = before[i] - reflection * before[m - 1 - i];
        }
        for i in 0..pairs {
            let (f, b) = (forth[i], back[i + 1]);
            forth[i] = f - reflection * b;
            back[i] = b - reflection * f;
        }
    }
    weights
}

/// How far the camera will have gone 1, 2 .. ticks on.
fn predict(weights: &[f64; ORDER], ways: &[f64]) -> [f64; AHEAD] {
    let mut last = [0.0; ORDER];
    for (last, way) in last.iter_mut().zip(ways) {
        *last = *way;
    }
    let mut gone = 0.0;
    std::array::from_fn(|_| {
        let way: f64 = last.iter().zip(weights).map(|(way, weight)| way * weight).sum();
        last.rotate_right(1);
        last[0] = way;
        gone += way;
        gone
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sine_is_foreseen_and_the_errors_say_so() {
        let tuning = Tuning::default();
        let mut forecast = Forecast::new();
        let path = |k: f64| (0.4 * k).sin() + 0.3 * (0.9 * k + 1.0).sin();
        forecast.begin(&tuning, path(0.0), 1.0);
        let mut expected = [0.0; AHEAD];
        for k in 1..400 {
            expected = forecast.step(&tuning, path(f64::from(k)), 1.0, 1.0 / 30.0, 1.0);
        }
        for (j, expected) in expected.iter().enumerate().take(6) {
            let way = path(399.0 + (j + 1) as f64) - path(399.0);
            assert!((expected - way).abs() < 0.05, "{j}: {expected}, {way}");
            assert!(forecast.deviations()[j] < 0.05);
        }
    }

    #[test]
    fn whatever_comes_the_forecast_stays_finite_and_stable() {
        let mut state = 7u64;
        let mut random = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1u64 << 52) as f64 - 1.0
        };
        let tuning = Tuning::default();
        let mut forecast = Forecast::new();
        forecast.begin(&tuning, 0.0, 1.0);
        let mut place = 0.0;
        for k in 0..600 {
            place += if k % 97 == 0 { 50.0 } else { random() };
            let expected = forecast.step(&tuning, place, [1.0, 0.5, 3.0, 1e-3][k % 4], 1.0 / 30.0, 1.0);
            assert!(expected.iter().all(|way| way.abs() < 2000.0), "{k}: {expected:?}");
        }
    }

    #[test]
    fn a_still_camera_stays() {
        let tuning = Tuning::default();
        let mut forecast = Forecast::new();
        forecast.begin(&tuning, 3.0, 1.0);
        for _ in 0..100 {
            assert_eq!(forecast.step(&tuning, 3.0, 1.0, 1.0 / 30.0, 1.0), [0.0; AHEAD]);
        }
    }
}
