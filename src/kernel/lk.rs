//! Lucas-Kanade on one square patch: sampling a template, and one Gauss-Newton step of aligning it with another picture.
//!
//! The inverse compositional form: gradients are taken once, of the template. A change of brightness or contrast is projected
//! out of them (the steepest-descent images are made orthogonal to 1 and to the template), so a flickering lamp moves nothing
//! to first order.

use super::{Level, dispatch};
use crate::image::PlaneRef;

/// Sides a patch can have, pixels.
pub const SIDES: [usize; 3] = [8, 16, 24];

/// A patch of `N` x `N` pixels with what aligning needs. Centred on a point, so offsets run from -(N - 1)/2 to (N - 1)/2.
#[derive(Clone, Debug)]
pub struct Template<const N: usize> {
    value: [[f32; N]; N],
    /// Steepest-descent images: gradients less their part along 1 and along `value`.
    descent: [[[f32; N]; N]; 2],
    /// Gauss-Newton matrix (xx, xy, yy) of `descent`, grey levels^2 / pixel^2, summed over the patch.
    pub gauss_newton: [f32; 3],
    /// Centre of the patch's texture (mean offset from the patch's centre, weighted by the squared slope), pixels: where a patch
    /// that is also turned or magnified a little moves as the alignment says.
    pub centroid: [f32; 2],
}

/// Sums of one step: the right-hand side (x, y) and the squared difference after removing the change of brightness.
#[derive(Clone, Copy, Debug, Default)]
pub struct Step {
    /// Sum of descent images times difference.
    pub rhs: [f32; 2],
    /// Sum of the difference.
    pub sum: f32,
    /// Sum of the squared difference.
    pub square: f32,
}

impl<const N: usize> Default for Template<N> {
    fn default() -> Self {
        Self { value: [[0.0; N]; N], descent: [[[0.0; N]; N]; 2], gauss_newton: [0.0; 3], centroid: [0.0; 2] }
    }
}

/// Rows and columns of a scratch patch, large enough for the largest side, its gradients and its interpolation.
const SCRATCH: usize = 24 + 4;

/// Where a patch lies in a plane: the whole part of its top-left sample and the four bilinear weights.
struct Place {
    x: isize,
    y: isize,
    weights: [f32; 4],
}

impl Place {
    #[inline(always)]
    fn new(x: f32, y: f32) -> Self {
        let (floor_x, floor_y) = (x.floor(), y.floor());
        let (fx, fy) = (x - floor_x, y - floor_y);
        Self {
            x: floor_x as isize,
            y: floor_y as isize,
            weights: [(1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy],
        }
    }
}

/// Gives `count` + 1 rows of `count` + 1 samples from (`x`, `y`) on: of the plane itself where they lie inside, else of a
/// scratch copy whose edges repeat.
#[inline(always)]
fn window<'a>(
    plane: &'a PlaneRef<'_>,
    scratch: &'a mut [[u8; SCRATCH]; SCRATCH],
    place: &Place,
    count: usize,
) -> (&'a [u8], usize) {
    let (w, h, n) = (plane.width() as isize, plane.height() as isize, count as isize + 1);
    if place.x >= 0 && place.y >= 0 && place.x + n <= w && place.y + n <= h {
        return (&plane.samples()[place.y as usize * plane.stride() + place.x as usize..], plane.stride());
    }
    for (j, row) in scratch.iter_mut().enumerate().take(count + 1) {
        let from = plane.row((place.y.saturating_add(j as isize)).clamp(0, h - 1) as usize);
        for (i, sample) in row.iter_mut().enumerate().take(count + 1) {
            *sample = from[(place.x.saturating_add(i as isize)).clamp(0, w - 1) as usize];
        }
    }
    (scratch.as_flattened(), SCRATCH)
}

#[inline(always)]
fn interpolate<const N: usize>(a: &[u8], b: &[u8], [p, q, r, s]: [f32; 4]) -> [f32; N] {
    let (a0, a1, b0, b1) = (&a[..N], &a[1..=N], &b[..N], &b[1..=N]);
    // a plain loop: a closure would be compiled on its own, without the caller's instruction set
    let mut out = [0.0; N];
    for i in 0..N {
        out[i] = f32::from(a0[i]) * p + f32::from(a1[i]) * q + f32::from(b0[i]) * r + f32::from(b1[i]) * s;
    }
    out
}

#[inline(always)]
fn sum<const N: usize>(lanes: &[f32; N]) -> f32 {
    let mut eight = [0.0f32; 8];
    for part in lanes.chunks_exact(8) {
        for (sum, lane) in eight.iter_mut().zip(part) {
            *sum += lane;
        }
    }
    ((eight[0] + eight[4]) + (eight[2] + eight[6])) + ((eight[1] + eight[5]) + (eight[3] + eight[7]))
}

impl<const N: usize> Template<N> {
    /// Samples the patch around `centre` (x, y) of `plane` by bilinear interpolation, edges repeated, and prepares its
    /// gradients (central differences).
    pub fn take(&mut self, level: Level, plane: PlaneRef<'_>, centre: [f32; 2]) {
        let template = self;
        dispatch!(level, [const N: usize] take_body::<N>(template: &mut Template<N>, plane: PlaneRef<'_>, centre: [f32; 2]))
    }

    /// Compares the template with `plane` around `centre` (x, y): the sums of one Gauss-Newton step.
    pub fn compare(&self, level: Level, plane: PlaneRef<'_>, centre: [f32; 2]) -> Step {
        let template = self;
        dispatch!(level, [const N: usize] compare_body::<N>(template: &Template<N>, plane: PlaneRef<'_>, centre: [f32; 2]) -> Step)
    }
}

#[inline(always)]
fn take_body<const N: usize>(template: &mut Template<N>, plane: PlaneRef<'_>, centre: [f32; 2]) {
    let reach = (N as f32 + 1.0) / 2.0;
    let place = Place::new(centre[0] - reach, centre[1] - reach);
    let mut scratch = [[0u8; SCRATCH]; SCRATCH];
    let (samples, stride) = window(&plane, &mut scratch, &place, N + 2);
    // one sample more on each side than the patch, for the central differences
    let mut wide = [[0.0f32; SCRATCH]; SCRATCH];
    for (y, out) in wide.iter_mut().enumerate().take(N + 2) {
        let (a, b) = (&samples[y * stride..], &samples[(y + 1) * stride..]);
        let (left, right) = (interpolate::<N>(a, b, place.weights), interpolate::<N>(&a[2..], &b[2..], place.weights));
        out[..N].copy_from_slice(&left);
        out[2..N + 2].copy_from_slice(&right);
    }
    let (mut sums, mut dots, mut square) = ([[0.0f32; N]; 3], [[0.0f32; N]; 2], [0.0f32; N]);
    for y in 0..N {
        let (above, here, below) = (&wide[y][1..=N], &wide[y + 1][..N + 2], &wide[y + 2][1..=N]);
        for x in 0..N {
            let value = here[x + 1];
            let gradient = [0.5 * (here[x + 2] - here[x]), 0.5 * (below[x] - above[x])];
            template.value[y][x] = value;
            template.descent[0][y][x] = gradient[0];
            template.descent[1][y][x] = gradient[1];
            sums[0][x] += value;
            sums[1][x] += gradient[0];
            sums[2][x] += gradient[1];
            square[x] += value * value;
            dots[0][x] += value * gradient[0];
            dots[1][x] += value * gradient[1];
        }
    }
    let area = (N * N) as f32;
    let [mean, mean_x, mean_y] = [sum(&sums[0]) / area, sum(&sums[1]) / area, sum(&sums[2]) / area];
    let variance = (sum(&square) - area * mean * mean).max(1.0);
    let along = [(sum(&dots[0]) - area * mean * mean_x) / variance, (sum(&dots[1]) - area * mean * mean_y) / variance];
    let mut gn = [[0.0f32; N]; 3];
    let mut moments = [[0.0f32; N]; 2];
    let half = (N as f32 - 1.0) / 2.0;
    for y in 0..N {
        let down = y as f32 - half;
        for x in 0..N {
            let value = template.value[y][x] - mean;
            let gx = template.descent[0][y][x] - mean_x - along[0] * value;
            let gy = template.descent[1][y][x] - mean_y - along[1] * value;
            template.value[y][x] = value;
            template.descent[0][y][x] = gx;
            template.descent[1][y][x] = gy;
            gn[0][x] += gx * gx;
            gn[1][x] += gx * gy;
            gn[2][x] += gy * gy;
            let slope = gx * gx + gy * gy;
            moments[0][x] += slope * (x as f32 - half);
            moments[1][x] += slope * down;
        }
    }
    template.gauss_newton = [sum(&gn[0]), sum(&gn[1]), sum(&gn[2])];
    let slope = (template.gauss_newton[0] + template.gauss_newton[2]).max(1.0);
    template.centroid = [sum(&moments[0]) / slope, sum(&moments[1]) / slope];
}

#[inline(always)]
fn compare_body<const N: usize>(template: &Template<N>, plane: PlaneRef<'_>, centre: [f32; 2]) -> Step {
    let reach = (N as f32 - 1.0) / 2.0;
    let place = Place::new(centre[0] - reach, centre[1] - reach);
    let mut scratch = [[0u8; SCRATCH]; SCRATCH];
    let (samples, stride) = window(&plane, &mut scratch, &place, N);
    let (mut rhs, mut total, mut square) = ([[0.0f32; N]; 2], [0.0f32; N], [0.0f32; N]);
    for y in 0..N {
        let (value, dx, dy) = (&template.value[y], &template.descent[0][y], &template.descent[1][y]);
        let here = interpolate::<N>(&samples[y * stride..], &samples[(y + 1) * stride..], place.weights);
        for x in 0..N {
            let difference = here[x] - value[x];
            rhs[0][x] += dx[x] * difference;
            rhs[1][x] += dy[x] * difference;
            total[x] += difference;
            square[x] += difference * difference;
        }
    }
    Step { rhs: [sum(&rhs[0]), sum(&rhs[1])], sum: sum(&total), square: sum(&square) }
}
