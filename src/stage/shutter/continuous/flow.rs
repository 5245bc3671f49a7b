//! The flow: what of the picture's motion no turn explains, because the camera travels.
//!
//! Between two frames `interval` seconds apart, a point half-way on row y moves by the turn of the camera and by
//!
//! ```text
//! interval * B(x_mid) * phi(y)          phi(y) = sum_j h_j(y) phi_j
//! ```
//!
//! pixels, with h_j hat functions over the rows ([`BINS`] of them) and phi_j in the units of a pose per second. A camera that moves along
//! a plane (ground, wall) adds a flow of exactly this form to each row, whatever its direction.
//!
//! The phi_j are unknowns of the filter beside the path's control points. On one pair of frames a row's flow and the path's motion within
//! the frame look alike; they are told apart by time alone. The flow goes on from pair to pair (a stationary Gauss-Markov process:
//! `phi' = a phi + w`, `a = exp(-t / KEEP_S)`), while a changing turn moves the rows as fast as the shake and by zero on average.
//!
//! A constant added to phi and taken from the path's speed changes nothing that is seen, so something must say which layer of the
//! scene is at rest. Two things do:
//!
//! - The prior says that phi is nothing in most rows: each value has a variance of its own that follows the mean square of
//!   what was found of it (automatic relevance determination), but at least that of [`MIN_PX`].
//! - The rows that flow least hold the path: `sum_j h_j phi_j = 0`, with weights h_j that fall with the flow that was found and grow with the
//!   tracks ([`Flow::holds`]). Without it nothing holds the path where all rows flow (a near scene, a camera that walks towards it).
//!
//! So the layer that turns alone explain, the far one, holds the path, and nearer layers flow past it; where all layers are near, the
//! one with the most rows does. Motion of the camera never magnifies some rows and not others: a zoom that differs between rows is a
//! sure sign of travel, and where one is found the turns' variances are raised as well.

use super::normal::FLOWS;
use crate::geometry::{PerChannel, ZOOM};

/// Hat functions over the rows.
pub const BINS: usize = 6;
/// Standard deviation of what flows where nothing seems to, pixels / s: the turns' at the principal point, the others' at the picture's
/// side.
const MIN_PX: f64 = 0.1;
/// What is added to it at the beginning, where travel may be under way: to the zoom's, and to the turns' where the readout time is to
/// be found, for which flow must not be mistaken. Its variance fades with [`FIRST_S`].
const FIRST_ZOOM_PX: f64 = 5.0;
const FIRST_TURN_PX: f64 = 2.0;
const FIRST_S: f64 = 0.2;
/// Variance that is expected, of the mean square of what was found.
const MORE: f64 = 1.7;
/// Deviation of the turns that is expected at least, of the zoom's.
const BY_ZOOM: f64 = 0.7;
/// Seconds for which the flow keeps its direction.
const KEEP_S: f64 = 0.75;
/// Seconds in which the expected size follows what is found.
const LEARN_S: f64 = 0.25;
/// Flow up to which rows hold the path as those that do not flow, pixels / s.
const HOLDING_PX: f64 = 8.0;
/// Seconds in which the number of tracks by rows is followed.
const PRESENT_S: f64 = 1.0;
/// Standard deviation of what the rows that hold the path flow together, pixels / s.
const HELD_PX: f64 = 0.2;
/// Channels of a pose that turn the camera.
const TURNS: std::ops::Range<usize> = 0..3;

/// What is expected of the flow.
#[derive(Clone, Debug, Default)]
pub struct Flow {
    /// Variance of a flow of one pixel a second, in each channel's units.
    pixel: PerChannel,
    /// Variances that are added at first.
    first: PerChannel,
    /// Mean squares of what was found.
    squares: [f64; FLOWS],
    /// How many tracks there were of late, by bin; none before the first.
    present: Option<[f64; BINS]>,
}

impl Flow {
    /// Nothing flows, in pictures of focal length `focal` and half the width `half_width` (pixels). Says whether turns may be under way that
    /// could be mistaken for the rows' motion: where the readout time is not known.
    pub fn new(focal: f64, half_width: f64, readout_unknown: bool) -> Self {
        let [turn, other] = [focal, half_width].map(|size| 1.0 / (size * size));
        let pixel = [turn, turn, other, other];
        let turns_px = if readout_unknown { FIRST_TURN_PX } else { 0.0 };
        let first_px = [turns_px, turns_px, turns_px, FIRST_ZOOM_PX];
        Self {
            pixel,
            first: std::array::from_fn(|c| first_px[c] * first_px[c] * pixel[c]),
            squares: [0.0; FLOWS],
            present: None,
        }
    }

    /// Mean square of what was found of value `k`, (pixels / s)^2.
    fn mean_square(&self, k: usize) -> f64 {
        self.squares[k] / self.pixel[k % 4]
    }

    /// The variance that is expected of value `k` (of bin k / 4, channel k % 4).
    pub fn variance(&self, k: usize) -> f64 {
        let (zoom, channel) = (k - k % 4 + ZOOM, k % 4);
        let turns = channel < 2;
        let found =
            if turns { self.mean_square(k).max(BY_ZOOM * BY_ZOOM * self.mean_square(zoom)) } else { self.mean_square(k) };
        self.pixel[channel] * (MORE * found).max(MIN_PX * MIN_PX) + self.first[channel]
    }

    /// How much is kept of value `k` after `seconds`, and the variance of what is new.
    pub fn drift(&self, k: usize, seconds: f64) -> (f64, f64) {
        let keep = (-seconds / KEEP_S).exp();
        (keep, (1.0 - keep * keep) * self.variance(k))
    }

    /// How much each bin holds the path, 1 in all: by how many tracks were there of late, `present` of them now, `seconds` after the last
    /// time; and the less the more it flows. Tracks come and go, and were the hold to follow at once, the path would shake.
    pub fn holds(&mut self, present: &[f64; BINS], seconds: f64) -> [f64; BINS] {
        let news = 1.0 - (-seconds / PRESENT_S).exp();
        let kept = self.present.get_or_insert(*present);
        kept.iter_mut().zip(present).for_each(|(kept, now)| *kept += news * (now - *kept));
        let kept = *kept;
        let holds: [f64; BINS] = std::array::from_fn(|bin| {
            let flow: f64 = [0, 1, ZOOM].iter().map(|channel| self.mean_square(4 * bin + channel)).sum();
            kept[bin] / (flow + HOLDING_PX * HOLDING_PX)
        });
        let sum = holds.iter().sum::<f64>().max(1e-12);
        holds.map(|hold| hold / sum)
    }

    /// Of the channels that are held, information on what the bins that hold the path flow together, 1 / (units / s)^2.
    pub fn held(&self) -> impl Iterator<Item = (usize, f64)> {
        let pixel = self.pixel;
        TURNS.map(move |channel| (channel, 1.0 / (HELD_PX * HELD_PX * pixel[channel])))
    }

    /// Takes in what was found `seconds` after the last time.
    pub fn learn(&mut self, found: &[f64; FLOWS], seconds: f64) {
        let news = 1.0 - (-seconds / LEARN_S).exp();
        for (square, value) in self.squares.iter_mut().zip(found) {
            *square += news * (value * value - *square);
        }
        self.first.iter_mut().for_each(|variance| *variance *= (-seconds / FIRST_S).exp());
    }
}

/// A row as the flow sees it.
#[derive(Clone, Copy, Debug)]
pub struct Row {
    /// The first of the two bins that matter.
    pub bin: usize,
    /// Their weights: the hat functions times the seconds for which they flow.
    pub weights: [f64; 2],
}

impl Row {
    /// The row at the part `part` (0: top, to 1: bottom) of the picture, for `seconds`.
    pub fn new(part: f64, seconds: f64) -> Self {
        let place = (part * (BINS - 1) as f64).clamp(0.0, (BINS - 1) as f64);
        let bin = (place as usize).min(BINS - 2);
        let later = place - bin as f64;
        Self { bin, weights: [seconds * (1.0 - later), seconds * later] }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_lies_between_two_bins() {
        for part in [-0.1, 0.0, 0.31, 0.6, 1.0, 1.1] {
            let Row { bin, weights } = Row::new(part, 0.5);
            assert!(bin + 1 < BINS);
            assert!((weights[0] + weights[1] - 0.5).abs() < 1e-12 && weights.iter().all(|w| *w >= 0.0), "{part}");
            let place = (bin as f64 + 2.0 * weights[1]) / (BINS - 1) as f64;
            assert!((place - part.clamp(0.0, 1.0)).abs() < 1e-12, "{part}: {place}");
        }
    }

    #[test]
    fn expectation_follows_what_is_found_and_zoom_raises_the_turns() {
        let (focal, half) = (500.0, 320.0);
        let mut flow = Flow::new(focal, half, false);
        let deviation = |flow: &Flow, k: usize| (flow.variance(k) / flow.pixel[k % 4]).sqrt();
        assert!((deviation(&flow, 0) - MIN_PX).abs() < 1e-9);
        assert!(deviation(&flow, 3) > FIRST_ZOOM_PX);
        assert!(deviation(&Flow::new(focal, half, true), 1) > FIRST_TURN_PX);
        let mut found = [0.0; FLOWS];
        found[4 + ZOOM] = 60.0 / half;
        (0..200).for_each(|_| flow.learn(&found, 1.0 / 30.0));
        for (k, wanted) in [(0, MIN_PX), (3, MIN_PX), (4, MORE.sqrt() * BY_ZOOM * 60.0), (6, MIN_PX), (7, MORE.sqrt() * 60.0)] {
            assert!((deviation(&flow, k) - wanted).abs() < 1e-3 * wanted.max(1.0), "{k}: {}", deviation(&flow, k));
        }
        let (keep, variance) = flow.drift(7, 100.0);
        assert!(keep < 1e-9 && (variance / flow.variance(7) - 1.0).abs() < 1e-9);
    }

    #[test]
    fn the_rows_that_flow_least_and_are_seen_hold_the_path() {
        let (focal, half) = (500.0, 320.0);
        let mut flow = Flow::new(focal, half, false);
        assert_eq!(Flow::new(focal, half, false).holds(&[2.0; BINS], 0.03), [1.0 / BINS as f64; BINS]);
        assert_eq!(Flow::new(focal, half, false).holds(&[0.0; BINS], 0.03), [0.0; BINS]);
        let mut found = [0.0; FLOWS];
        found[4 * 5 + 1] = 80.0 / focal;
        found[4 * 4 + ZOOM] = 80.0 / half;
        (0..200).for_each(|_| flow.learn(&found, 1.0 / 30.0));
        let holds = flow.holds(&[1.0, 0.0, 2.0, 1.0, 1.0, 1.0], 0.03);
        assert!((holds.iter().sum::<f64>() - 1.0).abs() < 1e-12);
        assert_eq!(holds[1], 0.0);
        assert!((holds[2] / holds[0] - 2.0).abs() < 1e-9 && holds[3] == holds[0]);
        assert!(holds[4] < 0.02 * holds[0] && holds[5] < 0.02 * holds[0]);
        let next = flow.holds(&[0.0, 0.0, 2.0, 1.0, 1.0, 1.0], 0.03);
        assert!(next[0] > 0.9 * holds[0] && next[0] < holds[0], "tracks that are lost for one frame");
    }
}
