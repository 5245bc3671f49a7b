//! Lucas-Kanade patches at the edges of memory.

use super::{Fenced, MAX, Random, Shape};
use crate::image::PlaneRef;
use crate::kernel::Level;
use crate::kernel::lk::{Step, Template, expect};

/// Places that are no places, or as far off as a number can say.
const EXTREMES: [f32; 14] = [
    f32::NAN,
    f32::INFINITY,
    f32::NEG_INFINITY,
    f32::MAX,
    f32::MIN,
    i32::MAX as f32,
    i32::MIN as f32,
    9.3e18,
    -9.3e18,
    1e6,
    -1e6,
    -0.0,
    -1e-10,
    f32::MIN_POSITIVE,
];

/// A place along an axis of `size` samples: where a patch of `side` just fits, or hangs over by a pixel or less, or anywhere.
fn place(random: &mut Random, size: usize, side: usize) -> f32 {
    let (half, size) = ((side as f32 + 1.0) / 2.0, size as f32);
    let part = random.between(-64, 64) as f32 / 64.0;
    match random.below(8) {
        0 | 1 => half + part,
        2 | 3 => size - 1.0 - half + part,
        4..7 => random.between(-30, 70) as f32 + part,
        _ => random.of(&EXTREMES),
    }
}

/// Takes and compares a patch at every level; all find the same.
fn levels_agree<const N: usize>(random: &mut Random, from: PlaneRef<'_>, to: PlaneRef<'_>, templates: &mut [Template<N>; 2]) {
    let [at, there] = [0, 1].map(|_| [from.width(), from.height()].map(|size| place(random, size, N)));
    expect(from, at, N);
    let bits = |step: Step, template: &Template<N>| {
        let numbers = step.rhs.into_iter().chain([step.sum, step.square]).chain(template.gauss_newton).chain(template.centroid);
        numbers.map(f32::to_bits).collect::<Vec<_>>()
    };
    let mut found = Level::all().zip(templates).map(|(level, template)| {
        template.extract(level, from, at);
        bits(template.compare(level, to, there), template)
    });
    let first = found.next().expect("the plain level");
    found.for_each(|other| assert_eq!(first, other, "{N}: {at:?} {there:?} in {}x{}", from.width(), from.height()));
}

#[test]
fn patches_stay_in_their_planes() {
    let mut random = Random::new(4);
    let room = || Fenced::new((MAX + 4) * (MAX + 4));
    let (mut from, mut to) = (room(), room());
    let (mut small, mut usual, mut large): ([Template<8>; 2], [Template<16>; 2], [Template<24>; 2]) = Default::default();
    for shape in Shape::all() {
        let from = shape.plane(&mut from, &mut random);
        let to = shape.plane(&mut to, &mut random);
        for _ in 0..3 {
            levels_agree(&mut random, from, to, &mut small);
            levels_agree(&mut random, from, to, &mut usual);
            levels_agree(&mut random, from, to, &mut large);
        }
    }
}

#[test]
fn a_plane_without_samples_shows_nothing() {
    let (empty, place) = (PlaneRef::new(&[], 0, 0, 0).unwrap(), [3.0, 3.0]);
    for level in Level::all() {
        let mut template = Template::<16>::default();
        expect(empty, place, 16);
        template.extract(level, empty, place);
        assert_eq!(template.compare(level, empty, place), Step::default());
    }
}

#[test]
fn places_to_be_expected_may_be_anywhere() {
    let plane = crate::image::Plane::<u8>::new(9, 9);
    for (x, y) in EXTREMES.into_iter().flat_map(|x| EXTREMES.map(|y| (x, y))) {
        for side in [0, 8, 24, usize::MAX / 2] {
            expect(plane.as_ref(), [x, y], side);
        }
    }
}
