//! How well a place in a picture can be followed: the smaller eigenvalue of the gradient matrix, over a small rectangle.

use super::{Level, dispatch};
use crate::image::PlaneRef;

/// Half the side of the window over which the gradient matrix is summed, pixels.
pub const REACH: usize = 3;
/// Largest side of a rectangle that is searched at a time, pixels.
pub const MAX: usize = 32;
/// Sums that are worked on at a time; rows are made up to whole groups.
const GROUP: usize = 8;
const WIDE: usize = (MAX + 2 * REACH).next_multiple_of(GROUP);
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

/// Searches columns `x` .. `x + width` and rows `y` .. `y + height` of `plane` (at most [`MAX`] each; a rim of [`REACH`] + 1
/// pixels of the plane is never searched) for the strongest corner, at least as strong as `least`, that `allowed` (x, y). `None` where
/// there is no such place.
pub fn strongest(
    level: Level,
    plane: PlaneRef<'_>,
    [x, y]: [usize; 2],
    [width, height]: [usize; 2],
    least: f32,
    allowed: impl Fn(usize, usize) -> bool,
) -> Option<Corner> {
    let rim = REACH + 1;
    let (x0, y0) = (x.max(rim), y.max(rim));
    let x1 = x.saturating_add(width.min(MAX)).min(plane.width().saturating_sub(rim));
    let y1 = y.saturating_add(height.min(MAX)).min(plane.height().saturating_sub(rim));
    if x0 >= x1 || y0 >= y1 {
        return None;
    }
    let (w, h) = (x1 - x0, y1 - y0);
    let mut strengths = [[0.0; MAX]; MAX];
    let mut strongest = [0.0; MAX];
    measure(level, plane, [x0, y0], [w, h], &mut strengths, &mut strongest);
    let mut best: Option<Corner> = None;
    for (j, row) in strengths[..h].iter().enumerate() {
        // most rows hold nothing better
        if strongest[j] < least || best.is_some_and(|best| strongest[j] <= best.strength) {
            continue;
        }
        for (i, &strength) in row[..w].iter().enumerate() {
            if strength >= least && best.is_none_or(|best| strength > best.strength) && allowed(x0 + i, y0 + j) {
                best = Some(Corner { x: x0 + i, y: y0 + j, strength });
            }
        }
    }
    best
}

/// The smaller eigenvalue at each place of a rectangle, row by row.
type Strengths = [[f32; MAX]; MAX];

/// Measures the smaller eigenvalue at each place of a rectangle that lies [`REACH`] + 1 pixels within the plane, and each row's
/// largest.
fn measure(
    level: Level,
    plane: PlaneRef<'_>,
    from: [usize; 2],
    size: [usize; 2],
    all: &mut Strengths,
    largest: &mut [f32; MAX],
) {
    dispatch!(
        level,
        measure_body(
            plane: PlaneRef<'_>,
            from: [usize; 2],
            size: [usize; 2],
            all: &mut Strengths,
            largest: &mut [f32; MAX],
        )
    )
}

/// A row's gradient products xx, xy, yy, or their sums, at each column.
type Products = [[f32; WIDE]; 3];

#[inline(always)]
fn measure_body(plane: PlaneRef<'_>, [x0, y0]: [usize; 2], [w, h]: [usize; 2], all: &mut Strengths, largest: &mut [f32; MAX]) {
    const SIDE: usize = 2 * REACH + 1;
    let used = w + 2 * REACH + 2;
    let wide = (w + 2 * REACH).next_multiple_of(GROUP).min(WIDE);
    let places = w.next_multiple_of(GROUP).min(MAX);
    let mut rows = [[0u8; WIDE + 2]; 3];
    for (j, row) in rows[..2].iter_mut().enumerate() {
        row[..used].copy_from_slice(&plane.row(y0 + j - REACH - 1)[x0 - REACH - 1..][..used]);
    }
    // gradient products of the window's rows, summed along columns first (a running sum), then along rows: whole numbers below 2^22, which
    // single precision holds and multiplies faster than 32-bit integers
    let mut products: [Products; SIDE] = [[[0.0; WIDE]; 3]; SIDE];
    let mut columns: Products = [[0.0; WIDE]; 3];
    for j in 0..h + 2 * REACH {
        rows[(j + 2) % 3][..used].copy_from_slice(&plane.row(y0 + j + 1 - REACH)[x0 - REACH - 1..][..used]);
        // in place of the row that leaves the window
        replace_row([0, 1, 2].map(|k| &rows[(j + k) % 3]), wide, &mut products[j % SIDE], &mut columns);
        let Some(j) = j.checked_sub(2 * REACH) else { continue };
        for at in (0..places).step_by(GROUP) {
            eigenvalues(&columns, at, &mut all[j][at..at + GROUP]);
        }
        largest[j] = largest_of(&all[j][..w]);
    }
}

/// Puts the gradient products of row `here` in place of those of `products`, and takes the difference into the columns' sums.
#[inline(always)]
fn replace_row([above, here, below]: [&[u8; WIDE + 2]; 3], wide: usize, products: &mut Products, columns: &mut Products) {
    let ([xx, xy, yy], [sum_xx, sum_xy, sum_yy]) = (products, columns);
    for at in (0..wide).step_by(GROUP) {
        let (left, right) = (&here[at..at + GROUP], &here[at + 2..at + 2 + GROUP]);
        let (above, below) = (&above[at + 1..at + 1 + GROUP], &below[at + 1..at + 1 + GROUP]);
        let (xx, sum_xx) = (&mut xx[at..at + GROUP], &mut sum_xx[at..at + GROUP]);
        let (xy, sum_xy) = (&mut xy[at..at + GROUP], &mut sum_xy[at..at + GROUP]);
        let (yy, sum_yy) = (&mut yy[at..at + GROUP], &mut sum_yy[at..at + GROUP]);
        for i in 0..GROUP {
            let gx = (i32::from(right[i]) - i32::from(left[i])) as f32;
            let gy = (i32::from(below[i]) - i32::from(above[i])) as f32;
            sum_xx[i] += gx * gx - xx[i];
            sum_xy[i] += gx * gy - xy[i];
            sum_yy[i] += gy * gy - yy[i];
            xx[i] = gx * gx;
            xy[i] = gx * gy;
            yy[i] = gy * gy;
        }
    }
}

/// The smaller eigenvalues of the mean gradient matrices at the places from `at` on.
#[inline(always)]
fn eigenvalues(columns: &Products, at: usize, out: &mut [f32]) {
    let mut sums = [[0f32; GROUP]; 3];
    for k in 0..3 {
        let c = &columns[k][at..at + GROUP + 2 * REACH];
        for i in 0..GROUP {
            sums[k][i] = (c[i] + c[i + 1]) + (c[i + 2] + c[i + 3]) + (c[i + 4] + c[i + 5]) + c[i + 6];
        }
    }
    let out = &mut out[..GROUP];
    for i in 0..GROUP {
        // central differences were not halved: a quarter
        let xx = sums[0][i] * (0.25 / AREA);
        let xy = sums[1][i] * (0.25 / AREA);
        let yy = sums[2][i] * (0.25 / AREA);
        out[i] = 0.5 * (xx + yy - ((xx - yy) * (xx - yy) + 4.0 * xy * xy).sqrt());
    }
}

/// The largest of a row's strengths, or 0.
#[inline(always)]
fn largest_of(row: &[f32]) -> f32 {
    let mut lanes = [0.0f32; GROUP];
    for (n, strength) in row.iter().enumerate() {
        let lane = &mut lanes[n % GROUP];
        *lane = if *strength > *lane { *strength } else { *lane };
    }
    let mut largest = 0.0;
    for lane in lanes {
        largest = if lane > largest { lane } else { largest };
    }
    largest
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Plane;
    use crate::random::Congruential;

    #[test]
    fn finds_the_corner_of_a_square_and_nothing_on_its_edges() {
        let mut plane = Plane::<u8>::new(48, 40);
        for y in 20..40 {
            plane.row_mut(y)[24..].fill(200);
        }
        for level in Level::all() {
            let found = strongest(level, plane.as_ref(), [10, 10], [28, 20], f32::NEG_INFINITY, |_, _| true).unwrap();
            assert!(found.x.abs_diff(24) <= 2 && found.y.abs_diff(20) <= 2, "{found:?}");
            let edge = strongest(level, plane.as_ref(), [36, 14], [8, 12], f32::NEG_INFINITY, |_, _| true).unwrap();
            assert!(edge.strength < 0.01 * found.strength, "{edge:?}");
        }
    }

    /// Against the definition: the gradient matrix summed over the window, at every place.
    #[test]
    fn every_level_finds_what_the_definition_says() {
        let mut generator = Congruential::new(1);
        let mut noise = || generator.byte();
        for [width, height] in [[9, 9], [17, 12], [40, 40], [45, 50], [33, 80]] {
            let mut plane = Plane::<u8>::new(width, height);
            plane.samples_mut().iter_mut().for_each(|sample| *sample = noise());
            let plane = plane.as_ref();
            for (from, size) in [([0, 0], [32, 32]), ([5, 3], [13, 40]), ([0, 9], [64, 7]), ([11, 5], [5, 32])] {
                let allowed = |x: usize, y: usize| !(x + 2 * y).is_multiple_of(3);
                let mut best: Option<Corner> = None;
                for y in from[1].max(4)..(from[1] + size[1].min(MAX)).min(height - 4) {
                    for x in from[0].max(4)..(from[0] + size[0].min(MAX)).min(width - 4) {
                        let mut sums = [0i32; 3];
                        for (i, j) in (0..7).flat_map(|j| (0..7).map(move |i| (x + i - 3, y + j - 3))) {
                            let at = |x: usize, y: usize| i32::from(plane.at(x, y));
                            let (gx, gy) = (at(i + 1, j) - at(i - 1, j), at(i, j + 1) - at(i, j - 1));
                            sums = [sums[0] + gx * gx, sums[1] + gx * gy, sums[2] + gy * gy];
                        }
                        let [xx, xy, yy] = sums.map(|sum| sum as f32 * (0.25 / 49.0));
                        let strength = 0.5 * (xx + yy - ((xx - yy) * (xx - yy) + 4.0 * xy * xy).sqrt());
                        if best.is_none_or(|best| strength > best.strength) && allowed(x, y) {
                            best = Some(Corner { x, y, strength });
                        }
                    }
                }
                for level in Level::all() {
                    assert_eq!(
                        strongest(level, plane, from, size, f32::NEG_INFINITY, allowed),
                        best,
                        "{width}x{height} {}",
                        level.name()
                    );
                    // as strong as it must be, and the next number below that
                    let Some(Corner { strength, .. }) = best else { continue };
                    assert_eq!(strongest(level, plane, from, size, strength, allowed), best);
                    assert_eq!(strongest(level, plane, from, size, strength.next_up(), allowed), None);
                }
            }
        }
    }

    #[test]
    fn a_plane_smaller_than_the_window_has_no_place() {
        let plane = Plane::<u8>::new(7, 7);
        assert_eq!(strongest(Level::detected(), plane.as_ref(), [0, 0], [7, 7], f32::NEG_INFINITY, |_, _| true), None);
    }
}
