//! A rough search for the readout time: how much the picture leans while the camera turns faster.
//!
//! Between two frames row y moves by `P(t_b + readout y / H) - P(t_a + readout y / H)`, which changes from the first row to the last by
//! `readout (P'(t_b) - P'(t_a))`. The hypotheses know that slope over the rows; the change of speed is half the difference of the
//! turns of the pairs before and after. Both are turns, so that neither focal length nor anything else is asked: least squares give
//! the readout time, with its sign. For shake of angular frequency w the differences of turns see
//! sin(wT) / (wT) of the change of speed; w is known from how much the turns bend (second difference: 4 sin(wT/2)^2 of the turn). For a mix of
//! frequencies that is roughly right, so this only bounds the estimate.

use crate::geometry::hypot;

/// Seconds for which pairs are remembered.
const MEMORY_S: f64 = 6.0;
/// Standard deviations that are stated for one that the statistics give: neighbouring pairs share their errors.
const CAUTION: f64 = 2.0;
/// Pairs below which there is no estimate.
const MIN_PAIRS: f64 = 12.0;
/// Turn of a pair from which its rows count as moving, by what is noise: at two pixels a frame the rows are up to two pixels off.
const MOVES: f64 = 3.0;
/// Factor between two intervals up to which they count as even.
const EVEN: f64 = 1.25;

/// A pair of frames: its interval, its turn and that turn's slope over the rows (yaw, pitch).
#[derive(Clone, Copy, Debug, Default)]
struct Turn {
    interval_s: f64,
    turn: [f64; 2],
    slope: [f64; 2],
}

/// What was seen so far.
#[derive(Clone, Copy, Debug, Default)]
pub struct ReadoutSearch {
    /// The last two pairs, the newest last.
    last: [Turn; 2],
    /// Sums of slope x change of speed, change^2, slope^2, turn^2, bend^2, and of 1.
    sums: [f64; 6],
    /// Pairs in which the picture moved by more than noise, older ones less and less.
    moving: f64,
}

impl ReadoutSearch {
    /// Adds a pair of frames `interval_s` apart: turn and slope of yaw and pitch. Changes of the turn below
    /// `least` (radians) are noise, which would pull the readout time to nothing.
    pub fn add(&mut self, turn: [f64; 2], slope: [f64; 2], interval_s: f64, least: f64) {
        let newest = Turn { interval_s, turn, slope };
        let [first, middle] = self.last;
        self.last = [middle, newest];
        let moves = hypot(turn[0], turn[1]) >= MOVES * least;
        self.moving = (-interval_s / MEMORY_S).exp() * self.moving + f64::from(u8::from(moves));
        let even = |a: f64, b: f64| a > 0.0 && b > 0.0 && a < EVEN * b && b < EVEN * a;
        if !even(first.interval_s, middle.interval_s) || !even(middle.interval_s, newest.interval_s) {
            return;
        }
        let changes: [f64; 2] = std::array::from_fn(|i| 0.5 * (newest.turn[i] - first.turn[i]));
        if hypot(changes[0], changes[1]) < least {
            return;
        }
        let keep = (-interval_s / MEMORY_S).exp();
        let mut news = [0.0, 0.0, 0.0, 0.0, 0.0, 1.0];
        for i in 0..2 {
            let change = changes[i] / middle.interval_s;
            news[0] += middle.slope[i] * change;
            news[1] += change * change;
            news[2] += middle.slope[i] * middle.slope[i];
            news[3] += middle.turn[i] * middle.turn[i];
            news[4] += (newest.turn[i] - 2.0 * middle.turn[i] + first.turn[i]).powi(2);
        }
        for (sum, news) in self.sums.iter_mut().zip(news) {
            *sum = keep * *sum + news;
        }
    }

    /// The next pair does not follow the last one.
    pub fn interrupt(&mut self) {
        self.last = [Turn::default(); 2];
    }

    /// Readout time and its standard deviation, seconds.
    pub fn readout(&self) -> Option<(f64, f64)> {
        let [across, change, slope, turn, bend, pairs] = self.sums;
        if pairs < MIN_PAIRS || change <= 0.0 || turn <= 0.0 {
            return None;
        }
        let slant = across / change;
        let rest = (slope - slant * across).max(0.0) / (2.0 * pairs - 1.0);
        let angle = 2.0 * (0.25 * (bend / turn).sqrt()).min(1.0).sqrt().asin();
        let seen = if angle > 1e-3 { angle.sin() / angle } else { 1.0 };
        Some((slant * seen, CAUTION * seen * (rest / change).sqrt()))
    }
}

impl ReadoutSearch {
    /// The part of a readout time of `readout_s` by which the rows are to be drawn: at most what the slopes over the rows followed the changes
    /// of the turn so far. What leans and stretches the picture without following them is not the rows' motion; and as a homography could do
    /// it as well, no comparison within a pair of frames sees it. Where the slopes say nothing yet, the part is what is `learned` of the
    /// readout time (0 to 1), and grows with the number of pairs in which the picture moved: rows of a picture at rest would only be moved by
    /// noise.
    pub fn readout_to_draw(&self, readout_s: f64, learned: f64) -> f64 {
        let carried = (self.moving / MIN_PAIRS).max(learned).min(1.0);
        self.readout().map_or(carried * readout_s, |(found, deviation)| {
            let most = readout_s.signum() * found + deviation / CAUTION;
            most.clamp(0.0, readout_s.abs()).copysign(readout_s)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn readout_and_sign_are_seen() {
        for readout in [0.8, 0.3, -0.6] {
            let (interval, mut search) = (1.0 / 30.0, ReadoutSearch::default());
            let path = |t: f64| [0.01 * (9.0 * t).sin(), 0.006 * (13.0 * t + 1.0).cos()];
            let speed = |t: f64| [0.09 * (9.0 * t).cos(), -0.078 * (13.0 * t + 1.0).sin()];
            for k in 0..90 {
                let (a, b) = (f64::from(k) * interval, f64::from(k + 1) * interval);
                let by = |f: &dyn Fn(f64) -> [f64; 2], c: usize| f(b)[c] - f(a)[c];
                let turn = [by(&path, 0), by(&path, 1)];
                let lean = [readout * interval * by(&speed, 0), readout * interval * by(&speed, 1)];
                search.add(turn, lean, interval, 1e-5);
            }
            let (found, deviation) = search.readout().unwrap();
            let (found, deviation) = (found / interval, deviation / interval);
            assert!((found - readout).abs() < 0.05 * readout.abs(), "{readout}: {found}");
            assert!(deviation < 0.1);
        }
    }

    #[test]
    fn rows_are_drawn_as_far_as_they_follow_the_turn() {
        let (interval, least) = (1.0 / 30.0, 1e-5);
        for (readout, believed, wanted) in
            [(0.8, 0.8, 0.8), (0.2, 0.8, 0.2), (0.0, 0.7, 0.0), (-0.6, -0.6, -0.6), (-0.6, 0.6, 0.0)]
        {
            let mut search = ReadoutSearch::default();
            assert_eq!(search.readout_to_draw(believed * interval, 0.0), 0.0, "nothing was seen");
            assert_eq!(search.readout_to_draw(believed * interval, 1.0), believed * interval, "nor need it be");
            for k in 0..90 {
                let turn = |k: i32| 0.01 * (0.3 * f64::from(k)).sin();
                let lean = readout * 0.5 * (turn(k + 1) - turn(k - 1)) + 1e-4 * (9.7 * f64::from(k)).sin();
                search.add([turn(k), 0.0], [lean, 0.0], interval, least);
            }
            let drawn = search.readout_to_draw(believed * interval, 0.0) / interval;
            assert!((drawn - wanted).abs() < 0.05, "{readout} {believed}: {drawn}");
        }
    }

    #[test]
    fn an_even_pan_is_drawn_by_what_is_believed() {
        let mut search = ReadoutSearch::default();
        for _ in 0..30 {
            search.add([0.01, 0.0], [0.0; 2], 1.0 / 30.0, 1e-3);
        }
        assert_eq!((search.readout(), search.readout_to_draw(0.02, 0.0)), (None, 0.02));
    }

    #[test]
    fn a_still_camera_says_nothing_and_its_rows_stay() {
        let mut search = ReadoutSearch::default();
        for k in 0..90 {
            let noise = 4e-4 * f64::from(k % 2);
            search.add([noise, 0.0], [noise, 0.0], 1.0 / 30.0, 1e-3);
        }
        assert_eq!((search.readout(), search.readout_to_draw(0.02, 0.0)), (None, 0.0));
    }
}
