//! The patch's loops, plain: the law.

use super::{Compared, EIGHTH, HALF, MIDDLE, Moments, Pixels, Projection, SCRATCH, STEEPEST, Slopes, Window, share};
use crate::kernel::{Level, dispatch};

/// Values of a row of `count` places, 1/128 grey level, between two rows of samples.
#[inline(always)]
fn row(window: Window<'_>, y: usize, count: usize, out: &mut [i16; SCRATCH]) {
    let above = &window.samples[y * window.stride..][..count + 1];
    let below = &window.samples[(y + 1) * window.stride..][..count + 1];
    let between = |samples: &[u8], x: usize| {
        let (a, b) = (i16::from(samples[x]), i16::from(samples[x + 1]));
        (a << 7) + share((b - a) << 7, window.x)
    };
    for x in 0..count {
        let (top, bottom) = (between(above, x), between(below, x));
        out[x] = top + share(bottom - top, window.y);
    }
}

pub(super) fn sample<const N: usize>(level: Level, pixels: &mut Pixels<N>, window: Window<'_>) -> Moments {
    dispatch!(level, [const N: usize] sample_body::<N>(pixels: &mut Pixels<N>, window: Window<'_>) -> Moments)
}

#[inline(always)]
fn sample_body<const N: usize>(pixels: &mut Pixels<N>, window: Window<'_>) -> Moments {
    let mut wide = [[0i16; SCRATCH]; SCRATCH];
    for (y, out) in wide.iter_mut().enumerate().take(N + 2) {
        row(window, y, N + 2, out);
    }
    let mut moments = Moments::default();
    for y in 0..N {
        let (above, here, below) = (&wide[y][1..=N], &wide[y + 1][..N + 2], &wide[y + 2][1..=N]);
        let (values, [dx, dy]) = (&mut pixels.value[y], pixels.descent.each_mut().map(|d| &mut d[y]));
        for x in 0..N {
            values[x] = here[x + 1];
            dx[x] = share(here[x + 2] - here[x], EIGHTH);
            dy[x] = share(below[x] - above[x], EIGHTH);
        }
        // a row's sums fit into 32 bits
        let (mut value, mut square, mut gradient, mut product) = (0i32, 0i32, [0i32; 2], [0i32; 2]);
        for x in 0..N {
            let less = i32::from(share(values[x] - MIDDLE, EIGHTH));
            value += less;
            square += less * less;
            gradient[0] += i32::from(dx[x]);
            gradient[1] += i32::from(dy[x]);
            product[0] += less * i32::from(dx[x]);
            product[1] += less * i32::from(dy[x]);
        }
        moments.value += i64::from(value);
        moments.square += i64::from(square);
        for i in 0..2 {
            moments.gradient[i] += i64::from(gradient[i]);
            moments.product[i] += i64::from(product[i]);
        }
    }
    moments
}

pub(super) fn project<const N: usize>(level: Level, pixels: &mut Pixels<N>, projection: Projection) -> Slopes {
    dispatch!(level, [const N: usize] project_body::<N>(pixels: &mut Pixels<N>, projection: Projection) -> Slopes)
}

#[inline(always)]
fn project_body<const N: usize>(pixels: &mut Pixels<N>, projection: Projection) -> Slopes {
    let mut slopes = Slopes::default();
    for y in 0..N {
        let (values, [dx, dy]) = (&pixels.value[y], pixels.descent.each_mut().map(|d| &mut d[y]));
        for (descent, (mean, along)) in [&mut *dx, &mut *dy].into_iter().zip(projection.mean.into_iter().zip(projection.along))
        {
            for x in 0..N {
                let value = values[x].saturating_sub(projection.value);
                let rest = descent[x].saturating_sub(mean).saturating_sub(share(value, along));
                descent[x] = rest.clamp(-STEEPEST, STEEPEST);
            }
        }
        // a row's sums fit into 32 bits
        let (mut sum, mut product, mut across, mut slope) = ([0i32; 2], [0i32; 3], 0i32, 0i32);
        for x in 0..N {
            sum[0] += i32::from(dx[x]);
            sum[1] += i32::from(dy[x]);
            let (half_x, half_y) = (i32::from(share(dx[x], HALF)), i32::from(share(dy[x], HALF)));
            product[0] += half_x * half_x;
            product[1] += half_x * half_y;
            product[2] += half_y * half_y;
            let square = half_x * half_x + half_y * half_y;
            across += square * (x as i32 - N as i32 / 2);
            slope += square;
        }
        (0..2).for_each(|i| slopes.sum[i] += i64::from(sum[i]));
        (0..3).for_each(|i| slopes.product[i] += i64::from(product[i]));
        slopes.moment[0] += i64::from(across);
        slopes.moment[1] += i64::from(slope) * (y as i64 - N as i64 / 2);
    }
    slopes
}

pub(super) fn compare<const N: usize>(level: Level, pixels: &Pixels<N>, window: Window<'_>) -> Compared {
    dispatch!(level, [const N: usize] compare_body::<N>(pixels: &Pixels<N>, window: Window<'_>) -> Compared)
}

#[inline(always)]
fn compare_body<const N: usize>(pixels: &Pixels<N>, window: Window<'_>) -> Compared {
    let (mut rhs, mut sum, mut square) = ([0i64; 2], 0i64, 0i64);
    let mut here = [0i16; SCRATCH];
    for y in 0..N {
        row(window, y, N, &mut here);
        let (value, dx, dy) = (&pixels.value[y], &pixels.descent[0][y], &pixels.descent[1][y]);
        // a row's sums fit into 32 bits
        let (mut row_rhs, mut row_sum, mut row_square) = ([0i32; 2], 0i32, 0i32);
        for x in 0..N {
            let difference = i32::from(share(here[x] - value[x], EIGHTH));
            row_rhs[0] += difference * i32::from(dx[x]);
            row_rhs[1] += difference * i32::from(dy[x]);
            row_sum += difference;
            row_square += difference * difference;
        }
        rhs = [rhs[0] + i64::from(row_rhs[0]), rhs[1] + i64::from(row_rhs[1])];
        sum += i64::from(row_sum);
        square += i64::from(row_square);
    }
    Compared { rhs, sum, square }
}
