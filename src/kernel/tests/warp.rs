//! The warp at the edges of memory.

use super::{Edge, Fenced, MAX, Random, Shape};
use crate::kernel::Level;
use crate::kernel::warp::{
    Axis, Between, Cells, FURTHEST, Filter, Lens, Mesh, ONE, Outside, RowTable, TABLE, lines, nodes, row, rows,
};

/// Starts and steps at which fixed point or the limits of a fast path end.
const EXTREMES: [i32; 16] = [
    i32::MIN,
    i32::MIN + 1,
    -FURTHEST,
    -(8 * ONE),
    -ONE,
    -(ONE / 8),
    -1,
    0,
    1,
    ONE / 8,
    ONE,
    7 << 14,
    8 * ONE,
    FURTHEST,
    i32::MAX - 1,
    i32::MAX,
];

/// One coordinate of a line of `wide` pixels along an axis of `size` samples, its step from `steps`: somewhere across the plane, right
/// at the first or last place that still has all its neighbours, or extreme.
fn line(random: &mut Random, size: usize, wide: usize, steps: [i32; 2], reach: i32) -> (i32, i32) {
    let step = random.between(steps[0].into(), steps[1].into());
    let way = step * (wide as i64 - 1);
    let first = i64::from(reach * ONE);
    let last = ((size as i64 - 1) << 16) - first;
    let near = random.between(-200, 200);
    let start = match random.below(6) {
        // from the first place on, or down to it
        0 => first + near - way.min(0),
        // up to the last place, or on from it
        1 | 2 => last + near - way.max(0),
        3 | 4 => random.between(i64::from(-ONE), last.max(0) + i64::from(ONE)),
        _ => return (random.of(&EXTREMES), random.of(&EXTREMES)),
    };
    (start as i32, step as i32)
}

/// Draws a row at every level in fenced memory, of one plane and of two, and compares.
#[test]
fn rows_stay_in_their_slices() {
    const CELLS: [usize; 3] = [1, 2, 33];
    let mut random = Random::new(1);
    let room = || Fenced::new((MAX + 4) * (MAX + 4));
    let (mut samples, mut others, mut out, mut beside) = (room(), room(), Fenced::new(33 * 64), Fenced::new(33 * 64));
    let mut numbers: [Fenced<i32>; 4] = std::array::from_fn(|_| Fenced::new(33));
    for (n, shape) in Shape::all().enumerate() {
        let plane = shape.plane(&mut samples, &mut random);
        // now and then of another shape
        let height = if n % 5 == 0 { 1 } else { shape.height };
        let other = Shape { height, ..shape }.plane(&mut others, &mut random);
        for k in 0..12 {
            let filter = [Filter::Bilinear, Filter::Bicubic][k % 2];
            let outside = [Outside::Mirror, Outside::Value(77)][k / 2 % 2];
            let wide = [16, 16, 32, 64, 5][(n + k) % 5];
            let count = if k == 0 { CELLS[2] } else { random.of(&CELLS[..2]) };
            let reach = i32::from(filter == Filter::Bicubic);
            let (mut from, mut longest) = ([(0, 0); 2], [0, 0]);
            for (axis, size) in [shape.width, shape.height].into_iter().enumerate() {
                // what fits into the plane, now and then; never much more than the fast paths take
                let fits = ((size as i32) << 16) / wide as i32;
                longest[axis] = [fits.min(7 << 14), (7 << 14) + 1][usize::from(random.below(8) == 0)];
                let steps = [[0, longest[0]], [-(ONE / 8), ONE / 8]][axis];
                from[axis] = line(&mut random, size, wide, steps, reach);
            }
            let [(x, dx), (y, dy)] = from;
            // the same line in each cell, so that each lies as near to the plane's edges as the first
            let [xs, ys, dxs, dys] = numbers.each_mut().map(|room| &mut *room);
            let cells = Cells {
                start: [xs.filled(Edge::End, count, |_| x), ys.filled(Edge::End, count, |_| y)],
                step: [dxs.filled(Edge::End, count, |_| dx), dys.filled(Edge::End, count, |_| dy)],
                wide,
                outside,
                filter,
            };
            let len = count * wide - random.of(&[0, 0, 1, 15]).min(wide - 1);
            let mut first: Option<Vec<u8>> = None;
            for level in Level::all() {
                let drawn = out.filled(shape.edge, len, |_| 0xaa);
                row(level, plane, cells, drawn);
                assert_eq!(&*drawn, first.get_or_insert_with(|| drawn.to_vec()), "{shape:?} {from:?} {wide} {filter:?}");
            }
            let mut alone = vec![0xaa; len];
            row(Level::SCALAR, other, cells, &mut alone);
            for level in Level::all() {
                let (drawn, second) = (out.filled(shape.edge, len, |_| 0xaa), beside.filled(shape.edge, len, |_| 0xaa));
                rows(level, [plane, other], cells, [&mut *drawn, &mut *second]);
                assert_eq!(Some(&*drawn), first.as_deref(), "{shape:?} {from:?} {wide} {filter:?}");
                assert_eq!(second, alone, "{shape:?} {from:?} {wide} {filter:?}");
            }
        }
    }
}

/// Rows that the 16.16 fixed point of a place can wrap around on, and planes wider and higher than it can say.
#[test]
fn places_that_wrap_around_are_drawn_alike() {
    let mut random = Random::new(2);
    for (width, height) in [(70_000, 3), (3, 40_000), (32_769, 2), (1, 1)] {
        let shape = Shape { width, height, stride: width, edge: Edge::End };
        let mut samples = Fenced::new(shape.len());
        let plane = shape.plane(&mut samples, &mut random);
        for (start, step) in EXTREMES.into_iter().flat_map(|start| EXTREMES.map(|step| (start, step))) {
            for (wide, filter) in [(64, Filter::Bilinear), (64, Filter::Bicubic), (9000, Filter::Bilinear)] {
                let [found, other] = [Level::SCALAR, Level::best()].map(|level| {
                    let mut out = vec![0; wide];
                    let cells =
                        Cells { start: [&[start], &[start]], step: [&[step], &[0]], wide, outside: Outside::Mirror, filter };
                    row(level, plane, cells, &mut out);
                    out
                });
                assert_eq!(found, other, "{width}x{height} {start} {step}");
            }
        }
    }
}

/// A cell without all its numbers is no cell.
#[test]
fn cells_are_as_many_as_have_all_their_numbers() {
    let plane = crate::image::Plane::<u8>::new(40, 40);
    for level in Level::all() {
        for short in 0..4 {
            let numbers: [&[i32]; 4] = std::array::from_fn(|i| &[ONE; 3][..if i == short { 1 } else { 3 }]);
            let cells = Cells {
                start: [numbers[0], numbers[1]],
                step: [numbers[2], numbers[3]],
                wide: 16,
                outside: Outside::Mirror,
                filter: Filter::Bilinear,
            };
            let mut out = [9; 48];
            row(level, plane.as_ref(), cells, &mut out);
            assert!(out[..16].iter().all(|&sample| sample == 0) && out[16..].iter().all(|&sample| sample == 9));
        }
    }
}

/// Nodes of any mesh, and lines between any nodes.
#[test]
fn nodes_and_lines_stay_in_their_slices() {
    let mut random = Random::new(3);
    let mut room: [Fenced<i32>; 4] = std::array::from_fn(|_| Fenced::new(MAX + 1));
    let extremes = [0.0, -0.0, 1.0, -1e-9, 1e30, f64::MIN_POSITIVE, f64::MAX, f64::INFINITY, f64::NEG_INFINITY, f64::NAN];
    for (count, edge) in (1..=MAX).flat_map(|count| [(count, Edge::End), (count, Edge::Start)]) {
        for _ in 0..20 {
            let view = std::array::from_fn(|_| random.of(&extremes));
            let table = |random: &mut Random| std::array::from_fn(|_| [random.of(&extremes) as f32; TABLE]);
            let (base, growth) = (table(&mut random), table(&mut random));
            let [per_row, focal, x, y] = std::array::from_fn(|_| random.of(&extremes) as f32);
            let stretches = random.of(&[0, 1, 24, TABLE, usize::MAX]);
            let rows = RowTable { base, growth, stretches, per_row, focal, centre: [x, y], bend: random.of(&extremes) as f32 };
            let lens = Lens {
                window: std::array::from_fn(|_| random.of(&extremes)),
                centre: [random.of(&extremes), random.of(&extremes)],
                bend: random.of(&extremes),
                kept: random.of(&extremes),
            };
            let mesh = Mesh { view, lens: (count % 3 == 0).then_some(lens), rows: (count % 2 == 0).then_some(rows) };
            let mut first: Option<[Vec<i32>; 2]> = None;
            for level in Level::all() {
                let [above, below, xs, ys] = room.each_mut().map(|room| &mut *room);
                let (xs, ys) = (xs.filled(edge, count, |_| 7), ys.filled(edge, count, |_| 7));
                nodes(level, &mesh, random_row(count), 4, xs, ys);
                let found = [xs.to_vec(), ys.to_vec()];
                assert_eq!(&found, first.get_or_insert_with(|| found.clone()), "{count}");
                let node = |seed: u64| move |i: usize| [FURTHEST, -FURTHEST, 0, ONE][(seed as usize + i * 7) % 4];
                let (above, below) =
                    (above.filled(edge, count, node(count as u64)), below.filled(edge, count, node(count as u64 / 4)));
                for (part, halved) in [(0, false), (16, true), (5, true)] {
                    let axis = Axis { halved, between: halved };
                    let between = Between { above, below, part, part_bits: 4, wide_bits: 4 };
                    lines(level, between, axis, axis, &mut xs[..count - 1], &mut ys[..count]);
                }
            }
        }
    }
}

fn random_row(count: usize) -> f64 {
    Random::new(count as u64).of(&[0.0, 24.0, 1e9, -1e300])
}
