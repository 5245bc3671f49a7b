//! Halving at the edges of memory.

use super::{Fenced, Random, Shape};
use crate::image::PlaneMut;
use crate::kernel::Level;
use crate::kernel::pyramid::halve;

/// Widths around those at which the wide loops take one step more, or begin the next block.
const WIDE: [usize; 12] = [65, 66, 67, 68, 69, 70, 1025, 1026, 1059, 1060, 1061, 1100];

#[test]
fn halving_stays_in_its_planes() {
    let mut random = Random::new(5);
    let (mut samples, mut out) = (Fenced::new(1110 * 9), Fenced::new(560 * 9));
    let wide = WIDE.into_iter().flat_map(|width| [5, 6, 7, 9].into_iter().flat_map(move |height| Shape::of(width, height)));
    for shape in Shape::all().chain(wide) {
        let from = shape.plane(&mut samples, &mut random);
        let half = Shape { width: shape.width / 2, height: shape.height / 2, stride: shape.stride / 2, ..shape };
        let mut first: Option<Vec<u8>> = None;
        for level in Level::all() {
            let to = out.filled(shape.edge, half.len(), |_| 0xaa);
            halve(level, from, PlaneMut::new(to, half.width, half.height, half.stride).unwrap());
            assert_eq!(&*to, first.get_or_insert_with(|| to.to_vec()), "{shape:?}");
        }
    }
}
