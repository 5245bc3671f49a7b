//! How well a place in a picture can be followed: the smaller eigenvalue of the gradient matrix, over a small rectangle.

use crate::image::PlaneRef;

/// Half the side of the window over which the gradient matrix is summed, pixels.
pub const REACH: usize = 3;
/// Largest side of a rectangle that is searched at a time, pixels.
pub const MOST: usize = 32;
const WIDE: usize = MOST + 2 * REACH;
/// Samples in the window.
const AREA: f32 = ((2 * REACH + 1) * (2 * REACH + 1)) as f32;

/// The best place in a rectangle.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Corner {
    /// Column.
    pub x: usize,
    /// Row.
    pub y: usize,
    /// Smaller eigenvalue of the mean gradient matrix, (grey levels / pixel)^2.
    pub strength: f32,
}

/// Searches columns `x` .. `x + width` and rows `y` .. `y + height` of `plane` (at most [`MOST`] each; a rim of [`REACH`] + 1
/// pixels of the plane is never searched) for the strongest corner that `allowed` (x, y). `None` where there is no place.
#[inline(always)]
pub fn strongest(
    plane: PlaneRef<'_>,
    [x, y]: [usize; 2],
    [width, height]: [usize; 2],
    allowed: impl Fn(usize, usize) -> bool,
) -> Option<Corner> {
    let rim = REACH + 1;
    let (x0, y0) = (x.max(rim), y.max(rim));
    let x1 = (x + width.min(MOST)).min(plane.width().saturating_sub(rim));
    let y1 = (y + height.min(MOST)).min(plane.height().saturating_sub(rim));
    if x0 >= x1 || y0 >= y1 {
        return None;
    }
    let (w, h) = (x1 - x0, y1 - y0);
    let wide = w + 2 * REACH;
    // gradient products, summed along columns first (a running sum), then along rows
    let mut products = [[[0i32; WIDE]; WIDE]; 3];
    for j in 0..h + 2 * REACH {
        let yy = y0 + j - REACH;
        let (above, here, below) = (plane.row(yy - 1), plane.row(yy), plane.row(yy + 1));
        let from = x0 - REACH;
        let (above, here, below) = (&above[from..from + wide], &here[from - 1..from + wide + 1], &below[from..from + wide]);
        for i in 0..wide {
            let gx = i32::from(here[i + 2]) - i32::from(here[i]);
            let gy = i32::from(below[i]) - i32::from(above[i]);
            products[0][j][i] = gx * gx;
            products[1][j][i] = gx * gy;
            products[2][j][i] = gy * gy;
        }
    }
    let mut columns = [[0i32; WIDE]; 3];
    for (column, product) in columns.iter_mut().zip(&products) {
        for row in &product[..2 * REACH] {
            for i in 0..wide {
                column[i] += row[i];
            }
        }
    }
    let mut best: Option<Corner> = None;
    for j in 0..h {
        for (column, product) in columns.iter_mut().zip(&products) {
            let row = &product[j + 2 * REACH];
            for i in 0..wide {
                column[i] += row[i];
            }
        }
        let mut sums = [0i32; 3];
        for (sum, column) in sums.iter_mut().zip(&columns) {
            *sum = column[..2 * REACH].iter().sum();
        }
        for i in 0..w {
            for (sum, column) in sums.iter_mut().zip(&columns) {
                *sum += column[i + 2 * REACH];
            }
            // central differences were not halved: a quarter
            let [xx, xy, yy] = sums.map(|sum| sum as f32 * (0.25 / AREA));
            let strength = 0.5 * (xx + yy - ((xx - yy) * (xx - yy) + 4.0 * xy * xy).sqrt());
            if best.is_none_or(|best| strength > best.strength) && allowed(x0 + i, y0 + j) {
                best = Some(Corner { x: x0 + i, y: y0 + j, strength });
            }
            for (sum, column) in sums.iter_mut().zip(&columns) {
                *sum -= column[i];
            }
        }
        for (column, product) in columns.iter_mut().zip(&products) {
            let row = &product[j];
            for i in 0..wide {
                column[i] -= row[i];
            }
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Plane;

    #[test]
    fn finds_the_corner_of_a_square_and_nothing_on_its_edges() {
        let mut plane = Plane::<u8>::new(48, 40);
        for y in 20..40 {
            plane.row_mut(y)[24..].fill(200);
        }
        let found = strongest(plane.as_ref(), [10, 10], [28, 20], |_, _| true).unwrap();
        assert!(found.x.abs_diff(24) <= 2 && found.y.abs_diff(20) <= 2, "{found:?}");
        let edge = strongest(plane.as_ref(), [36, 14], [8, 12], |_, _| true).unwrap();
        assert!(edge.strength < 0.01 * found.strength, "{edge:?}");
    }

    #[test]
    fn a_plane_smaller_than_the_window_has_no_place() {
        let plane = Plane::<u8>::new(7, 7);
        assert_eq!(strongest(plane.as_ref(), [0, 0], [7, 7], |_, _| true), None);
    }
}
