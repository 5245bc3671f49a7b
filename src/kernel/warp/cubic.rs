//! The cubic that goes through four neighbours (R. Keys, "Cubic convolution interpolation for digital image processing", 1981, with
//! a = -1/2, that is Catmull and Rom's): sharper than bilinear, and never dimmer half way between two samples.
//!
//! Weights are found in 1/32768, along rows then taken to 1/112, the most with which four samples' sum fits 16 bits; down columns
//! to what makes 1/64 grey levels of that.

/// What the weights along a row sum up to.
pub(super) const ALONG: i32 = 112;
/// What the weights down a column sum up to: 64 / 112 in 1/32768.
pub(super) const DOWN: i32 = 18_725;

/// The product of two numbers in 1/32768, rounded, as the processor has it.
#[inline(always)]
fn product(a: i32, b: i32) -> i32 {
    (a * b + (1 << 14)) >> 15
}

/// Weights of the four neighbours of a place `t` (1/32768) past the second; they sum up to `sum`.
#[inline(always)]
fn weights(t: i32, sum: i32) -> [i32; 4] {
    let square = product(t, t);
    let cube = product(square, t);
    let first = product(square - ((t + cube + 1) >> 1), sum);
    let third = product(((t >> 1) + 2 * (square - cube) + (cube >> 1)).min(32_767), sum);
    let fourth = product((cube - square) >> 1, sum);
    [first, sum - first - third - fourth, third, fourth]
}

/// Weighs four rows of four neighbours by the fractions of `x` (7 bits of it, then 6 bits of the mean) and `y` (12 bits), both 16.16
/// fixed point.
#[inline(always)]
pub(super) fn blend(rows: [[u8; 4]; 4], x: i32, y: i32) -> u8 {
    let along = weights((x & 0xfe00) >> 1, ALONG);
    let down = weights((y & 0xfff0) >> 1, DOWN);
    let of = |row: [u8; 4]| row.iter().zip(along).map(|(&sample, weight)| i32::from(sample) * weight).sum::<i32>();
    let mean: i32 = rows.into_iter().zip(down).map(|(row, weight)| product(of(row), weight)).sum();
    ((mean + 32) >> 6).clamp(0, 255) as u8
}

#[cfg(test)]
mod tests {
    use super::super::ONE;
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn samples_are_gone_through_and_flat_stays_flat() {
        for grey in 0..=255 {
            let mut rows = [[7, 201, 90, 33]; 4];
            rows[1][1] = grey;
            assert_eq!(blend(rows, 0, 0), grey);
            for (x, y) in (0..ONE).step_by(509).zip((0..ONE).step_by(1021).cycle()) {
                assert_eq!(blend([[grey; 4]; 4], x, y), grey);
            }
        }
    }

    proptest! {
        /// Keys' cubic, but for what the rounded weights leave over.
        #[test]
        fn it_is_the_cubic(rows in any::<[[u8; 4]; 4]>(), fx in 0..ONE, fy in 0..ONE) {
            let part = |f: i32, bits: i32| f64::from(f & bits) / f64::from(ONE);
            let weights = |t: f64| {
                let near = |s: f64| 1.5 * s.powi(3) - 2.5 * s.powi(2) + 1.0;
                let far = |s: f64| -0.5 * s.powi(3) + 2.5 * s.powi(2) - 4.0 * s + 2.0;
                [far(1.0 + t), near(t), near(1.0 - t), far(2.0 - t)]
            };
            let (along, down) = (weights(part(fx, 0xfe00)), weights(part(fy, 0xfff0)));
            let exact: f64 = (0..4).flat_map(|i| (0..4).map(move |j| (i, j)))
                .map(|(i, j)| down[i] * along[j] * f64::from(rows[i][j])).sum();
            let found = f64::from(blend(rows, fx, fy));
            prop_assert!((found - exact.clamp(0.0, 255.0)).abs() <= 2.5, "{found} for {exact}");
        }
    }
}
