//! Bilinear sampling along a straight line: the warp's one pixel loop.

use super::{Level, dispatch};
use crate::image::PlaneRef;

/// A line through a plane in 16.16 fixed point: the point of the first output pixel and the step to each next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Line {
    /// First point (x, y).
    pub start: [i32; 2],
    /// Step (x, y).
    pub step: [i32; 2],
}

/// One in 16.16.
pub const ONE: i32 = 1 << 16;

/// Draws `out.len()` pixels of `plane` along `line`, bilinear with weights of 1/256, rounded to nearest. Points outside the
/// plane take its nearest edge.
pub fn span(level: Level, plane: PlaneRef<'_>, line: Line, out: &mut [u8]) {
    dispatch!(level, span_body(plane: PlaneRef<'_>, line: Line, out: &mut [u8]))
}

#[inline(always)]
fn span_body(plane: PlaneRef<'_>, line: Line, out: &mut [u8]) {
    let (w, h) = (plane.width() as i32, plane.height() as i32);
    if out.is_empty() || w == 0 || h == 0 {
        return;
    }
    let last = out.len() as i32 - 1;
    let inside = |point: i32, step: i32, size: i32| {
        let end = i64::from(point) + i64::from(step) * i64::from(last);
        let limit = i64::from(size - 1) << 16;
        point >= 0 && i64::from(point) < limit && end >= 0 && end < limit
    };
    let [mut x, mut y] = line.start;
    if inside(x, line.step[0], w) && inside(y, line.step[1], h) {
        let (samples, stride) = (plane.samples(), plane.stride());
        for out in out {
            let at = (y >> 16) as usize * stride + (x >> 16) as usize;
            let pixel = &samples[at..at + stride + 2];
            *out = blend([pixel[0], pixel[1], pixel[stride], pixel[stride + 1]], x, y);
            // the step past the last pixel may lead anywhere
            x = x.wrapping_add(line.step[0]);
            y = y.wrapping_add(line.step[1]);
        }
        return;
    }
    for out in out {
        let (cx, cy) = (x.clamp(0, (w - 1) << 16), y.clamp(0, (h - 1) << 16));
        let (ix, iy) = ((cx >> 16) as usize, (cy >> 16) as usize);
        let (a, b) = (plane.row(iy), plane.row((iy + 1).min(h as usize - 1)));
        let next = (ix + 1).min(w as usize - 1);
        *out = blend([a[ix], a[next], b[ix], b[next]], cx, cy);
        x = x.saturating_add(line.step[0]);
        y = y.saturating_add(line.step[1]);
    }
}

/// Weighs four neighbours by the fractions of `x` and `y`, 8 bits of each.
#[inline(always)]
fn blend([a, b, c, d]: [u8; 4], x: i32, y: i32) -> u8 {
    let (fx, fy) = ((x >> 8) & 255, (y >> 8) & 255);
    let (a, b, c, d) = (i32::from(a), i32::from(b), i32::from(c), i32::from(d));
    let top = (a << 8) + (b - a) * fx;
    let bottom = (c << 8) + (d - c) * fx;
    (((top << 8) + (bottom - top) * fy + (1 << 15)) >> 16) as u8
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Plane;

    #[test]
    fn whole_steps_copy_and_halves_average() {
        let mut plane = Plane::<u8>::new(5, 3);
        for (i, s) in plane.samples_mut().iter_mut().enumerate() {
            *s = (i * 16) as u8;
        }
        let mut out = [0; 5];
        span(Level::detected(), plane.as_ref(), Line { start: [0, ONE], step: [ONE, 0] }, &mut out);
        assert_eq!(out, [80, 96, 112, 128, 144]);
        span(Level::detected(), plane.as_ref(), Line { start: [ONE / 2, ONE], step: [ONE, 0] }, &mut out[..4]);
        assert_eq!(out[..4], [88, 104, 120, 136]);
    }

    #[test]
    fn outside_points_take_the_edge() {
        let mut plane = Plane::<u8>::new(4, 4);
        plane.samples_mut().fill(9);
        let mut out = [0; 6];
        span(Level::detected(), plane.as_ref(), Line { start: [-3 * ONE, i32::MAX], step: [i32::MAX, i32::MIN] }, &mut out);
        assert_eq!(out, [9; 6]);
    }

    #[test]
    fn a_single_pixel_may_have_any_step() {
        let mut plane = Plane::<u8>::new(4, 4);
        plane.samples_mut().fill(9);
        let mut out = [0; 1];
        span(Level::detected(), plane.as_ref(), Line { start: [ONE, ONE], step: [i32::MAX, i32::MIN] }, &mut out);
        assert_eq!(out, [9]);
    }

    #[test]
    fn inside_and_edge_paths_agree() {
        let mut plane = Plane::<u8>::new(24, 9);
        for (i, s) in plane.samples_mut().iter_mut().enumerate() {
            *s = (i.wrapping_mul(2_654_435_761) >> 11) as u8;
        }
        let line = Line { start: [70_001, 61_234], step: [65_000, 13_001] };
        let mut whole = [0; 30];
        span(Level::detected(), plane.as_ref(), line, &mut whole);
        for i in 0..21 {
            let mut one = [0; 1];
            let start = [line.start[0] + i * line.step[0], line.start[1] + i * line.step[1]];
            span(Level::detected(), plane.as_ref(), Line { start, step: [0, 0] }, &mut one);
            assert_eq!(one[0], whole[i as usize], "pixel {i}");
        }
    }
}
