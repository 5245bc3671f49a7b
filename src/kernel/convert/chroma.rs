//! Chroma planes: taking U and V apart, and thinning 4:2:2, 4:4:4 and rarer kinds.

use super::{mean, mean4};
use crate::image::{PlaneMut, PlaneRef};
use crate::kernel::{Level, dispatch};

/// Takes interleaved U V (NV12's second plane, `from`, `2 * width` bytes wide) apart.
pub fn interleaved(level: Level, from: PlaneRef<'_>, u: PlaneMut<'_>, v: PlaneMut<'_>) {
    dispatch!(level, interleaved_body(from: PlaneRef<'_>, u: PlaneMut<'_>, v: PlaneMut<'_>))
}

#[inline(always)]
fn interleaved_body(from: PlaneRef<'_>, mut u: PlaneMut<'_>, mut v: PlaneMut<'_>) {
    for row in 0..from.height().min(u.height()).min(v.height()) {
        let pairs = from.row(row).as_chunks::<2>().0;
        for ((u, v), pair) in u.row_mut(row).iter_mut().zip(v.row_mut(row)).zip(pairs) {
            [*u, *v] = *pair;
        }
    }
}

/// Which neighbours become one sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Thin {
    Rows,
    Columns,
    Both,
}

/// Averages neighbours in `from` into `into`: pairs of columns where `columns`, pairs of rows where `rows`; neither copies.
/// `into` is to be half as large (rounded up) along what is halved.
pub fn thin(level: Level, columns: bool, rows: bool, from: PlaneRef<'_>, mut into: PlaneMut<'_>) {
    match (columns, rows) {
        (false, false) => into.copy_from(from),
        (false, true) => thin_dispatch(level, Thin::Rows, from, into),
        (true, false) => thin_dispatch(level, Thin::Columns, from, into),
        (true, true) => thin_dispatch(level, Thin::Both, from, into),
    }
}

fn thin_dispatch(level: Level, kind: Thin, from: PlaneRef<'_>, into: PlaneMut<'_>) {
    dispatch!(level, thin_body(kind: Thin, from: PlaneRef<'_>, into: PlaneMut<'_>))
}

#[inline(always)]
fn thin_body(kind: Thin, from: PlaneRef<'_>, mut into: PlaneMut<'_>) {
    let step = if kind == Thin::Columns { 1 } else { 2 };
    for row in 0..from.height().div_ceil(step).min(into.height()) {
        let above = from.row(step * row);
        let below = from.row((step * row + step - 1).min(from.height() - 1));
        let out = into.row_mut(row);
        match kind {
            Thin::Rows => {
                for (out, (&a, &b)) in out.iter_mut().zip(above.iter().zip(below)) {
                    *out = mean(a, b);
                }
            }
            Thin::Columns => {
                for (out, a) in out.iter_mut().zip(above.as_chunks::<2>().0) {
                    *out = mean(a[0], a[1]);
                }
            }
            Thin::Both => {
                for (out, (a, b)) in out.iter_mut().zip(above.as_chunks::<2>().0.iter().zip(below.as_chunks::<2>().0)) {
                    *out = mean4(a[0], a[1], b[0], b[1]);
                }
            }
        }
        if kind != Thin::Rows && from.width() % 2 == 1 {
            let (last, end) = (from.width() / 2, from.width() - 1);
            if last < out.len() {
                out[last] = mean(above[end], below[end]);
            }
        }
    }
}

/// Brings a chroma plane that has one sample to `x` by `y` luma samples to 4:2:0's one to two by two. What is denser is
/// averaged, what is sparser (4:1:1, 4:4:1) repeated. The size of `into` says how much there is.
pub fn to_420(level: Level, (x, y): (usize, usize), from: PlaneRef<'_>, mut into: PlaneMut<'_>) {
    if x <= 2 && y <= 2 {
        return thin(level, x == 1, y == 1, from, into);
    }
    if from.width() == 0 || from.height() == 0 {
        return;
    }
    // Rare (no camera known sends it): sample by sample.
    let source = |n: usize, step: usize, limit: usize| ((2 * n / step).min(limit - 1), ((2 * n + 1) / step).min(limit - 1));
    for row in 0..into.height() {
        let (above, below) = source(row, y, from.height());
        for (column, out) in into.row_mut(row).iter_mut().enumerate() {
            let (left, right) = source(column, x, from.width());
            *out = mean4(from.at(left, above), from.at(right, above), from.at(left, below), from.at(right, below));
        }
    }
}

/// Doubles the columns of a chroma plane (4:1:1 to 4:2:2): each sample lies in the middle of its two new ones, and these are a quarter
/// of the way to the neighbour on their side. `into` is at most twice as wide as `from`; rows that `from` has not are left alone.
pub fn widen(from: PlaneRef<'_>, mut into: PlaneMut<'_>) {
    // rare, and from files alone: one level for all
    for row in 0..from.height().min(into.height()) {
        let from = from.row(row);
        let Some(last) = from.len().checked_sub(1) else { return };
        for (column, out) in into.row_mut(row).iter_mut().enumerate() {
            let near = (column / 2).min(last);
            let far = if column % 2 == 0 { near.saturating_sub(1) } else { (near + 1).min(last) };
            *out = ((3 * u16::from(from[near]) + u16::from(from[far]) + 2) >> 2) as u8;
        }
    }
}
