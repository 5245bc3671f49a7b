//! Where the camera will go: a linear prediction that is learned from the last seconds.
//!
//! The camera's movements from tick to tick are modelled as an autoregressive process, whose weights Burg's method finds (J. P. Burg,
//! "Maximum entropy spectral analysis", 1975; here with weights that fade with age). It is stable whatever it is given, does well with
//! few samples, and sees the turning points of shake, which is a narrow band. How wrong the forecasts were of late is measured for each
//! tick ahead, not derived.
//!
//! A frame's last row sees the camera later than its middle row, by up to half an interval: what is forecast begins there, with so much
//! less to foresee. The frame after says better where that was (nothing came behind it yet); it takes the place of what was said first.
//!
//! Ticks are frames, or a few of them at high rates. Frames whose times are uneven are read at ticks by interpolation.

mod burg;

use super::Tuning;
use crate::stage::shutter::RowSpan;

/// Ticks that are looked ahead.
pub const AHEAD: usize = 24;
/// Weights of the prediction.
const ORDER: usize = 12;
/// Ticks that are learned from, at most.
const PAST: usize = 120;
/// Places that are remembered: three to a frame.
const HISTORY: usize = 768;
/// Places nearer in time than this are one (seconds): the last row of a frame and the first of the next, where reading takes it all.
const MIN_APART_S: f64 = 1e-4;
/// Ticks ahead for which [`Tuning::first_error`] is the error that is expected at first.
const FIRST: f64 = 6.0;
/// Least length of a tick, seconds: frames that come faster are taken several at a time.
const MIN_TICK_S: f64 = 0.8 / 30.0;
/// How far ahead the error of forecasts is measured, seconds.
const SOON_S: f64 = 0.067;
/// Factor by which the frames' interval may be off the ticks' before these are chosen again.
const OFF: f64 = 1.3;

/// Where the camera was seen.
#[derive(Clone, Copy, Debug)]
struct Sample {
    /// Seconds.
    time: f64,
    place: f64,
    /// Ways that were then expected, from there to 1, 2 .. ticks of that length (seconds) on; a length of 0 where nothing was.
    expected: [f32; AHEAD],
    tick_s: f64,
}

/// A channel's forecast.
#[derive(Clone, Debug)]
pub struct Forecast {
    /// A ring; `newest` is the index of the newest, `seen` how many there are.
    history: Vec<Sample>,
    newest: usize,
    seen: usize,
    /// The newest frame's time, seconds.
    now: f64,
    /// Length of a tick (seconds), and frames to one; 0 before there is one.
    tick_s: f64,
    frames: f64,
    /// Mean squares of the errors, 1, 2 .. ticks on.
    squares: [f64; AHEAD],
    /// The mean square of the errors [`SOON_S`] ahead, over a longer time; none before there is a tick.
    forecast_error: Option<f64>,
}

impl Forecast {
    /// Knows nothing.
    pub fn new() -> Self {
        let sample = Sample { time: 0.0, place: 0.0, expected: [0.0; AHEAD], tick_s: 0.0 };
        Self {
            history: vec![sample; HISTORY],
            newest: 0,
            seen: 0,
            now: 0.0,
            tick_s: 0.0,
            frames: 1.0,
            squares: [0.0; AHEAD],
            forecast_error: None,
        }
    }

    /// The camera is seen for the first time, at `place`.
    pub fn begin(&mut self, place: f64) {
        (self.newest, self.seen, self.now, self.tick_s, self.forecast_error) = (0, 1, 0.0, 0.0, None);
        self.history[0] = Sample { time: 0.0, place, expected: [0.0; AHEAD], tick_s: 0.0 };
    }

    /// Length of a tick, seconds.
    pub fn tick_s(&self) -> f64 {
        self.tick_s
    }

    /// The camera is at `place`, `interval_s` seconds after the frame before, and at `ends` where the first and last rows saw it; `unit` is
    /// half of the crop window; 0 where nothing is to be foreseen.
    pub fn observe(&mut self, tuning: &Tuning, place: f64, interval_s: f64, ends: RowSpan<f64>, unit: f64) {
        self.now += interval_s;
        let RowSpan { first, last, last_before, half_s, .. } = ends;
        if ends.interval_s > 0.0 {
            self.revise(self.now + half_s - ends.interval_s, last_before);
        }
        if half_s > 0.0 {
            self.push(self.now - half_s, first);
        }
        self.push(self.now, place);
        if half_s > 0.0 {
            self.push(self.now + half_s, last);
        }
        if interval_s <= 0.0 || !unit.is_finite() || unit <= 0.0 {
            return;
        }
        self.keep_time(tuning, interval_s, unit);
        self.forecast_error.get_or_insert((tuning.unforeseen_from * unit).powi(2));
        self.compare(tuning, interval_s);
        let mut ways = [0.0; PAST];
        let count = self.ways(&mut ways);
        let weights = burg::weights(&ways[..count], (-self.tick_s / tuning.forget_s).exp(), tuning.ridge * unit * unit);
        let newest = &mut self.history[self.newest];
        newest.expected = burg::predict(&weights, &ways[..count]).map(|way| way as f32);
        newest.tick_s = self.tick_s;
    }

    /// The camera was at `place` at that time. Where something as late is known, that stays: errors are measured by what it expected.
    fn push(&mut self, time: f64, place: f64) {
        if time > self.frame(0).time + MIN_APART_S {
            self.newest = (self.newest + 1) % HISTORY;
            self.seen = (self.seen + 1).min(HISTORY);
            self.history[self.newest] = Sample { time, place, expected: [0.0; AHEAD], tick_s: 0.0 };
        }
    }

    /// The newest place was at `time`, and is known better now.
    fn revise(&mut self, time: f64, place: f64) {
        let newest = &mut self.history[self.newest];
        if self.seen > 1 && (newest.time - time).abs() < MIN_APART_S {
            newest.place = place;
        }
    }

    /// Where the camera is `seconds` after the newest frame (before it, where negative), and the standard deviation of that.
    pub fn at(&self, seconds: f64) -> (f64, f64) {
        let newest = self.frame(0);
        let seconds = seconds - (newest.time - self.now);
        if seconds <= 0.0 {
            return (self.seen_at(newest.time + seconds, &mut 1).unwrap_or(self.frame(self.seen.max(1) - 1).place), 0.0);
        }
        let ticks = seconds / self.tick_s;
        let sooner = (ticks as usize).min(AHEAD);
        let part = if sooner < AHEAD { ticks - sooner as f64 } else { 0.0 };
        let of = |values: &dyn Fn(usize) -> f64| {
            let value = |n: usize| if n == 0 { 0.0 } else { values(n - 1) };
            value(sooner) + part * (value((sooner + 1).min(AHEAD)) - value(sooner))
        };
        (newest.place + of(&|j| f64::from(newest.expected[j])), of(&|j| self.squares[j].sqrt()))
    }

    /// How far forecasts `SOON_S` ahead were off of late: root of the mean square, in the path's units.
    pub fn forecast_error(&self) -> f64 {
        self.forecast_error.unwrap_or(0.0).sqrt()
    }

    /// How far the places of the last `seconds` lie apart, in the path's units; of fewer seconds where fewer are remembered.
    pub fn range(&self, seconds: f64) -> f64 {
        let (mut least, mut most) = (f64::INFINITY, f64::NEG_INFINITY);
        for sample in (0..self.seen).map(|age| self.frame(age)).take_while(|sample| sample.time >= self.now - seconds) {
            (least, most) = (least.min(sample.place), most.max(sample.place));
        }
        (most - least).max(0.0)
    }

    fn frame(&self, age: usize) -> &Sample {
        &self.history[(self.newest + HISTORY - age) % HISTORY]
    }

    /// Chooses ticks of another length where the rate of the frames has changed.
    fn keep_time(&mut self, tuning: &Tuning, interval_s: f64, unit: f64) {
        let before_s = self.tick_s;
        if before_s > 0.0 && (1.0 / OFF..OFF).contains(&(interval_s * self.frames / before_s)) {
            return;
        }
        self.frames = (MIN_TICK_S / interval_s).ceil().max(1.0);
        self.tick_s = self.frames * interval_s;
        let (before, longer) = (self.squares, self.tick_s / before_s);
        self.squares = std::array::from_fn(|j| {
            let tick = (j + 1) as f64;
            if before_s > 0.0 {
                before[((tick * longer).round() as usize).clamp(1, AHEAD) - 1]
            } else {
                (tuning.first_error * unit * (tick / FIRST).min(1.0)).powi(2)
            }
        });
    }

    /// Where the camera was seen at a time, between frames too; none where that was before all that is remembered. `age` is where the
    /// search begins, and where it ended.
    fn seen_at(&self, time: f64, age: &mut usize) -> Option<f64> {
        while *age < self.seen && self.frame(*age).time > time + 1e-6 * self.tick_s {
            *age += 1;
        }
        if *age >= self.seen {
            return None;
        }
        let (sooner, later) = (self.frame(*age), self.frame(*age - 1));
        let part = ((time - sooner.time) / (later.time - sooner.time).max(1e-9)).clamp(0.0, 1.0);
        Some(sooner.place + part * (later.place - sooner.place))
    }

    /// The ways of the last ticks, the newest first; gives how many there are.
    fn ways(&self, ways: &mut [f64; PAST]) -> usize {
        let newest = self.frame(0);
        let (mut after, mut age) = (newest.place, 1);
        for (i, way) in ways.iter_mut().enumerate() {
            let Some(place) = self.seen_at(newest.time - (i + 1) as f64 * self.tick_s, &mut age) else { return i };
            *way = after - place;
            after = place;
        }
        PAST
    }

    /// Holds what was expected of now against what is.
    fn compare(&mut self, tuning: &Tuning, interval_s: f64) {
        let [news, slow] = [tuning.error_s, tuning.surprise_s].map(|memory_s| 1.0 - (-interval_s / memory_s).exp());
        let soon = (SOON_S / self.tick_s).round().max(1.0) as usize - 1;
        let Sample { time, place, .. } = *self.frame(0);
        let mut age = 1;
        for j in 0..AHEAD {
            let then = time - (j + 1) as f64 * self.tick_s;
            let late = then + 0.5 * interval_s.min(self.tick_s);
            while age < self.seen && (self.frame(age).time > late || self.frame(age).tick_s == 0.0) {
                age += 1;
            }
            if age >= self.seen {
                return;
            }
            let sample = self.frame(age);
            if sample.tick_s == self.tick_s {
                let error = place - sample.place - f64::from(sample.expected[j]);
                self.squares[j] += news * (error * error - self.squares[j]);
                if let (true, Some(forecast_error)) = (j == soon, &mut self.forecast_error) {
                    *forecast_error += slow * (error * error - *forecast_error);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests;
