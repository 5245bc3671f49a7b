//! An information filter over the control points of the camera's path.
//!
//! The path is a uniform cubic B-spline, `P(t) = sum_i b(t / h - i) c_i`, with a control point of four parameters each `h` seconds.
//! The filter holds `A x = r` (normal equations, the information matrix A) for the flow ([`flow`]) and the control points that are still of use;
//! measurements and priors add to it, and points that nothing will refer to any more are eliminated by Schur complement. Given
//! the measurements' weights this is the exact linear estimate, the same as a Kalman filter's. Nothing is allocated after `new`.

use super::flow::{self, BINS, Flow};
use super::normal::{FLOWS, G, Marginal, N, Normal, Solution};
use crate::geometry::{PerChannel, Pose};
use crate::kernel::Level;
use crate::kernel::normal::{CURVE, POINTS, Sums};

/// Control points held at a time, at most.
pub const MAX_POINTS: usize = (N - FLOWS) / 4;

/// How uncertain motion is before it is measured.
#[derive(Clone, Copy, Debug)]
pub struct MotionPrior {
    /// Standard deviation of each parameter's acceleration averaged over 1/120 s, units / s^2.
    pub acceleration: PerChannel,
    /// Of its jerk, likewise, units / s^3: what tells shake from motion that repeats with every frame, which nothing can measure.
    pub jerk: PerChannel,
    /// Of its speed, units / s: draws the path to rest where nothing is seen for long.
    pub speed: PerChannel,
}

/// A moment as the spline sees it: the first of the four control points that matter, and their weights.
#[derive(Clone, Copy, Debug)]
pub struct SplinePoint {
    first: i64,
    pub(super) weights: [f64; 4],
    /// Their derivative by time, 1 / s.
    pub(super) rates: [f64; 4],
}

/// The filter.
#[derive(Debug)]
pub struct Filter {
    spacing_s: f64,
    prior: MotionPrior,
    /// Number of the first control point held.
    first: i64,
    points: usize,
    /// How many of them, the last ones, were added since the last [`Filter::accept`]; their prior can still be eased.
    fresh: usize,
    /// Factors on the information of each fresh point's prior: of acceleration and jerk.
    ease: [[PerChannel; 2]; MAX_POINTS],
    /// Factors on the deviations of acceleration and jerk that the prior allows: what this camera's motion is like.
    spread: [PerChannel; 2],
    /// Information without, and with the measurements that are being weighed.
    base: Box<Normal>,
    full: Box<Normal>,
    solution: Solution,
    /// How the flow is expected to go on.
    flow: Flow,
}

/// Standard deviations up to which the prior is Gauss's; beyond, its pull stays the same (Huber).
const HUBER: f64 = 1.5;
/// Seconds in which the prior's deviations follow what is found.
const LEARN_S: f64 = 2.0;
/// Mean square of the path's acceleration and jerk, in standard deviations of the prior, where the prior is right: less than 1, as
/// the path is drawn towards it; the most of one point that counts; and how far the deviations may go from the first ones.
const USUAL_SQUARE: f64 = 0.7;
const MAX_NEWS: f64 = 9.0;
const SPREAD: [f64; 2] = [0.7, 4.0];
/// Standard deviation to which the first control points are held: the path's origin is free to choose.
const PIN: f64 = 1e-4;

impl Filter {
    /// A filter without control points, for points `spacing_s` seconds apart.
    pub fn new(spacing_s: f64, prior: MotionPrior, level: Level) -> Self {
        Self {
            spacing_s,
            prior,
            first: 0,
            points: 0,
            fresh: 0,
            ease: [[[1.0; 4]; 2]; MAX_POINTS],
            spread: [[1.0; 4]; 2],
            base: Box::new(Normal::new(level)),
            full: Box::new(Normal::new(level)),
            solution: Solution::new(level),
            flow: Flow::default(),
        }
    }

    /// Forgets the flow; of one that begins, `flow` is expected.
    pub fn forget_flow(&mut self, flow: Flow) {
        self.flow = flow;
        let n = self.unknowns();
        self.base.clear(0, FLOWS);
        for i in FLOWS..n {
            self.base.matrix[i * N..i * N + FLOWS].fill(0.0);
        }
        for k in 0..FLOWS {
            self.base.matrix[k * N + k] = 1.0 / self.flow.variance(k);
            self.solution.path[k] = 0.0;
        }
    }

    /// The flow goes on for `seconds`.
    pub fn drift(&mut self, seconds: f64) {
        let n = self.unknowns();
        for k in 0..FLOWS {
            let (keep, variance) = self.flow.drift(k, seconds);
            self.base.drift(k, keep, variance, n);
        }
    }

    /// The bins that flow least, of those where tracks are `present`, hold the path: together they flow nothing.
    pub fn hold_flow(&mut self, present: &[f64; BINS], seconds: f64) {
        let holds = self.flow.holds(present, seconds);
        for (c, information) in self.flow.held() {
            for i in 0..BINS {
                for j in 0..=i {
                    self.base.matrix[(4 * i + c) * N + 4 * j + c] += holds[i] * holds[j] * information;
                }
            }
        }
    }

    /// What was found of the flow is what is expected of it from now on.
    pub fn learn_flow(&mut self, seconds: f64) {
        self.flow.learn(self.solution.path.first_chunk().expect("the flow comes first"), seconds);
    }

    /// The flow at a row, units / s.
    pub fn flow_at(&self, row: &flow::Row) -> Pose {
        Pose::from_fn(|c| (0..2).map(|i| row.weights[i] * self.solution.path[4 * (row.bin + i) + c]).sum())
    }

    /// Slope of the flow's turn (yaw, pitch) over the picture's height, units / s: least squares.
    pub fn flow_slope(&self) -> [f64; 2] {
        let row = |bin: usize| bin as f64 / (BINS - 1) as f64 - 0.5;
        let square: f64 = (0..BINS).map(|bin| row(bin) * row(bin)).sum();
        std::array::from_fn(|c| (0..BINS).map(|bin| row(bin) * self.solution.path[4 * bin + c]).sum::<f64>() / square)
    }

    /// Unknowns held.
    fn unknowns(&self) -> usize {
        FLOWS + 4 * self.points
    }

    /// Seconds from one control point to the next.
    pub fn spacing_s(&self) -> f64 {
        self.spacing_s
    }

    /// Restarts at `time_s`, at rest at `pose`, with points `spacing_s` apart; `pose` may be off by `off` in each parameter.
    pub fn restart(&mut self, time_s: f64, pose: Pose, spacing_s: f64) {
        // what the old points knew of the calibration is kept
        let n = self.unknowns();
        self.base.eliminate(FLOWS, n, n);
        self.spacing_s = spacing_s;
        self.first = self.locate(time_s).first;
        self.points = 0;
        self.fresh = 0;
        for i in 0..2 {
            self.push(pose);
            for (c, value) in pose.0.iter().enumerate() {
                let at = FLOWS + i * 4 + c;
                // the second is pinned to the first by the speed that the prior allows
                let pin = self.prior.speed[c] * spacing_s * if i == 0 { 10.0 } else { 1.0 };
                self.base.matrix[at * N + at] += 1.0 / (pin * pin);
                self.base.right[at] += value / (pin * pin);
            }
        }
    }

    /// Holds the path to `pose` at `time_s`, for certain.
    pub fn pin(&mut self, time_s: f64, pose: Pose) {
        let SplinePoint { first, weights, .. } = self.locate(time_s);
        let information = 1.0 / (PIN * PIN);
        for (i, wi) in weights.into_iter().enumerate() {
            for (c, value) in pose.0.iter().enumerate() {
                let row = FLOWS + 4 * (first - self.first + i as i64) as usize + c;
                for (j, wj) in weights[..=i].iter().enumerate() {
                    let column = FLOWS + 4 * (first - self.first + j as i64) as usize + c;
                    self.base.matrix[row * N + column] += wi * wj * information;
                }
                self.base.right[row] += wi * value * information;
            }
        }
    }

    /// Where a moment lies on the spline.
    #[inline]
    pub fn locate(&self, time_s: f64) -> SplinePoint {
        let s = time_s / self.spacing_s;
        let floor = s.floor();
        let u = s - floor;
        let (u2, u3) = (u * u, u * u * u);
        let weights = [
            (1.0 - 3.0 * u + 3.0 * u2 - u3) / 6.0,
            (4.0 - 6.0 * u2 + 3.0 * u3) / 6.0,
            (1.0 + 3.0 * u + 3.0 * u2 - 3.0 * u3) / 6.0,
            u3 / 6.0,
        ];
        let rate = 0.5 / self.spacing_s;
        let rates = [-rate * (1.0 - 2.0 * u + u2), rate * (3.0 * u2 - 4.0 * u), rate * (1.0 + 2.0 * u - 3.0 * u2), rate * u2];
        SplinePoint { first: floor as i64 - 1, weights, rates }
    }

    /// Adds control points until `time_s` can be evaluated, each with its prior. False where that would be too many: then the
    /// filter must restart.
    pub fn extend_to(&mut self, time_s: f64) -> bool {
        let last = self.locate(time_s).first + 3;
        if last - self.first >= MAX_POINTS as i64 || self.points < 2 {
            return false;
        }
        while self.first + (self.points as i64) <= last {
            self.push_with_prior();
        }
        true
    }

    /// The path at a moment between the first and last control point.
    #[inline]
    pub fn pose(&self, time_s: f64) -> Pose {
        let SplinePoint { first, weights, .. } = self.locate(time_s);
        let mut pose = Pose::default();
        for (i, weight) in weights.into_iter().enumerate() {
            let point = ((first + i as i64 - self.first).max(0) as usize).min(self.points.saturating_sub(1));
            for (c, value) in pose.0.iter_mut().enumerate() {
                *value += weight * self.solution.path[FLOWS + 4 * point + c];
            }
        }
        pose
    }

    fn push(&mut self, pose: Pose) {
        let n = self.unknowns();
        self.base.clear(n, n + 4);
        self.solution.path[n..n + 4].copy_from_slice(&pose.0);
        self.points += 1;
    }

    /// Adds a point that continues the path straight on, as uncertain as the prior says.
    fn push_with_prior(&mut self) {
        let n = self.unknowns();
        let mean = &self.solution.path;
        self.push(Pose::from_fn(|c| 2.0 * mean[n - 4 + c] - mean[n - 8 + c]));
        if self.fresh < MAX_POINTS {
            self.ease[self.fresh] = [[1.0; 4]; 2];
            self.fresh += 1;
        }
    }

    /// The prior's terms at the point of number `point`: unknowns' distance from each other and weights of the sum that should be
    /// 0, and the standard deviation of that sum.
    fn prior_terms(&self, point: usize, c: usize) -> [([f64; 4], f64); 3] {
        let h = self.spacing_s;
        // averaged over h, white noise has a variance that falls as 1 / h
        let spread = (1.0 / (120.0 * h)).sqrt();
        let [acceleration, jerk] = [self.prior.acceleration[c] * self.spread[0][c], self.prior.jerk[c] * self.spread[1][c]];
        let bend = acceleration * h * h * spread;
        let twist = if point >= 3 { jerk * h * h * h * spread } else { f64::INFINITY };
        let step = self.prior.speed[c] * h * spread;
        [([0.0, 1.0, -2.0, 1.0], bend), ([-1.0, 3.0, -3.0, 1.0], twist), ([0.0, 0.0, -1.0, 1.0], step)]
    }

    /// Adds the prior of the fresh points to what is on trial.
    fn add_prior(&mut self) {
        for i in 0..self.fresh {
            let point = self.points - self.fresh + i;
            for c in 0..4 {
                for (kind, (weights, deviation)) in self.prior_terms(point, c).into_iter().enumerate() {
                    let ease = if kind < 2 { self.ease[i][kind][c] } else { 1.0 };
                    let information = ease / (deviation * deviation);
                    if information == 0.0 {
                        continue;
                    }
                    for (p, wp) in weights.into_iter().enumerate().filter(|(_, w)| *w != 0.0) {
                        let row = FLOWS + 4 * (point + p - 3) + c;
                        for (q, wq) in weights[..=p].iter().enumerate().filter(|(_, w)| **w != 0.0) {
                            self.full.matrix[row * N + FLOWS + 4 * (point + q - 3) + c] += wp * wq * information;
                        }
                    }
                }
            }
        }
    }

    /// Eases the prior where the path that was found bends more than it expected (Huber's weights), so that a knock is
    /// followed while a quiet hand stays quiet.
    pub fn ease_prior(&mut self) {
        for i in 0..self.fresh {
            for c in 0..4 {
                for (kind, z) in self.bent(i, c).into_iter().enumerate() {
                    self.ease[i][kind][c] = z.map_or(1.0, |z| (HUBER / z.abs()).min(1.0));
                }
            }
        }
    }

    /// Acceleration and jerk of the path at the fresh point `i`, in standard deviations of the prior; none where it has none.
    fn bent(&self, i: usize, c: usize) -> [Option<f64>; 2] {
        let point = self.points - self.fresh + i;
        let [bend, twist, _] = self.prior_terms(point, c);
        [bend, twist].map(|(weights, deviation)| {
            let sum = |p: usize| weights[p] * self.solution.path[FLOWS + 4 * (point + p - 3) + c];
            let terms = (0..4).filter(|p| weights[*p] != 0.0).map(sum);
            (deviation.is_finite()).then(|| terms.sum::<f64>() / deviation)
        })
    }

    /// Learns how this camera moves from the path that was found, `seconds` after the last time: a vehicle's is rougher than a
    /// hand's.
    pub fn learn_prior(&mut self, seconds: f64) {
        let news = 1.0 - (-seconds / LEARN_S).exp();
        for kind in 0..2 {
            for c in 0..4 {
                let squares = (0..self.fresh).filter_map(|i| self.bent(i, c)[kind]).map(|z| (z * z).min(MAX_NEWS));
                let (sum, count) = squares.fold((0.0, 0u32), |(sum, count), square| (sum + square, count + 1));
                if count > 0 {
                    let off = sum / f64::from(count) / USUAL_SQUARE - 1.0;
                    self.spread[kind][c] = (self.spread[kind][c] * (0.5 * news * off).exp()).clamp(SPREAD[0], SPREAD[1]);
                }
            }
        }
    }

    /// Where among the control points held those of a moment begin; `None` where they are not held.
    #[inline]
    pub fn offset(&self, place: &SplinePoint) -> Option<usize> {
        let held = place.first >= self.first && place.first + 4 <= self.first + self.points as i64;
        held.then(|| (place.first - self.first) as usize)
    }

    /// The path's control points at two moments, four from each offset on, and the flow's two from `bin` on.
    pub fn points(&self, (offsets, bin): ([usize; 2], usize)) -> [[f64; 4]; POINTS] {
        std::array::from_fn(|k| std::array::from_fn(|c| self.solution.path[unknown(offsets, bin, k) + c]))
    }

    /// Starts weighing: measurements added from now on are on trial, and those added since the last start are forgotten.
    pub fn start_trial(&mut self) {
        self.full.copy_from(&self.base, self.unknowns());
        self.add_prior();
    }

    /// Adds measurements of the same control points, four from each offset on, and of the flow's two bins from `bin` on, on trial.
    pub fn add(&mut self, (offsets, bin): ([usize; 2], usize), sums: &Sums) {
        let mut pairs = sums.paired.iter();
        for p in 0..POINTS {
            let to = unknown(offsets, bin, p);
            for c in 0..4 {
                self.full.right[to + c] += sums.single[p][c];
                for g in 0..G {
                    self.full.cross[g][to + c] += sums.single[p][4 * (1 + g) + c];
                }
            }
            for (q, pair) in (0..=p).zip(&mut pairs) {
                let other = unknown(offsets, bin, q);
                let (row, column) = (to.max(other), to.min(other));
                // a point of both moments meets itself in both orders
                let times = if p != q && row == column { 2.0 } else { 1.0 };
                let [a, b, c, d, e, f, g, h, i, j, ..] = pair.map(|value| times * value);
                let lines = self.full.matrix[row * N + column..].chunks_mut(N);
                for (line, news) in lines.zip([[a, b, d, g], [b, c, e, h], [d, e, f, i], [g, h, i, j]]) {
                    let entries = line.first_chunk_mut::<4>().expect("rows are longer");
                    (0..4).for_each(|c| entries[c] += news[c]);
                }
            }
        }
    }

    /// Adds what the measurements say of the calibration itself, on trial.
    pub fn add_calibration(&mut self, corner: [[f64; G]; G], right: [f64; G]) {
        for g in 0..G {
            for h in 0..G {
                self.full.corner[g][h] += corner[g][h];
            }
            self.full.corner_right[g] += right[g];
        }
    }

    /// Solves for the path with what is on trial. False where the equations have no solution; the path is then what it was.
    pub fn solve(&mut self) -> bool {
        self.solution.solve(&self.full, self.unknowns())
    }

    /// Standard deviations of the difference of the poses at two moments, after [`Filter::solve`].
    pub fn deviation(&self, sooner_s: f64, later_s: f64) -> PerChannel {
        let n = self.unknowns();
        let moments = [(self.locate(sooner_s), -1.0), (self.locate(later_s), 1.0)];
        let from = FLOWS + 4 * self.held_point(moments[0].0.first.min(moments[1].0.first));
        std::array::from_fn(|c| {
            let mut function = [0.0; N];
            for (SplinePoint { first, weights, .. }, sign) in &moments {
                for (i, weight) in weights.iter().enumerate() {
                    function[FLOWS + 4 * self.held_point(first + i as i64) + c] += sign * weight;
                }
            }
            self.solution.variance(from, &mut function[from..n]).sqrt()
        })
    }

    /// What the equations say of the calibration once the path is eliminated, after [`Filter::solve`].
    pub fn marginal(&self) -> Marginal {
        self.solution.marginal
    }

    /// How the pose at a moment depends on the calibration, after [`Filter::solve`] and before [`Filter::accept`].
    pub fn sensitivity(&self, time_s: f64) -> [PerChannel; G] {
        let SplinePoint { first, weights, .. } = self.locate(time_s);
        let points: [usize; 4] = std::array::from_fn(|i| FLOWS + 4 * self.held_point(first + i as i64));
        self.solution
            .sensitivity(points[0])
            .map(|x| std::array::from_fn(|c| points.iter().zip(weights).map(|(point, weight)| weight * x[point + c]).sum()))
    }

    /// Moves the calibration's origin by `shift` and the whole path by `offset`. To follow [`Filter::accept`].
    pub fn move_calibration(&mut self, shift: [f64; G], offset: &Pose) {
        let n = self.unknowns();
        self.base.shift_parameters(shift, n);
        if offset.is_finite() {
            self.base.offset(FLOWS, n, &offset.0);
        }
    }

    /// Where among the control points held point `number` is, or the nearest to it.
    fn held_point(&self, number: i64) -> usize {
        (number - self.first).clamp(0, self.points as i64 - 1) as usize
    }

    /// Forgets what was measured of the calibration.
    pub fn forget_calibration(&mut self) {
        self.base.corner = [[0.0; G]; G];
        self.base.corner_right = [0.0; G];
        self.base.cross = [[0.0; N]; G];
    }

    /// Accepts what is on trial, and eliminates the control points that no moment from `time_s` on refers to.
    pub fn accept(&mut self, time_s: f64) {
        let n = self.unknowns();
        self.base.copy_from(&self.full, n);
        self.fresh = 0;
        let keep_from = (self.locate(time_s).first - self.first).clamp(0, self.points as i64 - 3) as usize;
        if keep_from == 0 {
            return;
        }
        let cut = FLOWS + 4 * keep_from;
        self.base.eliminate(FLOWS, cut, n);
        self.solution.path.copy_within(cut..n, FLOWS);
        self.points -= keep_from;
        self.first += keep_from as i64;
    }
}

/// The first unknown of point `k` of a measurement's: two moments' eight, then the flow's.
#[inline(always)]
fn unknown(offsets: [usize; 2], bin: usize, k: usize) -> usize {
    if k < CURVE { FLOWS + 4 * (offsets[k / 4] + k % 4) } else { 4 * (bin + k - CURVE) }
}

#[cfg(test)]
mod tests {
    use super::super::batch::Batch;
    use super::*;
    use crate::random::Congruential;

    /// Measurements one by one, each as two rows of the equations, against what the batch adds of all of them.
    #[test]
    fn a_batch_adds_what_its_measurements_say_one_by_one() {
        let mut generator = Congruential::new(3);
        let mut random = || generator.signed();
        let prior = MotionPrior { acceleration: [1.0; 4], jerk: [9.0; 4], speed: [1.0; 4] };
        let mut filter = Filter::new(0.01, prior, Level::detected());
        filter.restart(1.0, Pose::default(), 0.01);
        assert!(filter.extend_to(1.12));
        filter.start_trial();
        let n = filter.unknowns();
        filter.solution.path[..n].iter_mut().for_each(|value| *value = random());
        // moments far apart, near each other (points of both), in the same stretch, and outside of what is held
        let moments = |i: usize, random: &mut dyn FnMut() -> f64| {
            let sooner = 1.03 + 0.02 * random();
            [[sooner, sooner + 0.05], [sooner, sooner + 0.013], [sooner, sooner + 0.001], [sooner, 3.0]][i % 4]
        };
        let mut batch = Batch::new(100, Level::detected());
        let mut wanted = filter.full.clone();
        let mut seen = Vec::new();
        for i in 0..37 {
            let places = moments(i, &mut random).map(|time| filter.locate(time));
            let derivative: [PerChannel; 2] = std::array::from_fn(|_| std::array::from_fn(|_| random()));
            let value = [random(), random()];
            let by_parameter: [[f64; 2]; G] = std::array::from_fn(|_| [random(), random()]);
            let row = flow::Row::new(0.5 + 0.7 * random(), 1.0 / 30.0);
            batch.push(&filter, places, row);
            seen.push((derivative, value, by_parameter, places, row));
        }
        let information = |i: usize| 0.1 + i as f64;
        batch.prepare(|i| (seen[i].0, seen[i].1));
        for index in 0..batch.len() {
            let (i, _) = batch.prediction(index);
            batch.set_parameters(index, &seen[i].0, &seen[i].2);
        }
        batch.add_to(&mut filter, information);
        batch.evaluate(&filter);
        for (i, prediction) in batch.predictions() {
            let (derivative, value, by_parameter, places, row) = &seen[i];
            if i % 4 == 3 {
                assert_eq!(prediction.change, Pose::default());
                continue;
            }
            let (mut difference, mut speeds) = ([0.0; 4], [[0.0; 4]; 2]);
            let mut rows = [[0.0; N]; 2];
            for (moment, (place, sign)) in places.iter().zip([-1.0, 1.0]).enumerate() {
                for k in 0..4 {
                    let at = FLOWS + 4 * ((place.first - filter.first) as usize + k);
                    for c in 0..4 {
                        difference[c] += sign * place.weights[k] * filter.solution.path[at + c];
                        speeds[moment][c] += place.rates[k] * filter.solution.path[at + c];
                        (0..2).for_each(|axis| rows[axis][at + c] += sign * place.weights[k] * derivative[axis][c]);
                    }
                }
            }
            let mut flowed = [0.0; 4];
            for (i, weight) in row.weights.iter().enumerate() {
                for c in 0..4 {
                    let at = 4 * (row.bin + i) + c;
                    flowed[c] += weight * filter.solution.path[at];
                    (0..2).for_each(|axis| rows[axis][at] += weight * derivative[axis][c]);
                }
            }
            for c in 0..4 {
                assert!((prediction.change[c] - difference[c] - flowed[c]).abs() < 1e-12);
                (0..2).for_each(|m| assert!((prediction.speeds[m][c] - speeds[m][c]).abs() < 1e-9));
            }
            for (axis, row) in rows.iter().enumerate() {
                for p in 0..n {
                    for q in 0..=p {
                        wanted.matrix[p * N + q] += information(i) * row[p] * row[q];
                    }
                    wanted.right[p] += information(i) * row[p] * value[axis];
                    for g in 0..G {
                        wanted.cross[g][p] += information(i) * row[p] * by_parameter[g][axis];
                    }
                }
            }
        }
        for p in 0..n {
            for q in 0..=p {
                let (a, b) = (filter.full.matrix[p * N + q], wanted.matrix[p * N + q]);
                assert!((a - b).abs() < 1e-9 * a.abs().max(1.0), "{p} {q}: {a} for {b}");
            }
            assert!((filter.full.right[p] - wanted.right[p]).abs() < 1e-9);
            (0..G).for_each(|g| assert!((filter.full.cross[g][p] - wanted.cross[g][p]).abs() < 1e-9));
        }
    }
}
