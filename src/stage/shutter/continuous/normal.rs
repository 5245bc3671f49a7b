//! Normal equations with a border: many unknowns of path and flow, and a few parameters (of the calibration: readout time, focal length, the lens's k1) that all see.
//!
//! ```text
//! [ A  C' ] [ x ]   [ r ]
//! [ C  K  ] [ g ] = [ s ]
//! ```
//!
//! A is symmetric; its lower triangle is stored. Nothing is allocated after `new`.

use crate::kernel::{Level, dense};

/// Unknowns at a time, at most.
pub const N: usize = FLOWS + 160;
/// How many of them, the first ones, are the flow's (`super::flow`) and never eliminated; the others are the path's.
pub const FLOWS: usize = 4 * super::flow::BINS;
/// Parameters of the calibration: readout time, logarithm of the focal length, the lens's k1.
pub const G: usize = 3;

/// The equations: an information matrix and its right-hand side.
#[derive(Clone, Debug)]
pub struct Normal {
    /// A, row-major, rows N apart.
    pub matrix: Box<[f64]>,
    /// r.
    pub right: [f64; N],
    /// C.
    pub cross: [[f64; N]; G],
    /// K.
    pub corner: [[f64; G]; G],
    /// s.
    pub corner_right: [f64; G],
    level: Level,
}

/// A solution and what of the factorization outlives it.
#[derive(Debug)]
pub struct Solution {
    /// Cholesky factor of A, lower, rows N apart.
    factor: Box<[f64]>,
    level: Level,
    /// L^-1 C' for the factor L, and how many unknowns there were.
    border: Box<[[f64; N]; G]>,
    solved: usize,
    /// x, with the parameters at their origin.
    pub path: Box<[f64; N]>,
    /// What the equations say of the parameters once the path is eliminated.
    pub marginal: Marginal,
}

/// Normal equations of the parameters alone.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Marginal {
    /// Information matrix.
    pub matrix: [[f64; G]; G],
    /// Right-hand side.
    pub right: [f64; G],
}

impl Marginal {
    /// Moves the origin of the parameters by `shift`.
    pub fn move_origin(&mut self, shift: [f64; G]) {
        for (right, row) in self.right.iter_mut().zip(&self.matrix) {
            *right -= row.iter().zip(shift).map(|(entry, shift)| entry * shift).sum::<f64>();
        }
    }
}

impl Normal {
    /// Equations that say nothing.
    pub fn new(level: Level) -> Self {
        Self {
            matrix: vec![0.0; N * N].into_boxed_slice(),
            right: [0.0; N],
            cross: [[0.0; N]; G],
            corner: [[0.0; G]; G],
            corner_right: [0.0; G],
            level,
        }
    }

    /// Takes over what `other` says of its first `n` unknowns and of the parameters.
    pub fn copy_from(&mut self, other: &Self, n: usize) {
        for i in 0..n {
            self.matrix[i * N..=i * N + i].copy_from_slice(&other.matrix[i * N..=i * N + i]);
        }
        self.right[..n].copy_from_slice(&other.right[..n]);
        for (to, from) in self.cross.iter_mut().zip(&other.cross) {
            to[..n].copy_from_slice(&from[..n]);
        }
        self.corner = other.corner;
        self.corner_right = other.corner_right;
    }

    /// Forgets whatever was solved of unknowns `from` .. `to`.
    pub fn clear(&mut self, from: usize, to: usize) {
        for i in from..to {
            self.matrix[i * N..(i + 1) * N].fill(0.0);
        }
        self.right[from..to].fill(0.0);
        self.cross.iter_mut().for_each(|cross| cross[from..to].fill(0.0));
    }

    /// Eliminates unknowns `from` .. `to` of `n` (Schur complement) and moves those behind them to where they were.
    pub fn eliminate(&mut self, from: usize, to: usize, n: usize) {
        for k in from..to {
            let pivot = self.matrix[k * N + k];
            if pivot > 0.0 {
                let column = self.column(k, n);
                self.subtract(&column, k, pivot, [[0, from], [k + 1, n]]);
            }
        }
        let m = &mut self.matrix;
        for i in to..n {
            m.copy_within(i * N..i * N + from, (i + from - to) * N);
            m.copy_within(i * N + to..i * N + i + 1, (i + from - to) * N + from);
        }
        self.right.copy_within(to..n, from);
        self.cross.iter_mut().for_each(|cross| cross.copy_within(to..n, from));
    }

    /// Unknown `k` of `n` goes on as `keep` times what it was, give or take a standard deviation whose square is `variance`.
    pub fn drift(&mut self, k: usize, keep: f64, variance: f64, n: usize) {
        // a new unknown x' with (x' - keep x)^2 / variance, and the old one eliminated
        let pivot = self.matrix[k * N + k] + keep * keep / variance;
        let mut column = self.column(k, n);
        self.subtract(&column, k, pivot, [[0, k], [k + 1, n]]);
        let share = keep / variance / pivot;
        column.iter_mut().for_each(|value| *value *= share);
        for (i, value) in column[..n].iter().enumerate().filter(|(i, _)| *i != k) {
            self.matrix[i.max(k) * N + i.min(k)] = *value;
        }
        self.matrix[k * N + k] = (1.0 - keep * share) / variance;
        self.right[k] *= share;
        self.cross.iter_mut().for_each(|cross| cross[k] *= share);
    }

    /// What ties unknown `k` to each of `n`.
    fn column(&self, k: usize, n: usize) -> [f64; N] {
        let mut column = [0.0; N];
        for (i, value) in column[..n].iter_mut().enumerate() {
            *value = self.matrix[i.max(k) * N + i.min(k)];
        }
        column
    }

    /// Takes from `rest` (two ranges of unknowns) and the parameters what eliminating unknown `k` takes.
    fn subtract(&mut self, column: &[f64; N], k: usize, pivot: f64, rest: [[usize; 2]; 2]) {
        // what stands in between is eliminated already, or is unknown k itself: whatever is done to it does no harm
        let solved = self.right[k] / pivot;
        for [from, to] in rest {
            dense::subtract(self.level, &mut self.matrix, column, pivot, [from, to], N);
            for (right, column) in self.right[from..to].iter_mut().zip(&column[from..to]) {
                *right -= column * solved;
            }
        }
        for g in 0..G {
            let share = self.cross[g][k] / pivot;
            if share == 0.0 {
                continue;
            }
            for [from, to] in rest {
                for (cross, column) in self.cross[g][from..to].iter_mut().zip(&column[from..to]) {
                    *cross -= share * column;
                }
            }
            self.corner_right[g] -= share * self.right[k];
            for (corner, cross) in self.corner[g].iter_mut().zip(&self.cross) {
                *corner -= share * cross[k];
            }
        }
    }

    /// Adds `offset` to the value of every unknown from `from` to `n`, in the four channels that take turns: what is solved of them stays as it
    /// is, of unknowns that are as much further on.
    pub fn offset(&mut self, from: usize, n: usize, offset: &[f64; 4]) {
        for i in 0..n {
            let row = &self.matrix[i * N..=i * N + i];
            let own = offset[i.wrapping_sub(from) % 4];
            // the lower triangle is also the upper one's, each entry but the diagonal's twice
            for (j, entry) in row.iter().enumerate().skip(from) {
                self.right[i] += entry * offset[(j - from) % 4];
            }
            if i >= from {
                for (j, entry) in row[..i].iter().enumerate() {
                    self.right[j] += entry * own;
                }
            }
        }
        for (cross, right) in self.cross.iter().zip(&mut self.corner_right) {
            *right += cross[from..n].iter().enumerate().map(|(i, cross)| cross * offset[i % 4]).sum::<f64>();
        }
    }

    /// Moves the origin of the parameters to `origin`: what was `origin` is 0 from now on.
    pub fn shift_parameters(&mut self, origin: [f64; G], n: usize) {
        for (g, origin) in origin.into_iter().enumerate() {
            for (right, cross) in self.right[..n].iter_mut().zip(&self.cross[g]) {
                *right -= cross * origin;
            }
            for (right, row) in self.corner_right.iter_mut().zip(&self.corner) {
                *right -= row[g] * origin;
            }
        }
    }
}

impl Solution {
    /// All zero.
    pub fn new(level: Level) -> Self {
        let factor = vec![0.0; N * N].into_boxed_slice();
        let (border, path) = (Box::new([[0.0; N]; G]), Box::new([0.0; N]));
        Self { factor, level, border, solved: 0, path, marginal: Marginal::default() }
    }

    /// Solves the first `n` unknowns. False where the equations have no solution; the solution is then what it was.
    pub fn solve(&mut self, normal: &Normal, n: usize) -> bool {
        if !dense::factor(self.level, &normal.matrix, &mut self.factor, n, N) {
            return false;
        }
        let mut x = normal.right;
        self.forward(&mut x[..n]);
        // border: w = L^-1 C', K - w'w is what the parameters have to themselves
        let mut w = normal.cross;
        let mut marginal = Marginal { matrix: normal.corner, right: normal.corner_right };
        for g in 0..G {
            // of what is known already nothing is asked
            if w[g][..n].iter().all(|cross| *cross == 0.0) {
                continue;
            }
            self.forward(&mut w[g][..n]);
            marginal.right[g] -= dot(&w[g][..n], &x[..n]);
        }
        for g in 0..G {
            for h in 0..G {
                marginal.matrix[g][h] -= dot(&w[g][..n], &w[h][..n]);
            }
        }
        self.backward(&mut x[..n]);
        let finite = marginal.right.iter().chain(marginal.matrix.as_flattened()).chain(&x[..n]).all(|value| value.is_finite());
        if finite {
            self.path[..n].copy_from_slice(&x[..n]);
            self.marginal = marginal;
            *self.border = w;
            self.solved = n;
        }
        finite
    }

    /// How the unknowns from `from` to the last change with each parameter.
    pub fn sensitivity(&self, from: usize) -> [[f64; N]; G] {
        std::array::from_fn(|g| {
            let mut x = [0.0; N];
            let rest = &mut x[from..self.solved];
            rest.copy_from_slice(&self.border[g][from..self.solved]);
            dense::backward(self.level, &self.factor[from * N + from..], rest, N);
            rest.iter_mut().for_each(|value| *value = -*value);
            x
        })
    }

    /// The variance of a linear function of the path from unknown `from` on, were the parameters known.
    pub fn variance(&self, from: usize, function: &mut [f64]) -> f64 {
        dense::forward(self.level, &self.factor[from * N + from..], function, N);
        dot(function, function)
    }

    fn forward(&self, x: &mut [f64]) {
        dense::forward(self.level, &self.factor, x, N);
    }

    fn backward(&self, x: &mut [f64]) {
        dense::backward(self.level, &self.factor, x, N);
    }
}

/// Sum of products.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Congruential;

    #[test]
    fn an_offset_moves_the_solution_and_nothing_else() {
        let (n, from, offset) = (24, 8, [0.7, -0.2, 0.1, 0.4]);
        let mut normal = system(n, 13);
        let (mut before, mut after) = (Solution::new(Level::SCALAR), Solution::new(Level::SCALAR));
        assert!(before.solve(&normal, n));
        normal.offset(from, n, &offset);
        assert!(after.solve(&normal, n));
        for i in 0..n {
            let moved = if i < from { 0.0 } else { offset[(i - from) % 4] };
            assert!((after.path[i] - before.path[i] - moved).abs() < 1e-9, "{i}");
        }
        for g in 0..G {
            assert!((after.marginal.right[g] - before.marginal.right[g]).abs() < 1e-8);
        }
    }

    #[test]
    fn the_sensitivity_is_what_a_shift_of_the_parameters_does() {
        let (n, from, shift) = (20, 12, [0.3, -0.1, 0.2]);
        let mut normal = system(n, 17);
        let (mut before, mut after) = (Solution::new(Level::SCALAR), Solution::new(Level::SCALAR));
        assert!(before.solve(&normal, n));
        let sensitivity = before.sensitivity(from);
        normal.shift_parameters(shift, n);
        assert!(after.solve(&normal, n));
        for i in from..n {
            let moved: f64 = (0..G).map(|g| shift[g] * sensitivity[g][i]).sum();
            assert!((after.path[i] - before.path[i] - moved).abs() < 1e-9, "{i}");
        }
    }

    /// A random positive definite system of n + G unknowns, as equations.
    fn system(n: usize, seed: u64) -> Normal {
        let mut generator = Congruential::new(seed);
        let mut random = || generator.signed();
        let mut normal = Normal::new(Level::SCALAR);
        for _ in 0..3 * n {
            let row: Vec<f64> = (0..n + G).map(|_| random()).collect();
            let value = random();
            for i in 0..n {
                for j in 0..=i {
                    normal.matrix[i * N + j] += row[i] * row[j];
                }
                normal.right[i] += row[i] * value;
            }
            for g in 0..G {
                for i in 0..n {
                    normal.cross[g][i] += row[n + g] * row[i];
                }
                for h in 0..G {
                    normal.corner[g][h] += row[n + g] * row[n + h];
                }
                normal.corner_right[g] += row[n + g] * value;
            }
        }
        normal
    }

    #[test]
    fn elimination_changes_nothing_of_what_is_left() {
        let (n, cut) = (20, 8);
        let mut normal = system(n, 3);
        let (mut whole, mut rest) = (Solution::new(Level::SCALAR), Solution::new(Level::SCALAR));
        assert!(whole.solve(&normal, n));
        normal.eliminate(0, cut, n);
        assert!(rest.solve(&normal, n - cut));
        for i in cut..n {
            assert!((whole.path[i] - rest.path[i - cut]).abs() < 1e-9);
        }
        for (a, b) in whole.marginal.matrix.as_flattened().iter().zip(rest.marginal.matrix.as_flattened()) {
            assert!((a - b).abs() < 1e-9 * a.abs().max(1.0));
        }
        for g in 0..G {
            assert!((whole.marginal.right[g] - rest.marginal.right[g]).abs() < 1e-9);
        }
    }

    #[test]
    fn elimination_in_the_middle_leaves_both_sides() {
        let (n, from, to) = (FLOWS + 20, FLOWS, FLOWS + 8);
        let mut normal = system(n, 7);
        let (mut whole, mut rest) = (Solution::new(Level::SCALAR), Solution::new(Level::SCALAR));
        assert!(whole.solve(&normal, n));
        normal.eliminate(from, to, n);
        assert!(rest.solve(&normal, n + from - to));
        for i in (0..from).chain(to..n) {
            let at = if i < from { i } else { i + from - to };
            assert!((whole.path[i] - rest.path[at]).abs() < 1e-9, "{i}");
        }
        for (a, b) in whole.marginal.matrix.as_flattened().iter().zip(rest.marginal.matrix.as_flattened()) {
            assert!((a - b).abs() < 1e-9 * a.abs().max(1.0));
        }
    }

    /// An unknown that goes on, against the same with its successor as an unknown of its own.
    #[test]
    fn what_drifts_is_an_unknown_of_its_own() {
        let (n, k, keep, variance) = (14, 5, 0.8, 0.3);
        let mut normal = system(n, 11);
        let mut both = normal.clone();
        both.matrix[n * N + n] = 1.0 / variance;
        both.matrix[n * N + k] = -keep / variance;
        both.matrix[k * N + k] += keep * keep / variance;
        normal.drift(k, keep, variance, n);
        let (mut wanted, mut found) = (Solution::new(Level::SCALAR), Solution::new(Level::SCALAR));
        assert!(wanted.solve(&both, n + 1) && found.solve(&normal, n));
        for i in 0..n {
            let successor = if i == k { n } else { i };
            assert!((wanted.path[successor] - found.path[i]).abs() < 1e-9, "{i}");
        }
        for (a, b) in wanted.marginal.matrix.as_flattened().iter().zip(found.marginal.matrix.as_flattened()) {
            assert!((a - b).abs() < 1e-9 * a.abs().max(1.0));
        }
        for g in 0..G {
            assert!((wanted.marginal.right[g] - found.marginal.right[g]).abs() < 1e-9);
        }
    }

    #[test]
    fn moving_the_origin_of_the_parameters_moves_their_marginal() {
        let n = 12;
        let mut normal = system(n, 5);
        let (mut before, mut after) = (Solution::new(Level::SCALAR), Solution::new(Level::SCALAR));
        assert!(before.solve(&normal, n));
        let shift = [0.7, -0.3, 0.2];
        normal.shift_parameters(shift, n);
        assert!(after.solve(&normal, n));
        before.marginal.move_origin(shift);
        for g in 0..G {
            assert!((after.marginal.right[g] - before.marginal.right[g]).abs() < 1e-9);
        }
    }
}
