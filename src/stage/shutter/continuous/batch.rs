//! The measurements of a pair of frames, side by side, those of the same control points together.
//!
//! A track measures the difference of two poses, `moved = derivative * (P(later) - P(sooner))`, and each pose is a weighted sum of four
//! control points; the flow's two bins at its row are two more. Most tracks share their ten points with many others; so they are sorted by them, and summed and evaluated run by
//! run ([`normal`]). What does not change from one round of weighing to the next is prepared once.

use super::filter::{Filter, SplinePoint};
use super::flow::{self, BINS};
use super::normal::G;
use crate::geometry::{PerChannel, Pose};
use crate::kernel::Level;
use crate::kernel::normal::{self, BROAD, CURVE, Measurements, POINTS, Sums, WIDE};

const _: () = assert!(4 * (1 + G) <= BROAD);
/// Bits of a key that say which measurement it is; the others say which control points.
const INDEX_BITS: u32 = 12;
/// Bits of each of its two points.
const POINT_BITS: u32 = 6;
/// Bits of the flow's first bin.
const BIN_BITS: u32 = 3;
const _: () = assert!(BINS <= 1 << BIN_BITS);
/// The key's points where the filter does not hold them.
const NOWHERE: u32 = (1 << (2 * POINT_BITS)) - 1;

/// The measurements. Nothing is allocated up to the number that room was made for.
#[derive(Debug)]
pub struct Batch {
    level: Level,
    /// Control points and number of each measurement, sorted.
    keys: Vec<u32>,
    /// By number: places of the two moments.
    places: Vec<[SplinePoint; 2]>,
    /// By number: where on the flow, the weights times the seconds between both moments.
    flows: Vec<flow::Row>,
    // the following in the order of the keys
    weights: Vec<[f64; POINTS]>,
    rates: Vec<[f64; CURVE]>,
    /// Products of the derivative's channels (the lower triangle, row by row), x and y together.
    products: Vec<[f64; WIDE]>,
    /// The derivative's channels times what was seen, then times each parameter's effect.
    single: Vec<[f64; BROAD]>,
    scale: Vec<f64>,
    predicted: Vec<[f64; WIDE]>,
}

/// What path and flow say of a measurement.
#[derive(Clone, Copy, Debug)]
pub struct Prediction {
    /// Difference of the poses and what the flow adds to it.
    pub change: Pose,
    /// Speeds at the sooner and the later moment, units / s.
    pub speeds: [Pose; 2],
}

impl Batch {
    /// No measurements, with room for `most` (at most 4096).
    pub fn new(most: usize, level: Level) -> Self {
        let most = most.min(1 << INDEX_BITS);
        Self {
            level,
            keys: Vec::with_capacity(most),
            places: Vec::with_capacity(most),
            flows: Vec::with_capacity(most),
            weights: Vec::with_capacity(most),
            rates: Vec::with_capacity(most),
            products: Vec::with_capacity(most),
            single: Vec::with_capacity(most),
            scale: Vec::with_capacity(most),
            predicted: Vec::with_capacity(most),
        }
    }

    /// Forgets all measurements.
    pub fn clear(&mut self) {
        self.keys.clear();
        self.places.clear();
        self.flows.clear();
    }

    /// Adds a measurement between two moments, the sooner first. To be followed by [`Batch::prepare`].
    pub fn push(&mut self, filter: &Filter, moments: [SplinePoint; 2], flow: flow::Row) {
        let points = match moments.map(|place| filter.offset(&place)) {
            [Some(sooner), Some(later)] => (sooner as u32) << POINT_BITS | later as u32,
            _ => NOWHERE,
        };
        self.keys.push((points << BIN_BITS | flow.bin as u32) << INDEX_BITS | self.places.len() as u32);
        self.places.push(moments);
        self.flows.push(flow);
    }

    /// Sorts the measurements and prepares what each round needs; `seen` gives for each number the derivative and the motion (x, y).
    pub fn prepare(&mut self, seen: impl Fn(usize) -> ([PerChannel; 2], [f64; 2])) {
        self.keys.sort_unstable();
        let count = self.keys.len();
        self.scale.clear();
        self.scale.resize(count, 0.0);
        self.predicted.clear();
        self.predicted.resize(count, [0.0; WIDE]);
        self.weights.clear();
        self.rates.clear();
        self.products.clear();
        self.single.clear();
        for &key in &self.keys {
            let number = number(key);
            let [sooner, later] = &self.places[number];
            let (mut weights, mut rates) = ([0.0; POINTS], [0.0; CURVE]);
            for i in 0..4 {
                (weights[i], weights[4 + i]) = (-sooner.weights[i], later.weights[i]);
                (rates[i], rates[4 + i]) = (sooner.rates[i], later.rates[i]);
            }
            weights[CURVE..].copy_from_slice(&self.flows[number].weights);
            self.weights.push(weights);
            self.rates.push(rates);
            let ([dx, dy], [x, y]) = seen(number);
            let (mut products, mut single, mut n) = ([0.0; WIDE], [0.0; BROAD], 0);
            for i in 0..4 {
                for j in 0..=i {
                    products[n] = dx[i] * dx[j] + dy[i] * dy[j];
                    n += 1;
                }
                single[i] = dx[i] * x + dy[i] * y;
            }
            self.products.push(products);
            self.single.push(single);
        }
    }

    /// Adds each measurement with its information (1 / pixels^2, by number) to what the filter has on trial.
    pub fn add_to(&mut self, filter: &mut Filter, information: impl Fn(usize) -> f64) {
        for (scale, &key) in self.scale.iter_mut().zip(&self.keys) {
            *scale = information(number(key));
        }
        let mut from = 0;
        for run in self.keys.chunk_by(|a, b| a >> INDEX_BITS == b >> INDEX_BITS) {
            let range = from..from + run.len();
            from = range.end;
            let Some(points) = points(run[0]) else { continue };
            let mut sums = Sums::default();
            let measurements = Measurements {
                scale: &self.scale[range.clone()],
                weights: &self.weights[range.clone()],
                paired: &self.products[range.clone()],
                single: &self.single[range],
            };
            normal::add(self.level, measurements, &mut sums);
            filter.add(points, &sums);
        }
    }

    /// Says how what the path says of measurement `index` (in the batch's order) depends on the parameters (x, y), to be added with the
    /// rest. `derivative` as when it was prepared.
    pub fn set_parameters(&mut self, index: usize, derivative: &[PerChannel; 2], by_parameter: &[[f64; 2]; G]) {
        let [dx, dy] = derivative;
        for (g, [x, y]) in by_parameter.iter().enumerate() {
            for c in 0..4 {
                self.single[index][4 * (1 + g) + c] = x * dx[c] + y * dy[c];
            }
        }
    }

    /// Asks the filter's path and flow what they say of each measurement.
    pub fn evaluate(&mut self, filter: &Filter) {
        let mut from = 0;
        for run in self.keys.chunk_by(|a, b| a >> INDEX_BITS == b >> INDEX_BITS) {
            let range = from..from + run.len();
            from = range.end;
            let Some(points) = points(run[0]) else { continue };
            let path = filter.points(points);
            let (weights, rates) = (&self.weights[range.clone()], &self.rates[range.clone()]);
            normal::evaluate(self.level, &path, weights, rates, &mut self.predicted[range]);
        }
    }

    /// How many measurements there are.
    pub fn len(&self) -> usize {
        self.keys.len()
    }

    /// Of measurement `index` in the batch's order: its number, and what the path said of it.
    #[inline]
    pub fn prediction(&self, index: usize) -> (usize, Prediction) {
        let predicted = &self.predicted[index];
        let pose = |i: usize| Pose::from_fn(|c| predicted[4 * i + c]);
        (number(self.keys[index]), Prediction { change: pose(0), speeds: [pose(1), pose(2)] })
    }

    /// Where on the flow measurement `number` lies.
    pub fn flow_row(&self, number: usize) -> &flow::Row {
        &self.flows[number]
    }

    /// As [`Batch::prediction`], of all in turn.
    pub fn predictions(&self) -> impl Iterator<Item = (usize, Prediction)> + Clone {
        (0..self.len()).map(|index| self.prediction(index))
    }
}

fn number(key: u32) -> usize {
    (key & ((1 << INDEX_BITS) - 1)) as usize
}

/// The first control points of both moments, counted from the filter's first, and the flow's first bin.
fn points(key: u32) -> Option<([usize; 2], usize)> {
    let (points, bin) = (key >> INDEX_BITS >> BIN_BITS, key >> INDEX_BITS & ((1 << BIN_BITS) - 1));
    let point = |at: u32| (at & ((1 << POINT_BITS) - 1)) as usize;
    (points != NOWHERE).then_some(([point(points >> POINT_BITS), point(points)], bin as usize))
}
