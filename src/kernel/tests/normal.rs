//! Sums for normal equations at the edges of memory.

use super::{Edge, Fenced, MAX, Random};
use crate::kernel::Level;
use crate::kernel::normal::{BROAD, CURVE, Measurements, POINTS, Sums, WIDE, add, evaluate};

fn number(random: &mut Random) -> f64 {
    random.of(&[0.0, -0.0, 1.0, -3.5, 1e-300, 1e300, f64::INFINITY, f64::NAN])
}

/// The bits of numbers; all that are none count as the same.
fn bits(numbers: &[f64]) -> Vec<u64> {
    numbers.iter().map(|number| if number.is_nan() { u64::MAX } else { number.to_bits() }).collect()
}

#[test]
fn sums_stay_in_their_slices() {
    let mut random = Random::new(7);
    let mut scale = Fenced::<f64>::new(MAX);
    let (mut weights, mut rates) = (Fenced::<[f64; POINTS]>::new(MAX), Fenced::<[f64; CURVE]>::new(MAX));
    let (mut paired, mut single) = (Fenced::<[f64; WIDE]>::new(MAX), Fenced::<[f64; BROAD]>::new(MAX));
    let mut predicted = Fenced::<[f64; WIDE]>::new(MAX);
    for (count, edge) in (0..=MAX).flat_map(|count| [(count, Edge::End), (count, Edge::Start)]) {
        let weights = &*weights.filled(edge, count, |_| std::array::from_fn(|_| number(&mut random)));
        let rates = &*rates.filled(edge, count, |_| std::array::from_fn(|_| number(&mut random)));
        let measurements = Measurements {
            scale: scale.filled(edge, count, |_| number(&mut random)),
            weights,
            paired: paired.filled(edge, count, |_| std::array::from_fn(|_| number(&mut random))),
            single: single.filled(edge, count, |_| std::array::from_fn(|_| number(&mut random))),
        };
        let points = [[number(&mut random); 4]; POINTS];
        let mut first: Option<Vec<u64>> = None;
        for level in Level::all() {
            let mut sums = Sums::default();
            add(level, measurements, &mut sums);
            let predicted = predicted.filled(edge, count, |_| [9.0; WIDE]);
            evaluate(level, &points, weights, rates, predicted);
            let found = [sums.paired.as_flattened(), sums.single.as_flattened(), predicted.as_flattened()].map(bits).concat();
            assert_eq!(&found, first.get_or_insert_with(|| found.clone()), "{count}");
        }
    }
}
