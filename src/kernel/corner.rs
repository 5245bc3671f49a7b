//! How well a place in a picture can be followed: the smaller eigenvalue of the gradient matrix, over a small rectangle.

use super::{Level, dispatch};
use crate::image::PlaneRef;

/// Half the side of the window over which the gradient matrix is summed, pixels.
pub const REACH: usize = 3;
/// Largest side of a rectangle that is searched at a time, pixels.
pub const MOST: usize = 32;
/// Sums that are worked on at a time; rows are made up to whole groups.
const GROUP: usize = 8;
const WIDE: usize = (MOST + 2 * REACH).next_multiple_of(GROUP);
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
pub fn strongest(
    level: Level,
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
    let mut strengths = [[0.0; MOST]; MOST];
    measure(level, plane, [x0, y0], [w, h], &mut strengths);
    let mut best: Option<Corner> = None;
    for (j, row) in strengths[..h].iter().enumerate() {
        let row = &row[..w];
        // most rows hold nothing better
        if best.is_some_and(|best| !row.iter().any(|&strength| strength > best.strength)) {
            continue;
        }
        for (i, &strength) in row.iter().enumerate() {
            if best.is_none_or(|best| strength > best.strength) && allowed(x0 + i, y0 + j) {
                best = Some(Corner { x: x0 + i, y: y0 + j, strength });
            }
        }
    }
    best
}

/// Measures the smaller eigenvalue at each place of a rectangle that lies [`REACH`] + 1 pixels within the plane.
fn measure(level: Level, plane: PlaneRef<'_>, from: [usize; 2], size: [usize; 2], strengths: &mut [[f32; MOST]; MOST]) {
    dispatch!(level, measure_body(plane: PlaneRef<'_>, from: [usize; 2], size: [usize; 2], strengths: &mut [[f32; MOST]; MOST]))
}

#[inline(always)]
fn measure_body(plane: PlaneRef<'_>, [x0, y0]: [usize; 2], [w, h]: [usize; 2], strengths: &mut [[f32; MOST]; MOST]) {
    let used = w + 2 * REACH;
    let wide = used.next_multiple_of(GROUP).min(WIDE);
    let places = w.next_multiple_of(GROUP).min(MOST);
    // gradient products, summed along columns first (a running sum), then along rows
    let mut products = [[[0i32; WIDE]; MOST + 2 * REACH]; 3];
    let mut columns = [[0i32; WIDE]; 3];
    for j in 0..h + 2 * REACH {
        let rows = [0, 1, 2].map(|k| {
            let mut row = [0u8; WIDE + 2];
            row[..used + 2].copy_from_slice(&plane.row(y0 + j + k - REACH - 1)[x0 - REACH - 1..][..used + 2]);
            row
        });
        let [xx, xy, yy] = products.each_mut().map(|product| &mut product[j]);
        for i in 0..wide {
            let gx = i32::from(rows[1][i + 2]) - i32::from(rows[1][i]);
            let gy = i32::from(rows[2][i + 1]) - i32::from(rows[0][i + 1]);
            xx[i] = gx * gx;
            xy[i] = gx * gy;
            yy[i] = gy * gy;
        }
        for (column, product) in columns.iter_mut().zip(&products) {
            for i in 0..wide {
                column[i] += product[j][i];
            }
        }
        let Some(j) = j.checked_sub(2 * REACH) else { continue };
        let mut sums = [[0i32; MOST]; 3];
        for (sums, column) in sums.iter_mut().zip(&columns) {
            for i in 0..places {
                let c = &column[i..i + 2 * REACH + 1];
                sums[i] = (c[0] + c[1]) + (c[2] + c[3]) + (c[4] + c[5]) + c[6];
            }
        }
        for i in 0..places {
            // central differences were not halved: a quarter
            let [xx, xy, yy] = [0, 1, 2].map(|k: usize| sums[k][i] as f32 * (0.25 / AREA));
            strengths[j][i] = 0.5 * (xx + yy - ((xx - yy) * (xx - yy) + 4.0 * xy * xy).sqrt());
        }
        for (column, product) in columns.iter_mut().zip(&products) {
            for i in 0..wide {
                column[i] -= product[j][i];
            }
        }
    }
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
        for level in Level::all() {
            let found = strongest(level, plane.as_ref(), [10, 10], [28, 20], |_, _| true).unwrap();
            assert!(found.x.abs_diff(24) <= 2 && found.y.abs_diff(20) <= 2, "{found:?}");
            let edge = strongest(level, plane.as_ref(), [36, 14], [8, 12], |_, _| true).unwrap();
            assert!(edge.strength < 0.01 * found.strength, "{edge:?}");
        }
    }

    /// Against the definition: the gradient matrix summed over the window, at every place.
    #[test]
    fn every_level_finds_what_the_definition_says() {
        let mut state = 1u32;
        let mut noise = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 24) as u8
        };
        for [width, height] in [[9, 9], [17, 12], [40, 40], [45, 50], [33, 80]] {
            let mut plane = Plane::<u8>::new(width, height);
            plane.samples_mut().iter_mut().for_each(|sample| *sample = noise());
            let plane = plane.as_ref();
            for (from, size) in [([0, 0], [32, 32]), ([5, 3], [13, 40]), ([0, 9], [64, 7]), ([11, 5], [5, 32])] {
                let allowed = |x: usize, y: usize| !(x + 2 * y).is_multiple_of(3);
                let mut best: Option<Corner> = None;
                for y in from[1].max(4)..(from[1] + size[1].min(MOST)).min(height - 4) {
                    for x in from[0].max(4)..(from[0] + size[0].min(MOST)).min(width - 4) {
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
                    assert_eq!(strongest(level, plane, from, size, allowed), best, "{width}x{height} {}", level.name());
                }
            }
        }
    }

    #[test]
    fn a_plane_smaller_than_the_window_has_no_place() {
        let plane = Plane::<u8>::new(7, 7);
        assert_eq!(strongest(Level::detected(), plane.as_ref(), [0, 0], [7, 7], |_, _| true), None);
    }
}
