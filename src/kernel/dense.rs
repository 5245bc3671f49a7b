//! Symmetric matrices whose lower triangle is stored row by row, rows [`stride`](factor) numbers apart.
//!
//! Sums are taken in eight lanes, so that the compiler may use wide registers; every level adds in the same order.

use super::{Level, dispatch};

/// Rows of a matrix that is factored, at most.
pub const MAX: usize = 192;
/// Columns that are eliminated at a time.
const AT_ONCE: usize = 4;

/// Lower Cholesky factor of the leading `n` x `n` block, with rows as far apart; false where it is not positive definite.
///
/// # Panics
/// Where a slice is shorter than `n` rows, or there are more than [`MAX`].
pub fn factor(level: Level, matrix: &[f64], factor: &mut [f64], n: usize, stride: usize) -> bool {
    dispatch!(level, factor_body(matrix: &[f64], factor: &mut [f64], n: usize, stride: usize) -> bool)
}

#[inline(always)]
fn factor_body(matrix: &[f64], factor: &mut [f64], n: usize, stride: usize) -> bool {
    for i in 0..n {
        factor[i * stride..=i * stride + i].copy_from_slice(&matrix[i * stride..=i * stride + i]);
    }
    // column by column: what is left of the rows below never waits for a sum, as it would row by row; and several columns at a time, so that
    // each of those rows is read and written once for all of them
    let mut columns = [[0.0; MAX]; AT_ONCE];
    for from in (0..n).step_by(AT_ONCE) {
        let next = (from + AT_ONCE).min(n);
        let Some(scales) = factor_block(factor, from, next, stride) else { return false };
        if next < n {
            finish_columns(factor, &mut columns, &scales, [from, n], stride);
        }
        for i in next..n {
            let shares: [f64; AT_ONCE] = std::array::from_fn(|c| columns[c][i]);
            if shares != [0.0; AT_ONCE] {
                let [a, b, c, d] = columns.each_ref().map(|column| &column[next..=i]);
                let row = &mut factor[i * stride + next..=i * stride + i];
                for ((((entry, a), b), c), d) in row.iter_mut().zip(a).zip(b).zip(c).zip(d) {
                    *entry = *entry - shares[0] * a - shares[1] * b - shares[2] * c - shares[3] * d;
                }
            }
        }
    }
    true
}

/// Factors the block of rows and columns `from` to `next` on the diagonal, at most [`AT_ONCE`] of them. Gives the inverses of its diagonal; none
/// where it is not positive definite.
#[inline(always)]
fn factor_block(factor: &mut [f64], from: usize, next: usize, stride: usize) -> Option<[f64; AT_ONCE]> {
    let mut scales = [0.0; AT_ONCE];
    for k in from..next {
        let pivot = factor[k * stride + k];
        if !(pivot > 0.0 && pivot.is_finite()) {
            return None;
        }
        let root = pivot.sqrt();
        factor[k * stride + k] = root;
        scales[k - from] = 1.0 / root;
        for i in k + 1..next {
            factor[i * stride + k] *= scales[k - from];
            for j in k + 1..=i {
                factor[i * stride + j] -= factor[i * stride + k] * factor[j * stride + k];
            }
        }
    }
    Some(scales)
}

/// The columns `from` and those after it, [`AT_ONCE`] of them, in the rows below their block and above `n`; a copy is left in `columns`.
#[inline(always)]
fn finish_columns(
    factor: &mut [f64],
    columns: &mut [[f64; MAX]; AT_ONCE],
    scales: &[f64; AT_ONCE],
    [from, n]: [usize; 2],
    stride: usize,
) {
    let block: [[f64; AT_ONCE]; AT_ONCE] =
        std::array::from_fn(|i| std::array::from_fn(|j| factor[(from + i) * stride + from + j]));
    let [a, b, c, d] = columns;
    for i in from + AT_ONCE..n {
        let row: &mut [f64; AT_ONCE] = (&mut factor[i * stride + from..][..AT_ONCE]).try_into().expect("as many");
        row[0] *= scales[0];
        row[1] = (row[1] - row[0] * block[1][0]) * scales[1];
        row[2] = (row[2] - row[0] * block[2][0] - row[1] * block[2][1]) * scales[2];
        row[3] = (row[3] - row[0] * block[3][0] - row[1] * block[3][1] - row[2] * block[3][2]) * scales[3];
        (a[i], b[i], c[i], d[i]) = (row[0], row[1], row[2], row[3]);
    }
}

/// Solves `L y = x` for the factor L; x becomes y.
///
/// # Panics
/// Where `factor` has fewer rows than `x` has numbers.
pub fn forward(level: Level, factor: &[f64], x: &mut [f64], stride: usize) {
    dispatch!(level, forward_body(factor: &[f64], x: &mut [f64], stride: usize))
}

#[inline(always)]
fn forward_body(factor: &[f64], x: &mut [f64], stride: usize) {
    for i in 0..x.len() {
        let row = &factor[i * stride..=i * stride + i];
        x[i] = (x[i] - dot(&row[..i], &x[..i])) / row[i];
    }
}

/// Solves `L' y = x` for the factor L; x becomes y.
///
/// # Panics
/// Where `factor` has fewer rows than `x` has numbers.
pub fn backward(level: Level, factor: &[f64], x: &mut [f64], stride: usize) {
    dispatch!(level, backward_body(factor: &[f64], x: &mut [f64], stride: usize))
}

#[inline(always)]
fn backward_body(factor: &[f64], x: &mut [f64], stride: usize) {
    for i in (0..x.len()).rev() {
        let row = &factor[i * stride..=i * stride + i];
        x[i] /= row[i];
        let value = x[i];
        for (x, factor) in x[..i].iter_mut().zip(row) {
            *x -= factor * value;
        }
    }
}

/// Takes `column[i] * column[j] / pivot` from entry (i, j), of the rows `from` to `to`.
///
/// # Panics
/// Where a slice is shorter than `to` rows.
pub fn subtract(level: Level, matrix: &mut [f64], column: &[f64], pivot: f64, rows: [usize; 2], stride: usize) {
    dispatch!(level, subtract_body(matrix: &mut [f64], column: &[f64], pivot: f64, rows: [usize; 2], stride: usize))
}

#[inline(always)]
fn subtract_body(matrix: &mut [f64], column: &[f64], pivot: f64, [from, to]: [usize; 2], stride: usize) {
    for i in from..to {
        let share = column[i] / pivot;
        if share != 0.0 {
            for (entry, other) in matrix[i * stride..=i * stride + i].iter_mut().zip(&column[..=i]) {
                *entry -= share * other;
            }
        }
    }
}

/// Sum of products.
#[inline(always)]
fn dot(a: &[f64], b: &[f64]) -> f64 {
    const LANES: usize = 8;
    let mut lanes = [0.0; LANES];
    let (whole_a, whole_b) = (a.chunks_exact(LANES), b.chunks_exact(LANES));
    let tail: f64 = whole_a.remainder().iter().zip(whole_b.remainder()).map(|(a, b)| a * b).sum();
    for (a, b) in whole_a.zip(whole_b) {
        for i in 0..LANES {
            lanes[i] += a[i] * b[i];
        }
    }
    let four: [f64; 4] = std::array::from_fn(|i| lanes[i] + lanes[4 + i]);
    (four[0] + four[2]) + (four[1] + four[3]) + tail
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Congruential;

    /// Numbers between -1 and 1.
    fn numbers(count: usize, seed: u64) -> Vec<f64> {
        let mut generator = Congruential::new(seed);
        let mut random = || generator.signed();
        (0..count).map(|_| random()).collect()
    }

    /// `n` rows of a positive definite matrix, `stride` apart.
    fn definite(n: usize, stride: usize) -> Vec<f64> {
        let parts: Vec<Vec<f64>> = (0..2 * n).map(|k| numbers(n, 1 + k as u64)).collect();
        let mut matrix = vec![f64::NAN; n * stride];
        for i in 0..n {
            for j in 0..=i {
                matrix[i * stride + j] =
                    parts.iter().map(|part| part[i] * part[j]).sum::<f64>() + if i == j { 0.1 } else { 0.0 };
            }
        }
        matrix
    }

    #[test]
    fn the_factor_solves_and_every_level_says_the_same() {
        for n in [1, 2, 7, 8, 9, 23, 64] {
            let stride = n + 3;
            let matrix = definite(n, stride);
            let right = numbers(n, 99);
            let found: Vec<Vec<u64>> = Level::all()
                .map(|level| {
                    let mut lower = vec![0.0; n * stride];
                    assert!(factor(level, &matrix, &mut lower, n, stride));
                    let mut x = right.clone();
                    forward(level, &lower, &mut x, stride);
                    backward(level, &lower, &mut x, stride);
                    for i in 0..n {
                        let entry = |j: usize| matrix[i.max(j) * stride + i.min(j)];
                        let back: f64 = (0..n).map(|j| entry(j) * x[j]).sum();
                        assert!((back - right[i]).abs() < 1e-8, "{n}: row {i}");
                    }
                    x.iter().map(|x| x.to_bits()).collect()
                })
                .collect();
            assert!(found.windows(2).all(|pair| pair[0] == pair[1]));
        }
        assert!(!factor(Level::best(), &[1.0, 0.0, 2.0, 1.0], &mut [0.0; 4], 2, 2));
        assert!(!factor(Level::best(), &[f64::NAN], &mut [0.0], 1, 1));
    }

    #[test]
    fn products_are_taken_from_the_rows_that_are_named() {
        let (n, stride) = (11, 13);
        let (matrix, column) = (definite(n, stride), numbers(n, 5));
        for level in Level::all() {
            let mut rest = matrix.clone();
            subtract(level, &mut rest, &column, 0.7, [3, 9], stride);
            for i in 0..n {
                for j in 0..=i {
                    let taken = if (3..9).contains(&i) { column[i] / 0.7 * column[j] } else { 0.0 };
                    assert_eq!(rest[i * stride + j], matrix[i * stride + j] - taken);
                }
            }
        }
    }
}
