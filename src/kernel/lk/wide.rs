//! The patch's loops by whole rows of sixteen pixels, for the instruction sets that hold one: the same bits as the plain loops.
//!
//! Nothing overflows: each of at least four partial sums of a row's products, over sixteen rows, stays below 2^31 for the largest values
//! there are (differences 4080, descent images 4095, gradients 4080, values 2048 from mid-grey). So does all of a patch where
//! [`Wide::totals`] are taken; elsewhere it may need more than 32 bits.
//!
//! All here is compiled for the instruction set that calls it: it is inlined into functions that have been told of it. No closures:
//! those might stay functions of their own, without it.

use super::{Compared, EIGHTH, HALF, MIDDLE, Moments, Projection, STEEPEST, Slopes, Window};

/// The patch's side.
pub(super) const SIDE: usize = 16;

/// What the loops need of an instruction set. Holding a value is the proof that the processor has it.
pub(super) trait Wide: Copy {
    /// Sixteen numbers of 16 bits.
    type Row: Copy;
    /// Partial sums of products, 32 bits each.
    type Sums: Copy;

    /// A row of one number.
    fn all(self, number: i16) -> Self::Row;
    /// A row from memory.
    fn load(self, numbers: &[i16; SIDE]) -> Self::Row;
    /// A row to memory.
    fn store(self, row: Self::Row, to: &mut [i16; SIDE]);
    /// Sixteen samples, 1/128 grey level.
    ///
    /// # Safety
    /// There are sixteen bytes at `at`.
    unsafe fn samples(self, at: *const u8) -> Self::Row;
    /// `a + b`.
    fn plus(self, a: Self::Row, b: Self::Row) -> Self::Row;
    /// `a - b`.
    fn less(self, a: Self::Row, b: Self::Row) -> Self::Row;
    /// `a - b`, or the nearest that 16 bits can say.
    fn less_saturating(self, a: Self::Row, b: Self::Row) -> Self::Row;
    /// `a * b / 32768`, rounded as [`super::share`] does. Not for both -32768.
    fn share(self, a: Self::Row, b: Self::Row) -> Self::Row;
    /// `a * b`, its lower 16 bits.
    fn times(self, a: Self::Row, b: Self::Row) -> Self::Row;
    /// What lies beyond `least` or `most` becomes that.
    fn clamp(self, row: Self::Row, least: Self::Row, most: Self::Row) -> Self::Row;

    /// Sums of nothing.
    fn none(self) -> Self::Sums;
    /// Adds the products of two rows.
    fn add(self, sums: &mut Self::Sums, a: Self::Row, b: Self::Row);
    /// Adds a row.
    fn add_row(self, sums: &mut Self::Sums, row: Self::Row);
    /// Totals that fit 32 bits.
    fn totals(self, sums: [Self::Sums; 4]) -> [i64; 4];
    /// Totals that need not fit 32 bits.
    fn wide_totals(self, sums: [Self::Sums; 2]) -> [i64; 2];
}

/// `from` and a share of the way to `to`.
#[inline(always)]
fn between<W: Wide>(wide: W, from: W::Row, to: W::Row, part: W::Row) -> W::Row {
    wide.plus(from, wide.share(wide.less(to, from), part))
}

/// The window has that many rows of that many samples.
#[inline(always)]
fn check(window: Window<'_>, rows: usize, columns: usize) {
    assert!(window.samples.len() >= (rows - 1) * window.stride + columns, "a window of a patch is whole");
}

/// The rows of a patch.
#[inline(always)]
fn rows(numbers: &[i16]) -> &[[i16; SIDE]] {
    &numbers.as_chunks().0[..SIDE]
}

#[inline(always)]
fn rows_mut(numbers: &mut [i16]) -> &mut [[i16; SIDE]] {
    &mut numbers.as_chunks_mut().0[..SIDE]
}

/// Sixteen columns of a row between samples, from the window's column 0, 1 and 2 on.
///
/// # Safety
/// The window has nineteen samples in row `y`.
#[inline(always)]
unsafe fn three_columns<W: Wide>(wide: W, window: Window<'_>, y: usize, part: W::Row) -> [W::Row; 3] {
    // SAFETY: sixteen bytes from column 3 on are the last that are read: the caller's promise.
    let [a, b, c, d] = unsafe {
        let at = window.samples.as_ptr().add(y * window.stride);
        [wide.samples(at), wide.samples(at.add(1)), wide.samples(at.add(2)), wide.samples(at.add(3))]
    };
    [between(wide, a, b, part), between(wide, b, c, part), between(wide, c, d, part)]
}

/// Between two rows of those.
#[inline(always)]
fn three_between<W: Wide>(wide: W, from: [W::Row; 3], to: [W::Row; 3], part: W::Row) -> [W::Row; 3] {
    [between(wide, from[0], to[0], part), between(wide, from[1], to[1], part), between(wide, from[2], to[2], part)]
}

/// As [`super::scalar::sample`].
#[inline(always)]
pub(super) fn sample<W: Wide>(wide: W, window: Window<'_>, value: &mut [i16], dx: &mut [i16], dy: &mut [i16]) -> Moments {
    check(window, SIDE + 3, SIDE + 3);
    let (value, dx, dy) = (rows_mut(value), rows_mut(dx), rows_mut(dy));
    let (fx, fy, eighth, middle) = (wide.all(window.x), wide.all(window.y), wide.all(EIGHTH), wide.all(MIDDLE));
    let [mut values, mut squares, mut gradient_x, mut gradient_y, mut product_x, mut product_y] = [wide.none(); 6];
    // SAFETY: `check` said that there are so many samples in so many rows; here and below.
    let [first, second, mut samples] =
        unsafe { [three_columns(wide, window, 0, fx), three_columns(wide, window, 1, fx), three_columns(wide, window, 2, fx)] };
    let mut above = between(wide, first[1], second[1], fy);
    let mut here = three_between(wide, second, samples, fy);
    for y in 0..SIDE {
        // SAFETY: as above.
        let next = unsafe { three_columns(wide, window, y + 3, fx) };
        let below = three_between(wide, samples, next, fy);
        let [left, at, right] = here;
        let slope_x = wide.share(wide.less(right, left), eighth);
        let slope_y = wide.share(wide.less(below[1], above), eighth);
        wide.store(at, &mut value[y]);
        wide.store(slope_x, &mut dx[y]);
        wide.store(slope_y, &mut dy[y]);
        let grey = wide.share(wide.less(at, middle), eighth);
        wide.add_row(&mut values, grey);
        wide.add(&mut squares, grey, grey);
        wide.add_row(&mut gradient_x, slope_x);
        wide.add_row(&mut gradient_y, slope_y);
        wide.add(&mut product_x, grey, slope_x);
        wide.add(&mut product_y, grey, slope_y);
        (samples, above, here) = (next, at, below);
    }
    let [value, square, product_x, product_y] = wide.totals([values, squares, product_x, product_y]);
    let [gradient_x, gradient_y, ..] = wide.totals([gradient_x, gradient_y, wide.none(), wide.none()]);
    Moments { value, square, gradient: [gradient_x, gradient_y], product: [product_x, product_y] }
}

/// Columns, counted from the patch's middle.
const COLUMNS: [i16; SIDE] = [-8, -7, -6, -5, -4, -3, -2, -1, 0, 1, 2, 3, 4, 5, 6, 7];

/// As [`super::scalar::project`].
#[inline(always)]
pub(super) fn project<W: Wide>(wide: W, projection: Projection, value: &[i16], dx: &mut [i16], dy: &mut [i16]) -> Slopes {
    let (value, descent) = (rows(value), [rows_mut(dx), rows_mut(dy)]);
    let mean_value = wide.all(projection.value);
    let mean = [wide.all(projection.mean[0]), wide.all(projection.mean[1])];
    let along = [wide.all(projection.along[0]), wide.all(projection.along[1])];
    let (least, most, half, columns) = (wide.all(-STEEPEST), wide.all(STEEPEST), wide.all(HALF), wide.load(&COLUMNS));
    let [mut sum_x, mut sum_y, mut xx, mut xy, mut yy, mut moment_x, mut moment_y] = [wide.none(); 7];
    for y in 0..SIDE {
        let grey = wide.less_saturating(wide.load(&value[y]), mean_value);
        let mut rest = [grey; 2];
        for i in 0..2 {
            let less = wide.less_saturating(wide.load(&descent[i][y]), mean[i]);
            rest[i] = wide.clamp(wide.less_saturating(less, wide.share(grey, along[i])), least, most);
            wide.store(rest[i], &mut descent[i][y]);
        }
        wide.add_row(&mut sum_x, rest[0]);
        wide.add_row(&mut sum_y, rest[1]);
        let halves = [wide.share(rest[0], half), wide.share(rest[1], half)];
        wide.add(&mut xx, halves[0], halves[0]);
        wide.add(&mut xy, halves[0], halves[1]);
        wide.add(&mut yy, halves[1], halves[1]);
        let row = wide.all(y as i16 - SIDE as i16 / 2);
        for half in halves {
            wide.add(&mut moment_x, half, wide.times(half, columns));
            wide.add(&mut moment_y, half, wide.times(half, row));
        }
    }
    let [sum_x, sum_y, xy, _] = wide.totals([sum_x, sum_y, xy, wide.none()]);
    let [xx, yy, ..] = wide.totals([xx, yy, wide.none(), wide.none()]);
    Slopes { sum: [sum_x, sum_y], product: [xx, xy, yy], moment: wide.wide_totals([moment_x, moment_y]) }
}

/// Sixteen columns of a row between samples.
///
/// # Safety
/// The window has seventeen samples in row `y`.
#[inline(always)]
unsafe fn columns<W: Wide>(wide: W, window: Window<'_>, y: usize, part: W::Row) -> W::Row {
    // SAFETY: sixteen bytes from column 1 on are the last that are read: the caller's promise.
    let [a, b] = unsafe {
        let at = window.samples.as_ptr().add(y * window.stride);
        [wide.samples(at), wide.samples(at.add(1))]
    };
    between(wide, a, b, part)
}

/// As [`super::scalar::compare`].
#[inline(always)]
pub(super) fn compare<W: Wide>(wide: W, window: Window<'_>, value: &[i16], dx: &[i16], dy: &[i16]) -> Compared {
    check(window, SIDE + 1, SIDE + 1);
    let (value, dx, dy) = (rows(value), rows(dx), rows(dy));
    let (fx, fy, eighth) = (wide.all(window.x), wide.all(window.y), wide.all(EIGHTH));
    let [mut rhs_x, mut rhs_y, mut sum, mut square] = [wide.none(); 4];
    // SAFETY: `check` said that there are so many samples in so many rows; here and below.
    let mut above = unsafe { columns(wide, window, 0, fx) };
    for y in 0..SIDE {
        // SAFETY: as above.
        let below = unsafe { columns(wide, window, y + 1, fx) };
        let difference = wide.share(wide.less(between(wide, above, below, fy), wide.load(&value[y])), eighth);
        wide.add(&mut rhs_x, difference, wide.load(&dx[y]));
        wide.add(&mut rhs_y, difference, wide.load(&dy[y]));
        wide.add_row(&mut sum, difference);
        wide.add(&mut square, difference, difference);
        above = below;
    }
    let [sum, square] = wide.wide_totals([sum, square]);
    Compared { rhs: wide.wide_totals([rhs_x, rhs_y]), sum, square }
}
