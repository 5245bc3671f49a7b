//! The search for corners at the edges of memory.

use super::{Fenced, MAX, Random, Shape};
use crate::kernel::Level;
use crate::kernel::corner::strongest;

#[test]
fn searches_stay_in_their_planes() {
    let mut random = Random::new(6);
    let mut samples = Fenced::new((MAX + 4) * (MAX + 4));
    for shape in Shape::all() {
        let plane = shape.plane(&mut samples, &mut random);
        let odd = [random.below(MAX), random.below(MAX)];
        for (from, size) in
            [([0, 0], [usize::MAX; 2]), (odd, [usize::MAX; 2]), ([usize::MAX; 2], odd), ([0, 0], odd), (odd, [1, 1])]
        {
            let mut found = Level::all()
                .map(|level| strongest(level, plane, from, size, f32::NEG_INFINITY, |x, y| !(x + y).is_multiple_of(5)));
            let first = found.next().expect("the plain level");
            found.for_each(|other| assert_eq!(first, other, "{shape:?} {from:?} {size:?}"));
        }
    }
}
