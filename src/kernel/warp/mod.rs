//! Sampling along straight lines, bilinear or bicubic: the warp's one pixel loop.

#[cfg(target_arch = "x86_64")]
mod avx2;
mod cells;
mod cubic;
#[cfg(target_arch = "aarch64")]
mod neon;
mod nodes;
#[cfg(any(target_arch = "x86_64", target_arch = "aarch64"))]
mod octets;

use cells::Line;
pub use cells::{Axis, Between, Cells, FURTHEST, Filter, Outside, lines};
pub use nodes::{Lens, Mesh, RowTable, TABLE, nodes};

use super::Level;
use crate::image::PlaneRef;

/// One in 16.16.
pub const ONE: i32 = 1 << 16;
/// Columns count in steps of 1/128: half of one, for rounding.
const HALF_STEP: i32 = ONE / 256;

/// Rows and columns that 16.16 fixed point can tell apart; what a plane has beyond them is not drawn from.
const LARGEST: usize = 1 << 15;
/// Points this near to the plane's left or upper edge may be rounded down to beyond it.
const MARGIN: i32 = 128;

/// Draws a row of output, one cell's line after the other: as the cells' filter says, rounded to nearest. Points outside the plane
/// show what the cells say; neighbours outside of it are those at its edge.
///
/// Every eighth pixel of a cell begins a line of its own; its place and its step are rounded down to 1/4096. Columns are then
/// rounded to 1/128. What `out` has beyond the cells, or where the plane is empty, stays as it was.
pub fn row(level: Level, plane: PlaneRef<'_>, cells: Cells<'_>, out: &mut [u8]) {
    rows(level, [plane], cells, [out]);
}

/// Draws the same row of several planes, as [`row`] does. Planes and rows of one shape share the work of finding their places.
pub fn rows<const N: usize>(level: Level, planes: [PlaneRef<'_>; N], cells: Cells<'_>, mut outs: [&mut [u8]; N]) {
    let is_one_shape = alike(&planes) && outs.windows(2).all(|pair| pair[0].len() == pair[1].len());
    if N > 1 && !is_one_shape {
        return planes.into_iter().zip(outs).for_each(|(plane, out)| row(level, plane, cells, out));
    }
    let is_empty = planes.first().is_none_or(|plane| plane.width() == 0 || plane.height() == 0);
    if is_empty || cells.wide == 0 {
        return;
    }
    let most = cells.count().saturating_mul(cells.wide);
    let outs = outs.each_mut().map(|out| {
        let len = out.len().min(most);
        &mut out[..len]
    });
    #[cfg(target_arch = "x86_64")]
    if level.has_avx2() {
        // SAFETY: a `Level` says AVX2 only where the processor was found to have it; the planes are alike.
        return unsafe { octets::rows::<avx2::Avx2, N>(planes, cells, outs) };
    }
    #[cfg(target_arch = "aarch64")]
    if level.has_neon() {
        // SAFETY: a `Level` says NEON only where the processor has it; the planes are alike.
        return unsafe { octets::rows::<neon::Neon, N>(planes, cells, outs) };
    }
    let _ = level;
    planes.into_iter().zip(outs).for_each(|(plane, out)| row_scalar(plane, cells, out));
}

/// Whether planes are of one shape, so that what lies in one lies in all.
fn alike(planes: &[PlaneRef<'_>]) -> bool {
    let shape = |plane: &PlaneRef<'_>| [plane.width(), plane.height(), plane.stride(), plane.samples().len()];
    planes.windows(2).all(|pair| shape(&pair[0]) == shape(&pair[1]))
}

fn row_scalar(plane: PlaneRef<'_>, cells: Cells<'_>, out: &mut [u8]) {
    for (i, out) in out.chunks_mut(cells.wide).enumerate() {
        scalar(plane, cells.line(i), cells, out);
    }
}

/// Whether all points within a rectangle (two corners, 16.16) have all their neighbours in the plane, and can be written in 16.16.
#[inline(always)]
fn is_inside(plane: PlaneRef<'_>, filter: Filter, [low, high]: [[i64; 2]; 2]) -> bool {
    let (margin, half_step) = (i64::from(MARGIN), i64::from(HALF_STEP));
    let reach = i64::from(filter.reach() * ONE);
    let limit = |size: usize| (size.min(LARGEST) as i64 - 1) << 16;
    low[0] >= margin + reach
        && low[1] >= margin + reach
        && high[0] + half_step < limit(plane.width()) - reach
        && high[1] < limit(plane.height()) - reach
}

/// The place of a line's pixel `n`.
#[inline(always)]
fn position(start: i32, step: i32, n: i32) -> i32 {
    (start.wrapping_add(step.wrapping_mul(n & !7)) & !15).wrapping_add((step & !15).wrapping_mul(n & 7))
}

/// Draws the pixels of `out` along a line.
#[inline(always)]
fn scalar(plane: PlaneRef<'_>, line: Line, cells: Cells<'_>, out: &mut [u8]) {
    match cells.filter {
        Filter::Bilinear => scalar_of(plane, line, cells, out, [0, 1], |[a, b], x, y| blend([a[0], a[1], b[0], b[1]], x, y)),
        Filter::Bicubic => scalar_of(plane, line, cells, out, [-1, 0, 1, 2], cubic::blend),
    }
}

/// As [`scalar`], of the neighbours so many samples off.
#[inline(always)]
fn scalar_of<const N: usize>(
    plane: PlaneRef<'_>,
    Line { start, step }: Line,
    cells: Cells<'_>,
    out: &mut [u8],
    near: [i32; N],
    blend: impl Fn([[u8; N]; N], i32, i32) -> u8,
) {
    let size = [plane.width(), plane.height()].map(|size| size.min(LARGEST) as i32);
    let along = |axis: usize, n: usize| position(start[axis], step[axis], n as i32);
    let last = out.len().saturating_sub(1) as i64;
    let end = |axis: usize| i64::from(start[axis]).saturating_add(i64::from(step[axis]).saturating_mul(last));
    let corner = |pick: fn(i64, i64) -> i64| [0, 1].map(|axis| pick(start[axis].into(), end(axis)));
    if is_inside(plane, cells.filter, [corner(i64::min), corner(i64::max)]) {
        let (samples, stride) = (plane.samples(), plane.stride());
        for (n, out) in out.iter_mut().enumerate() {
            let (x, y) = (along(0, n) + HALF_STEP, along(1, n));
            let at = ((y >> 16) + near[0]) as usize * stride + ((x >> 16) + near[0]) as usize;
            let pixels = &samples[at..at + (N - 1) * stride + N];
            *out = blend(std::array::from_fn(|j| std::array::from_fn(|i| pixels[j * stride + i])), x, y);
        }
        return;
    }
    let limit = size.map(|size| (size - 1) << 16);
    for (n, out) in out.iter_mut().enumerate() {
        let (x, y) = (along(0, n), along(1, n));
        if let Outside::Value(value) = cells.outside
            && !((0..=limit[0]).contains(&x) && (0..=limit[1]).contains(&y))
        {
            *out = value;
            continue;
        }
        let (x, y) = (mirrored(x, limit[0]) + HALF_STEP, mirrored(y, limit[1]));
        let columns = near.map(|off| ((x >> 16) + off).clamp(0, size[0] - 1) as usize);
        let rows = near.map(|off| plane.row(((y >> 16) + off).clamp(0, size[1] - 1) as usize));
        *out = blend(rows.map(|row| columns.map(|column| row[column])), x, y);
    }
}

/// A coordinate reflected at 0 and `limit` until it lies between them.
fn mirrored(x: i32, limit: i32) -> i32 {
    let there_and_back = 2 * i64::from(limit.max(1));
    let along = i64::from(x).rem_euclid(there_and_back);
    along.min(there_and_back - along).min(i64::from(limit)) as i32
}

/// Weighs four neighbours by the fractions of `x` (7 bits of it, then 7 bits of the mean) and `y`.
#[inline(always)]
fn blend([a, b, c, d]: [u8; 4], x: i32, y: i32) -> u8 {
    let (fx, fy) = ((x >> 9) & 127, (y & 0xffff) >> 1);
    let mix = |left: u8, right: u8| (128 - fx) * i32::from(left) + fx * i32::from(right);
    let (top, bottom) = (mix(a, b), mix(c, d));
    let mixed = top + (((bottom - top) * fy + (1 << 14)) >> 15);
    ((mixed + 64) >> 7) as u8
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Plane;
    use proptest::prelude::*;

    fn line(level: Level, plane: PlaneRef<'_>, start: [i32; 2], step: [i32; 2], out: &mut [u8]) {
        let cells = Cells {
            start: [&[start[0]], &[start[1]]],
            step: [&[step[0]], &[step[1]]],
            wide: out.len(),
            outside: Outside::Mirror,
            filter: Filter::Bilinear,
        };
        row(level, plane, cells, out);
    }

    #[test]
    fn whole_steps_copy_and_halves_average() {
        let mut plane = Plane::<u8>::new(37, 3);
        for (i, s) in plane.samples_mut().iter_mut().enumerate() {
            *s = (i * 2) as u8;
        }
        for level in Level::all() {
            let mut out = [0; 36];
            line(level, plane.as_ref(), [0, ONE], [ONE, 0], &mut out);
            assert_eq!(out[..], plane.row(1)[..36]);
            line(level, plane.as_ref(), [ONE / 2, ONE / 2], [ONE, 0], &mut out[..32]);
            for (x, &out) in out[..32].iter().enumerate() {
                assert_eq!(usize::from(out), 2 * x + 38);
            }
        }
    }

    #[test]
    fn points_far_outside_are_drawn_too() {
        let mut plane = Plane::<u8>::new(4, 4);
        plane.samples_mut().fill(9);
        for level in Level::all() {
            let mut out = [0; 16];
            line(level, plane.as_ref(), [-3 * ONE, i32::MAX], [i32::MAX, i32::MIN], &mut out);
            assert_eq!(out, [9; 16]);
        }
    }

    /// Steps as they come in practice, and any others.
    fn steps() -> impl Strategy<Value = [i32; 2]> {
        prop_oneof![
            3 => (ONE / 2..2 * ONE, -ONE / 6..ONE / 6).prop_map(|(x, y)| [x, y]),
            1 => prop::array::uniform2(-2 * ONE..2 * ONE),
        ]
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(600))]

        /// Every level gives the bits of the definition, pixel by pixel, and touches nothing past the row's end.
        #[test]
        fn every_level_agrees_with_the_definition(
            (w, h) in (1usize..160, 1usize..14),
            padding in 0usize..3,
            starts in prop::collection::vec((-4 * ONE..100 * ONE, -2 * ONE..14 * ONE), 1..4),
            step in steps(),
            wide in prop::sample::select(vec![5usize, 16, 32, 64]),
            short in 0usize..5,
            seed in any::<u32>(),
            extremes in any::<bool>(),
            outside in prop::sample::select(vec![Outside::Mirror, Outside::Value(77)]),
            filter in prop::sample::select(vec![Filter::Bilinear, Filter::Bicubic]),
        ) {
            let stride = w + padding;
            let sample = |i: usize| {
                let noise = (i as u32).wrapping_mul(seed | 1).rotate_right(9) as u8;
                if extremes { [0, 255][usize::from(noise & 1)] } else { noise }
            };
            let data: Vec<u8> = (0..(h - 1) * stride + w).map(sample).collect();
            let plane = PlaneRef::new(&data, w, h, stride).unwrap();
            let width = starts.len() * wide - short;
            let mut wanted = vec![0xAA; width + 9];
            for (x, wanted) in wanted[..width].iter_mut().enumerate() {
                let (cell, n) = (x / wide, (x % wide) as i32);
                // the place of the eighth pixel before, and the step, in 1/4096
                let at = |start: i32, step: i32| 16 * ((start + n / 8 * 8 * step).div_euclid(16) + n % 8 * step.div_euclid(16));
                let (px, py) = (at(starts[cell].0, step[0]), at(starts[cell].1, step[1]));
                let limit = [w, h].map(|size| (size as i32 - 1) << 16);
                if outside == Outside::Value(77) && (px < 0 || py < 0 || px > limit[0] || py > limit[1]) {
                    *wanted = 77;
                    continue;
                }
                let inside = |mut x: i32, limit: i32| {
                    // by hand: back from whichever edge was crossed
                    while limit > 0 && !(0..=limit).contains(&x) {
                        x = if x < 0 { -x } else { 2 * limit - x };
                    }
                    x.clamp(0, limit)
                };
                let (px, py) = (inside(px, limit[0]) + HALF_STEP, inside(py, limit[1]));
                let sample = |dx: i32, dy: i32| {
                    let along = |at: i32, off: i32, size: usize| ((at >> 16) + off).clamp(0, size as i32 - 1) as usize;
                    data[along(py, dy, h) * stride + along(px, dx, w)]
                };
                *wanted = match filter {
                    Filter::Bilinear => blend([sample(0, 0), sample(1, 0), sample(0, 1), sample(1, 1)], px, py),
                    Filter::Bicubic => {
                        cubic::blend([-1, 0, 1, 2].map(|dy| [-1, 0, 1, 2].map(|dx| sample(dx, dy))), px, py)
                    }
                };
            }
            let (xs, ys): (Vec<i32>, Vec<i32>) = starts.iter().copied().unzip();
            let (dxs, dys) = (vec![step[0]; xs.len()], vec![step[1]; xs.len()]);
            for level in Level::all() {
                let mut out = vec![0xAA; width + 9];
                let cells = Cells { start: [&xs, &ys], step: [&dxs, &dys], wide, outside, filter };
                row(level, plane, cells, &mut out[..width]);
                prop_assert_eq!(&out, &wanted, "{}", level.name());
            }
        }

        /// Bilinear, and rounded to nearest but for what 1/128 of a column leaves over.
        #[test]
        fn the_definition_is_bilinear(four in any::<[u8; 4]>(), fx in 0..ONE, fy in 0..ONE) {
            let [a, b, c, d] = four.map(f64::from);
            let (u, v) = (f64::from(fx & !511) / f64::from(ONE), f64::from(fy) / f64::from(ONE));
            let exact = (a * (1.0 - u) + b * u) * (1.0 - v) + (c * (1.0 - u) + d * u) * v;
            let found = f64::from(blend(four, fx, fy));
            prop_assert!((found - exact).abs() <= 0.52, "{found} for {exact}");
        }
    }
}
