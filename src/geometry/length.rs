//! Lengths that are the same to the bit on every machine.

use nalgebra::RealField;

/// `sqrt(x^2 + y^2)`, of nothing but IEEE 754's own operations, each of which rounds alike everywhere. `f64::hypot` is the C library's:
/// glibc's rounds differently on x86-64 and on aarch64 in one value of eight. Squares may overflow or vanish: not for numbers beyond
/// the root of the type's range.
#[inline]
pub fn hypot<T: RealField + Copy>(x: T, y: T) -> T {
    (x * x + y * y).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Within two units in the last place of what the C library finds.
        #[test]
        fn it_is_the_length(x in -1e6..1e6, y in -1e6..1e6) {
            let exact = f64::hypot(x, y);
            prop_assert!((hypot(x, y) - exact).abs() <= 2.0 * f64::EPSILON * exact);
            let single = hypot(x as f32, y as f32);
            prop_assert!((f64::from(single) - exact).abs() <= 4.0 * f64::from(f32::EPSILON) * exact);
        }
    }

    #[test]
    fn what_is_no_number_stays_none() {
        assert!(hypot(f64::NAN, 1.0).is_nan() && hypot(f32::INFINITY, 1.0) == f32::INFINITY);
        assert_eq!(hypot(3.0, -4.0), 5.0);
    }
}
