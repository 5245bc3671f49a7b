//! Lucas-Kanade on one square patch: sampling a template, and one Gauss-Newton step of aligning it with another picture.
//!
//! The inverse compositional form: gradients are taken once, of the template. A change of brightness or contrast is projected
//! out of them (the steepest-descent images are made orthogonal to 1 and to the template), so a flickering lamp moves nothing
//! to first order.
//!
//! Whole numbers, so that no order of summing matters. Of a grey level: samples are 1/128, gradients 1/32 (a pixel), differences
//! 1/16; what rounding adds is far below a camera's noise. Places are 1/32768 of a pixel.

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "aarch64")]
mod neon;
mod scalar;
#[cfg(any(target_arch = "x86_64", target_arch = "aarch64"))]
mod wide;

use super::Level;
#[cfg(target_arch = "x86_64")]
use avx2::Avx2 as Native;
#[cfg(target_arch = "aarch64")]
use neon::Neon as Native;
#[cfg(any(target_arch = "x86_64", target_arch = "aarch64"))]
use wide::SIDE;

use crate::image::PlaneRef;

/// A patch of `N` x `N` pixels with what aligning needs. Centred on a point, so offsets run from -(N - 1)/2 to (N - 1)/2.
#[derive(Clone, Debug)]
pub struct Template<const N: usize> {
    pixels: Pixels<N>,
    /// Room for samples at the picture's edge.
    scratch: [[u8; SCRATCH]; SCRATCH],
    /// Mean of each of the steepest-descent images: what rounding leaves of it.
    rest: [f32; 2],
    /// Gauss-Newton matrix (xx, xy, yy) of `descent`, grey levels^2 / pixel^2, summed over the patch.
    pub gauss_newton: [f32; 3],
    /// Centre of the patch's texture (mean offset from the patch's centre, weighted by the squared slope), pixels: where a patch
    /// that is also turned or magnified a little moves as the alignment says.
    pub centroid: [f32; 2],
}

/// The numbers of each pixel.
#[derive(Clone, Debug)]
struct Pixels<const N: usize> {
    /// Samples, 1/128 grey level.
    value: [[i16; N]; N],
    /// Steepest-descent images: gradients less their part along 1 and along `value`, 1/32 grey level a pixel.
    descent: [[[i16; N]; N]; 2],
}

/// Sums of one step: the right-hand side (x, y) and the squared difference after removing the change of brightness.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
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
        let pixels = Pixels { value: [[0; N]; N], descent: [[[0; N]; N]; 2] };
        Self { pixels, scratch: [[0; SCRATCH]; SCRATCH], rest: [0.0; 2], gauss_newton: [0.0; 3], centroid: [0.0; 2] }
    }
}

/// Rows and columns of a scratch patch, large enough for the largest side, its gradients and its interpolation.
const SCRATCH: usize = 24 + 4;

/// Samples around a place: from the top-left one on, rows `stride` apart, and the place between samples, 1/32768 pixel.
#[derive(Clone, Copy)]
struct Window<'a> {
    samples: &'a [u8],
    stride: usize,
    x: i16,
    y: i16,
}

/// The whole number at or below `x`, and what `x` has beyond it (1/32768). What is no number is 0.
#[inline(always)]
fn split(x: f32) -> (isize, i16) {
    let towards_zero = x as i32;
    let whole = if towards_zero as f32 > x { towards_zero.saturating_sub(1) } else { towards_zero };
    (whole as isize, ((x - whole as f32) * 32768.0) as i16)
}

/// Gives `side` + 1 rows of `side` + 1 samples around (`x`, `y`), which lies at or right below the top-left one: of the plane itself
/// where they lie inside, else of a scratch copy whose edges repeat. A plane without samples is black.
#[inline(always)]
fn window<'a>(plane: &'a PlaneRef<'_>, scratch: &'a mut [[u8; SCRATCH]; SCRATCH], [x, y]: [f32; 2], side: usize) -> Window<'a> {
    let ((left, x), (top, y)) = (split(x), split(y));
    let (w, h, n) = (plane.width() as isize, plane.height() as isize, side as isize + 1);
    if left >= 0 && top >= 0 && left + n <= w && top + n <= h {
        let samples = &plane.samples()[top as usize * plane.stride() + left as usize..];
        return Window { samples, stride: plane.stride(), x, y };
    }
    if w == 0 || h == 0 {
        scratch.as_flattened_mut().fill(0);
        return Window { samples: scratch.as_flattened(), stride: SCRATCH, x, y };
    }
    let columns: [usize; SCRATCH] = std::array::from_fn(|i| (left + i as isize).clamp(0, w - 1) as usize);
    let (columns, is_beside) = (&columns[..=side], left < 0 || left + n > w);
    for (j, row) in scratch.iter_mut().enumerate().take(side + 1) {
        let from = plane.row((top + j as isize).clamp(0, h - 1) as usize);
        if is_beside {
            row.iter_mut().zip(columns).for_each(|(sample, &column)| *sample = from[column]);
        } else {
            row[..=side].copy_from_slice(&from[columns[0]..][..=side]);
        }
    }
    Window { samples: scratch.as_flattened(), stride: SCRATCH, x, y }
}

/// Asks for the samples of a patch of `side` around `centre` (x, y) to be brought near: they will be wanted soon.
#[inline]
pub fn expect(plane: PlaneRef<'_>, centre: [f32; 2], side: usize) {
    let first = centre.map(|c| (c as isize).saturating_sub_unsigned(side / 2 + 1).max(0) as usize);
    let last = first[1].saturating_add(side + 3).min(plane.height());
    for y in first[1]..last {
        if let Some(sample) = plane.row(y).get(first[0]) {
            near(sample);
        }
    }
}

#[cfg(target_arch = "x86_64")]
#[inline(always)]
fn near(sample: &u8) {
    use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
    // SAFETY: a hint reads nothing; every x86-64 processor has it.
    unsafe { _mm_prefetch::<_MM_HINT_T0>(std::ptr::from_ref(sample).cast()) }
}

#[cfg(not(target_arch = "x86_64"))]
#[inline(always)]
fn near(_: &u8) {}

/// Sums over a patch: of the values less mid-grey (1/16 grey level) and of their squares, of the gradients (1/32 grey level a pixel)
/// and of their products with the values.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Moments {
    value: i64,
    square: i64,
    gradient: [i64; 2],
    product: [i64; 2],
}

/// What is taken away of a patch's gradients: their mean (1/32 grey level a pixel) and so much (1/8192) of the value less its
/// mean (1/128 grey level).
#[derive(Clone, Copy, Debug, Default)]
struct Projection {
    mean: [i16; 2],
    along: [i16; 2],
    value: i16,
}

/// Sums over the descent images: of each, of their products (xx, xy, yy; 1/256), and of the squared slope (1/256) times the
/// column and the row, counted from N / 2.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Slopes {
    sum: [i64; 2],
    product: [i64; 3],
    moment: [i64; 2],
}

/// Sums of a comparison: descent images times difference (1/512), difference (1/16), its square (1/256).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Compared {
    rhs: [i64; 2],
    sum: i64,
    square: i64,
}

/// Largest gradient less its projection (1/32 grey level a pixel).
const STEEPEST: i16 = 4095;
/// Mid-grey, 1/128.
const MIDDLE: i16 = 128 << 7;

/// Half of the product's upper half, rounded: a * b / 32768.
#[inline(always)]
fn share(a: i16, b: i16) -> i16 {
    ((i32::from(a) * i32::from(b) + (1 << 14)) >> 15) as i16
}

/// From 1/128 to 1/16, or from twice 1/128 to 1/32: an eighth, rounded.
const EIGHTH: i16 = 1 << 12;
/// A half, rounded.
const HALF: i16 = 1 << 14;

impl<const N: usize> Template<N> {
    /// Samples the patch around `centre` (x, y) of `plane` by bilinear interpolation, edges repeated, and prepares its
    /// gradients (central differences).
    #[inline]
    pub fn extract(&mut self, level: Level, plane: PlaneRef<'_>, centre: [f32; 2]) {
        let reach = (N as f32 + 1.0) / 2.0;
        // one sample more on each side than the patch, for the central differences
        let window = window(&plane, &mut self.scratch, centre.map(|c| c - reach), N + 2);
        let moments = self.pixels.sample(level, window);
        let slopes = self.pixels.project(level, moments.projection((N * N) as f32));
        self.rest = slopes.sum.map(|sum| sum as f32 / (32 * N * N) as f32);
        self.gauss_newton = slopes.product.map(|sum| sum as f32 / 256.0);
        // the middle lies half a pixel before N / 2
        let slope = ((slopes.product[0] + slopes.product[2]) as f32).max(256.0);
        self.centroid = slopes.moment.map(|moment| moment as f32 / slope + 0.5);
    }

    /// Compares the template with `plane` around `centre` (x, y): the sums of one Gauss-Newton step.
    #[inline]
    pub fn compare(&mut self, level: Level, plane: PlaneRef<'_>, centre: [f32; 2]) -> Step {
        let reach = (N as f32 - 1.0) / 2.0;
        let window = window(&plane, &mut self.scratch, centre.map(|c| c - reach), N);
        let compared = self.pixels.compare(level, window);
        let sum = compared.sum as f32 / 16.0;
        let rhs = [0, 1].map(|i: usize| compared.rhs[i] as f32 / 512.0 - self.rest[i] * sum);
        Step { rhs, sum, square: compared.square as f32 / 256.0 }
    }
}

impl Moments {
    /// What is to be taken away of the gradients of a patch of `area` pixels.
    #[inline(always)]
    fn projection(&self, area: f32) -> Projection {
        let value = self.value as f32 / area;
        // less than a grey level for the whole patch is no texture
        let variance = (self.square as f32 - self.value as f32 * value).max(256.0);
        let along = [0, 1].map(|i: usize| {
            let together = self.product[i] as f32 - self.gradient[i] as f32 * value;
            // 1/32 a 1/16
            (0.5 * 8192.0 * together / variance).clamp(-32767.0, 32767.0) as i16
        });
        let mean = self.gradient.map(|gradient| (gradient as f32 / area) as i16);
        Projection { mean, along, value: (value * 8.0) as i16 + MIDDLE }
    }
}

impl<const N: usize> Pixels<N> {
    /// Samples values and gradients.
    #[inline(always)]
    fn sample(&mut self, level: Level, window: Window<'_>) -> Moments {
        #[cfg(any(target_arch = "x86_64", target_arch = "aarch64"))]
        if N == SIDE
            && let Some(native) = Native::of(level)
        {
            let (value, [dx, dy]) = (self.value.as_flattened_mut(), self.descent.each_mut().map(|d| d.as_flattened_mut()));
            return native.sample(window, value, dx, dy);
        }
        scalar::sample(level, self, window)
    }

    /// Takes away what a change of brightness or contrast would move.
    #[inline(always)]
    fn project(&mut self, level: Level, projection: Projection) -> Slopes {
        #[cfg(any(target_arch = "x86_64", target_arch = "aarch64"))]
        if N == SIDE
            && let Some(native) = Native::of(level)
        {
            let (value, [dx, dy]) = (self.value.as_flattened(), self.descent.each_mut().map(|d| d.as_flattened_mut()));
            return native.project(projection, value, dx, dy);
        }
        scalar::project(level, self, projection)
    }

    /// Compares with what a window shows.
    #[inline(always)]
    fn compare(&self, level: Level, window: Window<'_>) -> Compared {
        #[cfg(any(target_arch = "x86_64", target_arch = "aarch64"))]
        if N == SIDE
            && let Some(native) = Native::of(level)
        {
            let (value, [dx, dy]) = (self.value.as_flattened(), self.descent.each_ref().map(|d| d.as_flattened()));
            return native.compare(window, value, dx, dy);
        }
        scalar::compare(level, self, window)
    }
}

#[cfg(test)]
mod tests;
