//! Adding measurements to an information matrix: blocks of four by four unknowns.

use super::{Level, dispatch};

/// Adds `weight of p * weight of q * inner` to the block of unknowns 4 p.. and 4 q.. of a symmetric matrix, for each two of `points`
/// (number and weight), where q is not above p: the lower triangle. Rows of `matrix` are `stride` apart. Points outside the matrix
/// are left out.
pub fn add_blocks(level: Level, matrix: &mut [f64], stride: usize, points: &[(usize, f64)], inner: &[[f64; 4]; 4]) {
    dispatch!(level, add_body(matrix: &mut [f64], stride: usize, points: &[(usize, f64)], inner: &[[f64; 4]; 4]))
}

#[inline(always)]
fn add_body(matrix: &mut [f64], stride: usize, points: &[(usize, f64)], inner: &[[f64; 4]; 4]) {
    for &(p, wp) in points {
        for (c, inner) in inner.iter().enumerate() {
            let Some(row) = matrix.get_mut((4 * p + c) * stride..).and_then(|rest| rest.get_mut(..stride)) else { return };
            let blocks = row.as_chunks_mut::<4>().0;
            for &(q, wq) in points {
                if q > p {
                    continue;
                }
                let Some(block) = blocks.get_mut(q) else { continue };
                let weight = wp * wq;
                for i in 0..4 {
                    block[i] += weight * inner[i];
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
