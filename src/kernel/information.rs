//! Adding measurements to an information matrix: blocks of four by four unknowns.

use super::{Level, dispatch};

/// Points of a measurement, at most; further ones are left out.
pub const MOST_POINTS: usize = 8;

/// Adds `weight of p * weight of q * inner` to the block of unknowns 4 p.. and 4 q.. of a symmetric matrix, for each two of `points`
/// (number and weight), where q is not above p: the lower triangle. Rows of `matrix` are `stride` apart. Points outside the matrix
/// are left out.
pub fn add_blocks(level: Level, matrix: &mut [f64], stride: usize, points: &[(usize, f64)], inner: &[[f64; 4]; 4]) {
    dispatch!(level, add_body(matrix: &mut [f64], stride: usize, points: &[(usize, f64)], inner: &[[f64; 4]; 4]))
}

#[inline(always)]
fn add_body(matrix: &mut [f64], stride: usize, points: &[(usize, f64)], inner: &[[f64; 4]; 4]) {
    // plain loops: a closure would be compiled on its own, without the caller's instruction set
    let points = &points[..points.len().min(MOST_POINTS)];
    for &(p, wp) in points {
        // the blocks of this row, and their weights
        let (mut columns, mut weights, mut count) = ([0usize; MOST_POINTS], [0.0; MOST_POINTS], 0);
        for &(q, wq) in points {
            if q <= p {
                columns[count] = 4 * q;
                weights[count] = wp * wq;
                count += 1;
            }
        }
        for c in 0..4 {
            let first = (4 * p + c) * stride;
            if first + stride > matrix.len() {
                return;
            }
            let row = &mut matrix[first..first + stride];
            for k in 0..count {
                if columns[k] + 4 <= stride {
                    let block = &mut row[columns[k]..columns[k] + 4];
                    for i in 0..4 {
                        block[i] += weights[k] * inner[c][i];
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_level_adds_the_lower_triangle() {
        const N: usize = 20;
        let inner: [[f64; 4]; 4] =
            std::array::from_fn(|i| std::array::from_fn(|j| 0.1 + (i * j) as f64 + (i + j) as f64 / 3.0));
        let points = [(0, 0.3), (1, -0.7), (4, 1.9), (3, 0.011), (9, 5.0)];
        for level in Level::all() {
            let mut matrix = vec![0.5; N * N];
            add_blocks(level, &mut matrix, N, &points, &inner);
            for (row, column) in (0..N).flat_map(|row| (0..N).map(move |column| (row, column))) {
                let weight = |point: usize| points.iter().find(|(p, _)| *p == point).map_or(0.0, |(_, weight)| *weight);
                let lower = if column / 4 <= row / 4 { weight(row / 4) * weight(column / 4) } else { 0.0 };
                assert_eq!(matrix[row * N + column], 0.5 + lower * inner[row % 4][column % 4], "{row} {column}");
            }
        }
    }
}
