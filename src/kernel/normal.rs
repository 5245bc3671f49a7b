//! Sums for normal equations of many small measurements of the same points: what each adds is a product of a few weights and a few
//! numbers of its own.
//!
//! A measurement m of ten points (eight of a curve, four for each of two moments, and two beside it) says something of
//! `sum_p w[p] x[p]`, where each point `x[p]` has four channels. Its normal matrix is
//! `w[p] w[q] A` for the block of points p and q, with one A (four by four, symmetric) for all of them. So it needs no more than the
//! ten numbers of A for each of the 55 pairs of points.

use super::{Level, dispatch};

/// Points.
pub const POINTS: usize = CURVE + 2;
/// How many of them, the first ones, are the curve's: as many for the one moment as for the other.
pub const CURVE: usize = 8;
/// Pairs of them, (p, q) with q <= p, p by p.
pub const PAIRS: usize = POINTS * (POINTS + 1) / 2;
/// Numbers that are summed side by side for each pair of points.
pub const WIDE: usize = 12;
/// Numbers that are summed side by side for each point.
pub const BROAD: usize = 16;
/// Measurements that are summed before the sums are touched.
const AT_ONCE: usize = 4;

/// Measurements: as many of each.
#[derive(Clone, Copy, Debug)]
pub struct Measurements<'a> {
    /// How much each counts.
    pub scale: &'a [f64],
    /// Weights of the points.
    pub weights: &'a [[f64; POINTS]],
    /// What is summed for each pair of points.
    pub paired: &'a [[f64; WIDE]],
    /// What is summed for each point.
    pub single: &'a [[f64; BROAD]],
}

/// The sums.
#[derive(Clone, Debug)]
pub struct Sums {
    /// Of `scale * weights[p] * weights[q] * paired`.
    pub paired: [[f64; WIDE]; PAIRS],
    /// Of `scale * weights[p] * single`.
    pub single: [[f64; BROAD]; POINTS],
}

impl Default for Sums {
    fn default() -> Self {
        Self { paired: [[0.0; WIDE]; PAIRS], single: [[0.0; BROAD]; POINTS] }
    }
}

/// Adds `measurements` to `sums`; as many as there are of whichever there is least.
pub fn add(level: Level, measurements: Measurements<'_>, sums: &mut Sums) {
    dispatch!(level, add_body(measurements: Measurements<'_>, sums: &mut Sums))
}

#[inline(always)]
fn add_body(measurements: Measurements<'_>, sums: &mut Sums) {
    let Measurements { scale, weights, paired, single } = measurements;
    let count = scale.len().min(weights.len()).min(paired.len()).min(single.len());
    let whole = count - count % AT_ONCE;
    for at in (0..whole).step_by(AT_ONCE) {
        some(&scale[at..], &weights[at..], &paired[at..], &single[at..], AT_ONCE, sums);
    }
    if whole < count {
        some(&scale[whole..], &weights[whole..], &paired[whole..], &single[whole..], count - whole, sums);
    }
}

/// Adds the first `count` measurements, at most [`AT_ONCE`].
#[inline(always)]
fn some(
    scale: &[f64],
    weights: &[[f64; POINTS]],
    paired: &[[f64; WIDE]],
    single: &[[f64; BROAD]],
    count: usize,
    sums: &mut Sums,
) {
    // what is missing counts nothing
    let last = count - 1;
    let weights: [&[f64; POINTS]; AT_ONCE] = std::array::from_fn(|m| &weights[m.min(last)]);
    let paired: [&[f64; WIDE]; AT_ONCE] = std::array::from_fn(|m| &paired[m.min(last)]);
    let single: [&[f64; BROAD]; AT_ONCE] = std::array::from_fn(|m| &single[m.min(last)]);
    let scale: [f64; AT_ONCE] = std::array::from_fn(|m| if m < count { scale[m] } else { 0.0 });
    let mut pair = 0;
    for p in 0..POINTS {
        let scaled: [f64; AT_ONCE] = std::array::from_fn(|m| scale[m] * weights[m][p]);
        mix(&scaled, &single, &mut sums.single[p]);
        for q in 0..=p {
            let scaled: [f64; AT_ONCE] = std::array::from_fn(|m| scaled[m] * weights[m][q]);
            mix(&scaled, &paired, &mut sums.paired[pair]);
            pair += 1;
        }
    }
}

#[inline(always)]
fn mix<const M: usize>(scale: &[f64; AT_ONCE], rows: &[&[f64; M]; AT_ONCE], sum: &mut [f64; M]) {
    for k in 0..M {
        sum[k] += (scale[0] * rows[0][k] + scale[1] * rows[1][k]) + (scale[2] * rows[2][k] + scale[3] * rows[3][k]);
    }
}

/// For each measurement, the sum of the points by its weights (four channels), and those by its `rates` of the curve's first and last
/// four points.
pub fn evaluate(
    level: Level,
    points: &[[f64; 4]; POINTS],
    weights: &[[f64; POINTS]],
    rates: &[[f64; CURVE]],
    predicted: &mut [[f64; WIDE]],
) {
    dispatch!(
        level,
        evaluate_body(
            points: &[[f64; 4]; POINTS],
            weights: &[[f64; POINTS]],
            rates: &[[f64; CURVE]],
            predicted: &mut [[f64; WIDE]],
        )
    )
}

#[inline(always)]
fn evaluate_body(
    points: &[[f64; 4]; POINTS],
    weights: &[[f64; POINTS]],
    rates: &[[f64; CURVE]],
    predicted: &mut [[f64; WIDE]],
) {
    for ((weights, rates), predicted) in weights.iter().zip(rates).zip(predicted) {
        let mut sums = [[0.0; 4]; 3];
        for p in 0..CURVE {
            let half = 1 + p / (CURVE / 2);
            for c in 0..4 {
                sums[0][c] += weights[p] * points[p][c];
                sums[half][c] += rates[p] * points[p][c];
            }
        }
        for p in CURVE..POINTS {
            for c in 0..4 {
                sums[0][c] += weights[p] * points[p][c];
            }
        }
        predicted.copy_from_slice(sums.as_flattened());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Congruential;

    fn numbers<const N: usize>(count: usize, seed: u64) -> Vec<[f64; N]> {
        let mut generator = Congruential::new(seed);
        let mut random = || generator.signed();
        (0..count).map(|_| std::array::from_fn(|_| random())).collect()
    }

    #[test]
    fn every_level_sums_the_same_and_what_the_definition_says() {
        for count in [0, 1, 3, 4, 5, 18] {
            let scale: Vec<f64> = numbers::<1>(count, 1).into_iter().flatten().collect();
            let (weights, paired, single) = (numbers(count, 2), numbers(count, 3), numbers(count, 4));
            let measurements = Measurements { scale: &scale, weights: &weights, paired: &paired, single: &single };
            let found: Vec<Sums> = Level::all()
                .map(|level| {
                    let mut sums = Sums::default();
                    add(level, measurements, &mut sums);
                    sums
                })
                .collect();
            assert!(found.windows(2).all(|pair| pair[0].paired == pair[1].paired && pair[0].single == pair[1].single));
            let mut pair = 0;
            for p in 0..POINTS {
                for k in 0..BROAD {
                    let wanted: f64 = (0..count).map(|m| scale[m] * weights[m][p] * single[m][k]).sum();
                    assert!((found[0].single[p][k] - wanted).abs() < 1e-12);
                }
                for q in 0..=p {
                    for k in 0..WIDE {
                        let wanted: f64 = (0..count).map(|m| scale[m] * weights[m][p] * weights[m][q] * paired[m][k]).sum();
                        assert!((found[0].paired[pair][k] - wanted).abs() < 1e-12);
                    }
                    pair += 1;
                }
            }
        }
    }

    #[test]
    fn every_level_evaluates_the_same_and_what_the_definition_says() {
        let (weights, rates) = (numbers::<POINTS>(7, 5), numbers::<CURVE>(7, 6));
        let points: [[f64; 4]; POINTS] = std::array::from_fn(|p| numbers(1, 70 + p as u64)[0]);
        for level in Level::all() {
            let mut predicted = vec![[9.0; WIDE]; 7];
            evaluate(level, &points, &weights, &rates, &mut predicted);
            for (m, predicted) in predicted.iter().enumerate() {
                for c in 0..4 {
                    let sum = |of: &[f64], p: std::ops::Range<usize>| p.map(|p| of[p] * points[p][c]).sum::<f64>();
                    let wanted = [sum(&weights[m], 0..POINTS), sum(&rates[m], 0..4), sum(&rates[m], 4..8)];
                    (0..3).for_each(|i| assert!((predicted[4 * i + c] - wanted[i]).abs() < 1e-12));
                }
            }
        }
    }
}
