//! Bilinear sampling along a straight line: the warp's one pixel loop.

#[cfg(target_arch = "x86_64")]
mod avx2;

use super::Level;
use crate::image::PlaneRef;

/// A line through a plane in 16.16 fixed point: the point of the first output pixel and the step to each next.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Line {
    /// First point (x, y).
    pub start: [i32; 2],
    /// Step (x, y).
    pub step: [i32; 2],
}

/// One in 16.16.
pub const ONE: i32 = 1 << 16;

/// A line and where its pixels end in a row of output; they begin where the span before ends.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Span {
    /// From the span's first pixel on.
    pub line: Line,
    /// Column after its last pixel.
    pub end: usize,
}

/// Draws a row of output from one span after the other, bilinear with weights of 1/256, rounded to nearest. Points outside the
/// plane take its nearest edge. Spans that end beyond `out` are cut.
pub fn row(level: Level, plane: PlaneRef<'_>, spans: &[Span], out: &mut [u8]) {
    if plane.width() == 0 || plane.height() == 0 {
        return;
    }
    #[cfg(target_arch = "x86_64")]
    if level.has_avx2() {
        // SAFETY: a `Level` says AVX2 only where the processor was found to have it.
        return unsafe { row_avx2(plane, spans, out) };
    }
    let _ = level;
    let mut x = 0;
    for span in spans {
        let end = span.end.min(out.len());
        if end > x {
            scalar(plane, span.line, &mut out[x..end], 0);
            x = end;
        }
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn row_avx2(plane: PlaneRef<'_>, spans: &[Span], out: &mut [u8]) {
    let mut x = 0;
    for span in spans {
        let end = span.end.min(out.len());
        if end > x {
            let out = &mut out[x..end];
            let done = if is_inside(plane, span.line, out.len()) { avx2::inside(plane, span.line, out) } else { 0 };
            scalar(plane, span.line, out, done);
            x = end;
        }
    }
}

/// Whether every point of a line of `count` pixels has all four neighbours in the plane.
#[inline(always)]
fn is_inside(plane: PlaneRef<'_>, line: Line, count: usize) -> bool {
    let last = count as i64 - 1;
    let within = |start: i32, step: i32, size: usize| {
        let (end, limit) = (i64::from(start) + i64::from(step) * last, (size as i64 - 1) << 16);
        start >= 0 && i64::from(start) < limit && end >= 0 && end < limit
    };
    within(line.start[0], line.step[0], plane.width()) && within(line.start[1], line.step[1], plane.height())
}

/// Draws the pixels of `out` from `first` on along `line`.
#[inline(always)]
fn scalar(plane: PlaneRef<'_>, line: Line, out: &mut [u8], first: usize) {
    let (w, h) = (plane.width() as i32, plane.height() as i32);
    let along = |axis: usize| line.start[axis].saturating_add(line.step[axis].saturating_mul(first as i32));
    let [mut x, mut y] = [along(0), along(1)];
    if is_inside(plane, line, out.len()) {
        let (samples, stride) = (plane.samples(), plane.stride());
        for out in &mut out[first..] {
            let at = (y >> 16) as usize * stride + (x >> 16) as usize;
            let pixel = &samples[at..at + stride + 2];
            *out = blend([pixel[0], pixel[1], pixel[stride], pixel[stride + 1]], x, y);
            x += line.step[0];
            y += line.step[1];
        }
        return;
    }
    for out in &mut out[first..] {
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
    use proptest::prelude::*;

    fn span(level: Level, plane: PlaneRef<'_>, line: Line, out: &mut [u8]) {
        row(level, plane, &[Span { line, end: out.len() }], out);
    }

    #[test]
    fn whole_steps_copy_and_halves_average() {
        let mut plane = Plane::<u8>::new(5, 3);
        for (i, s) in plane.samples_mut().iter_mut().enumerate() {
            *s = (i * 16) as u8;
        }
        for level in Level::all() {
            let mut out = [0; 5];
            span(level, plane.as_ref(), Line { start: [0, ONE], step: [ONE, 0] }, &mut out);
            assert_eq!(out, [80, 96, 112, 128, 144]);
            span(level, plane.as_ref(), Line { start: [ONE / 2, ONE], step: [ONE, 0] }, &mut out[..4]);
            assert_eq!(out[..4], [88, 104, 120, 136]);
        }
    }

    #[test]
    fn outside_points_take_the_edge() {
        let mut plane = Plane::<u8>::new(4, 4);
        plane.samples_mut().fill(9);
        for level in Level::all() {
            let mut out = [0; 16];
            span(level, plane.as_ref(), Line { start: [-3 * ONE, i32::MAX], step: [i32::MAX, i32::MIN] }, &mut out);
            assert_eq!(out, [9; 16]);
        }
    }

    proptest! {
        /// Every level gives the bits of the definition, pixel by pixel, and touches nothing past the row's end.
        #[test]
        fn every_level_agrees_with_the_definition(
            (w, h) in (1usize..40, 1usize..12),
            padding in 0usize..3,
            start in prop::array::uniform2(-4 * ONE..44 * ONE),
            step in prop::array::uniform2(-2 * ONE..2 * ONE),
            ends in prop::collection::vec(1usize..30, 1..4),
            seed in any::<u32>(),
        ) {
            let stride = w + padding;
            let data: Vec<u8> = (0..(h - 1) * stride + w).map(|i| (i as u32).wrapping_mul(seed | 1).rotate_right(9) as u8).collect();
            let plane = PlaneRef::new(&data, w, h, stride).unwrap();
            let mut spans = Vec::new();
            for count in ends {
                let end = spans.last().map_or(0, |span: &Span| span.end) + count;
                spans.push(Span { line: Line { start: [start[0] / 3, start[1] / 5], step }, end });
            }
            let width = spans.last().map_or(0, |span| span.end);
            let mut wanted = vec![0xAA; width + 9];
            let mut x = 0;
            for span in &spans {
                for i in 0..span.end - x {
                    let at = |axis: usize| span.line.start[axis] + span.line.step[axis] * i as i32;
                    let (px, py) = (at(0).clamp(0, (w as i32 - 1) << 16), at(1).clamp(0, (h as i32 - 1) << 16));
                    let sample = |dx: usize, dy: usize| {
                        data[((py >> 16) as usize + dy).min(h - 1) * stride + ((px >> 16) as usize + dx).min(w - 1)]
                    };
                    wanted[x + i] = blend([sample(0, 0), sample(1, 0), sample(0, 1), sample(1, 1)], px, py);
                }
                x = span.end;
            }
            for level in Level::all() {
                let mut out = vec![0xAA; width + 9];
                row(level, plane, &spans, &mut out[..width]);
                prop_assert_eq!(&out, &wanted, "{}", level.name());
            }
        }
    }
}
