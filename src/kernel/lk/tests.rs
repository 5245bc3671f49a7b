//! The patch against its definition in real numbers, and every level against the plain loops, at edges and extremes.

use super::*;
use crate::image::Plane;
use crate::random::Congruential;
use proptest::prelude::*;

/// A plane of waves and noise, or of nothing but extremes.
fn plane(width: usize, height: usize, seed: u64, extreme: bool) -> Plane {
    let mut plane = Plane::<u8>::new(width, height);
    let mut generator = Congruential::new(seed | 1);
    for y in 0..height {
        for (x, out) in plane.row_mut(y).iter_mut().enumerate() {
            let noise = generator.byte();
            *out = if extreme {
                [0, 255][usize::from(noise & 1)]
            } else {
                let wave = (x as f64 * 0.7).sin() + (y as f64 * 0.5 + x as f64 * 0.2).cos();
                (120.0 + 40.0 * wave + f64::from(noise) / 16.0) as u8
            };
        }
    }
    plane
}

fn bits<const N: usize>(template: &Template<N>) -> (Vec<i16>, Vec<u32>) {
    let Template { pixels, rest, gauss_newton, centroid, .. } = template;
    let mut whole = pixels.value.as_flattened().to_vec();
    pixels.descent.iter().for_each(|d| whole.extend(d.as_flattened()));
    (whole, rest.iter().chain(gauss_newton).chain(centroid).map(|f| f.to_bits()).collect())
}

/// Every level against the first.
fn levels_agree<const N: usize>(from: PlaneRef<'_>, to: PlaneRef<'_>, at: [f32; 2], there: [f32; 2]) {
    let mut found = Level::all().map(|level| {
        let mut template = Template::<N>::default();
        template.extract(level, from, at);
        (bits(&template), template.compare(level, to, there))
    });
    let first = found.next().unwrap();
    for other in found {
        assert_eq!(first, other, "{N} {at:?} {there:?}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn every_level_gives_the_same_bits(
        (width, height) in (1usize..70, 1usize..60),
        at in prop::array::uniform2(-20.0f32..80.0),
        off in prop::array::uniform2(-9.0f32..9.0),
        seed: u64,
        extreme: bool,
    ) {
        let (from, to) = (plane(width, height, seed, extreme), plane(width, height, seed ^ 77, extreme));
        let there = [at[0] + off[0], at[1] + off[1]];
        levels_agree::<8>(from.as_ref(), to.as_ref(), at, there);
        levels_agree::<16>(from.as_ref(), to.as_ref(), at, there);
        levels_agree::<24>(from.as_ref(), to.as_ref(), at, there);
    }
}

/// Black against white in the worst patterns: sums are as large as they can be.
#[test]
fn the_largest_sums_are_the_same_at_every_level() {
    for kind in 0..6 {
        let draw = |negative: bool| {
            let mut plane = Plane::<u8>::new(40, 40);
            for y in 0..40 {
                for (x, out) in plane.row_mut(y).iter_mut().enumerate() {
                    let on = [true, x % 2 == 0, x % 4 < 2, (x / 2 + y / 2) % 2 == 0, y % 4 < 2, x < 20][kind];
                    *out = if on != negative { 255 } else { 0 };
                }
            }
            plane
        };
        let (from, to) = (draw(false), draw(true));
        for at in [[19.5, 19.5], [20.0, 19.0], [19.75, 20.25]] {
            levels_agree::<8>(from.as_ref(), to.as_ref(), at, at);
            levels_agree::<16>(from.as_ref(), to.as_ref(), at, at);
            levels_agree::<24>(from.as_ref(), to.as_ref(), at, at);
        }
    }
}

#[test]
fn places_that_are_no_places_are_no_harm() {
    let from = plane(40, 30, 5, false);
    for at in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e30, -1e30] {
        levels_agree::<16>(from.as_ref(), from.as_ref(), [at, 5.0], [3.0, at]);
    }
}

/// In real numbers: samples, gradients, projection and sums, all in double precision.
#[test]
fn whole_numbers_say_what_real_ones_say() {
    const N: usize = 16;
    let (from, to) = (plane(64, 64, 3, false), plane(64, 64, 3, false));
    let sample = |plane: &Plane, x: f64, y: f64| {
        let (u, v) = (x.floor(), y.floor());
        let at = |i: f64, j: f64| f64::from(plane.row((v + j) as usize)[(u + i) as usize]);
        let (fx, fy) = (x - u, y - v);
        (at(0.0, 0.0) * (1.0 - fx) + at(1.0, 0.0) * fx) * (1.0 - fy) + (at(0.0, 1.0) * (1.0 - fx) + at(1.0, 1.0) * fx) * fy
    };
    for (at, there) in [([30.3, 31.8], [30.9, 31.1]), ([20.5, 25.25], [19.0, 25.5]), ([33.0, 33.0], [33.0, 33.0])] {
        let mut template = Template::<N>::default();
        template.extract(Level::SCALAR, from.as_ref(), at.map(|c| c as f32));
        let step = template.compare(Level::SCALAR, to.as_ref(), there.map(|c| c as f32));
        let places: Vec<[f64; 2]> = (0..N * N).map(|i| [(i % N) as f64 - 7.5, (i / N) as f64 - 7.5]).collect();
        let values: Vec<f64> = places.iter().map(|p| sample(&from, at[0] + p[0], at[1] + p[1])).collect();
        let area = (N * N) as f64;
        let mean = values.iter().sum::<f64>() / area;
        let variance: f64 = values.iter().map(|v| (v - mean).powi(2)).sum();
        let descents = [[1.0, 0.0], [0.0, 1.0]].map(|d| {
            let slope = |p: &[f64; 2]| {
                let at = |s: f64| sample(&from, at[0] + p[0] + s * d[0], at[1] + p[1] + s * d[1]);
                0.5 * (at(1.0) - at(-1.0))
            };
            let slopes: Vec<f64> = places.iter().map(slope).collect();
            let middle = slopes.iter().sum::<f64>() / area;
            let along = slopes.iter().zip(&values).map(|(s, v)| s * (v - mean)).sum::<f64>() / variance;
            slopes.iter().zip(&values).map(|(s, v)| s - middle - along * (v - mean)).collect::<Vec<f64>>()
        });
        let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let [dx, dy] = &descents;
        let wanted = [product(dx, dx), product(dx, dy), product(dy, dy)];
        let scale = wanted[0] + wanted[2];
        for (found, wanted) in template.gauss_newton.into_iter().zip(wanted) {
            assert!((f64::from(found) - wanted).abs() < 2e-3 * scale, "{found} for {wanted}");
        }
        let differences: Vec<f64> =
            places.iter().zip(&values).map(|(p, v)| sample(&to, there[0] + p[0], there[1] + p[1]) - v).collect();
        for (found, descent) in step.rhs.into_iter().zip(&descents) {
            // a pixel's worth is `scale`
            assert!((f64::from(found) - product(descent, &differences)).abs() < 1e-3 * scale, "{found}");
        }
        let square = product(&differences, &differences);
        assert!((f64::from(step.square) - square).abs() < 0.01 * square + 1.0, "{} for {square}", step.square);
        assert!((f64::from(step.sum) - differences.iter().sum::<f64>()).abs() < 4.0);
        for axis in 0..2 {
            let moment: f64 = (0..N * N).map(|i| (dx[i] * dx[i] + dy[i] * dy[i]) * places[i][axis]).sum();
            assert!((f64::from(template.centroid[axis]) - moment / scale).abs() < 0.02);
        }
    }
}
