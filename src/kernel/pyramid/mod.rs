//! Halving a plane: the pyramid's one pixel loop.

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "aarch64")]
mod neon;
#[cfg(any(target_arch = "x86_64", target_arch = "aarch64"))]
mod wide;

use super::{Level, dispatch};
#[cfg(target_arch = "x86_64")]
use avx2::Avx2 as Native;
#[cfg(target_arch = "aarch64")]
use neon::Neon as Native;

use crate::image::{PlaneMut, PlaneRef};

/// Output columns done at a time, so that the vertical sums stay on the stack.
const BLOCK: usize = 256;

/// Halves `from` into `to` (width and height halved, rounded down), by the separable filter (1 3 3 1) / 8 between pairs of
/// samples, edges repeated. The centre of output pixel (x, y) is input point (2x + 0.5, 2y + 0.5).
pub fn halve(level: Level, from: PlaneRef<'_>, to: PlaneMut<'_>) {
    let size = [(from.width() / 2).min(to.width()), (from.height() / 2).min(to.height())];
    if size.contains(&0) {
        return;
    }
    #[cfg(any(target_arch = "x86_64", target_arch = "aarch64"))]
    if let Some(native) = Native::of(level) {
        let mut to = to;
        let end = native.inner(from, &mut to);
        for y in 1..size[1] - 1 {
            let rows = [2 * y - 1, 2 * y, 2 * y + 1, 2 * y + 2].map(|y| from.row(y));
            let out = &mut to.row_mut(y)[..size[0]];
            std::iter::once(0).chain(end..size[0]).for_each(|x| out[x] = pixel(rows, x));
        }
        let ends = [0, size[1] - 1];
        ends.into_iter().for_each(|y| halve_rows(level, from, to.reborrow(), size[0], [y, y + 1]));
        return;
    }
    halve_rows(level, from, to, size[0], [0, size[1]]);
}

/// Output pixel `x` of a row that these four become.
#[cfg(any(target_arch = "x86_64", target_arch = "aarch64"))]
fn pixel(rows: [&[u8]; 4], x: usize) -> u8 {
    let last = rows[0].len() - 1;
    let [a, b, c, d] = [(2 * x).saturating_sub(1), 2 * x, 2 * x + 1, (2 * x + 2).min(last)].map(|x| column(rows, x));
    ((a + 3 * (b + c) + d + 32) >> 6) as u8
}

/// Halves into `columns` of the output's rows from the first of `rows` on to before the other.
fn halve_rows(level: Level, from: PlaneRef<'_>, to: PlaneMut<'_>, columns: usize, rows: [usize; 2]) {
    dispatch!(level, halve_body(from: PlaneRef<'_>, to: PlaneMut<'_>, columns: usize, rows: [usize; 2]))
}

#[inline(always)]
fn halve_body(from: PlaneRef<'_>, mut to: PlaneMut<'_>, columns: usize, [top, bottom]: [usize; 2]) {
    let (width, height) = (from.width(), from.height());
    let mut sums = [0u16; 2 * BLOCK + 2];
    for y in top..bottom {
        let rows = [(2 * y).saturating_sub(1), 2 * y, 2 * y + 1, (2 * y + 2).min(height - 1)].map(|y| from.row(y));
        let out = to.row_mut(y);
        for start in (0..columns).step_by(BLOCK) {
            let count = BLOCK.min(columns - start);
            // sums[i] is the vertical sum of input column 2 * start - 1 + i
            let first = 2 * start;
            let last = (first + 2 * count + 1).min(width);
            vertical(rows.map(|row| &row[first..last]), &mut sums[1..]);
            sums[0] = if start == 0 { sums[1] } else { column(rows, first - 1) };
            if last - first < 2 * count + 1 {
                sums[2 * count + 1] = sums[2 * count];
            }
            horizontal(&sums[..2 * count + 2], &mut out[start..start + count]);
        }
    }
}

fn column(rows: [&[u8]; 4], x: usize) -> u16 {
    let [a, b, c, d] = rows.map(|row| u16::from(row[x]));
    a + 3 * (b + c) + d
}

#[inline(always)]
fn vertical([a, b, c, d]: [&[u8]; 4], sums: &mut [u16]) {
    let n = a.len();
    let (b, c, d, sums) = (&b[..n], &c[..n], &d[..n], &mut sums[..n]);
    for i in 0..n {
        sums[i] = u16::from(a[i]) + 3 * (u16::from(b[i]) + u16::from(c[i])) + u16::from(d[i]);
    }
}

#[inline(always)]
fn horizontal(sums: &[u16], out: &mut [u8]) {
    for (i, out) in out.iter_mut().enumerate() {
        let s = &sums[2 * i..2 * i + 4];
        *out = ((s[0] + 3 * (s[1] + s[2]) + s[3] + 32) >> 6) as u8;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Plane;

    #[test]
    fn agrees_with_the_definition_on_odd_sizes() {
        for (w, h) in [(2, 2), (3, 5), (17, 9), (36, 6), (37, 8), (68, 7), (514, 7), (1031, 4), (513, 3), (1100, 9), (2111, 11)]
        {
            let mut from = Plane::<u8>::new(w, h);
            for (i, s) in from.samples_mut().iter_mut().enumerate() {
                *s = (i.wrapping_mul(2_654_435_761) >> 13) as u8;
            }
            let mut to = Plane::<u8>::new(w / 2, h / 2);
            for level in Level::all() {
                to.samples_mut().fill(0);
                halve(level, from.as_ref(), to.as_mut());
                for y in 0..h / 2 {
                    for x in 0..w / 2 {
                        let mut sum = 0u32;
                        for (j, wj) in [1, 3, 3, 1].into_iter().enumerate() {
                            for (i, wi) in [1, 3, 3, 1].into_iter().enumerate() {
                                let sx = (2 * x + i).saturating_sub(1).min(w - 1);
                                let sy = (2 * y + j).saturating_sub(1).min(h - 1);
                                sum += wi * wj * u32::from(from.row(sy)[sx]);
                            }
                        }
                        assert_eq!(u32::from(to.row(y)[x]), (sum + 32) >> 6, "{w}x{h} at {x},{y}");
                    }
                }
            }
        }
    }
}
