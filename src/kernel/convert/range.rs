//! Samples of full range to limited range, and back.

use crate::image::{PlaneMut, PlaneRef, ToFull, ToLimited};
use crate::kernel::{Level, dispatch};

/// Writes `from`, brought to limited range, into `into`, as many rows and columns as both have.
pub fn to_limited(level: Level, map: ToLimited, from: PlaneRef<'_>, mut into: PlaneMut<'_>) {
    for row in 0..from.height().min(into.height()) {
        line(level, map, from.row(row), into.row_mut(row));
    }
}

/// Brings `plane` to limited range.
pub fn to_limited_in_place(level: Level, map: ToLimited, mut plane: PlaneMut<'_>) {
    for row in 0..plane.height() {
        line_in_place(level, map, plane.row_mut(row));
    }
}

/// Fills `into` with `from`, brought from limited to full range. Where `into` is larger, the last column and row are repeated; where
/// `from` is empty, it stays as it is.
pub fn to_full(map: ToFull, from: PlaneRef<'_>, mut into: PlaneMut<'_>) {
    if from.width() == 0 || from.height() == 0 {
        return;
    }
    let table: [u8; 256] = std::array::from_fn(|sample| map.apply(sample as u8));
    for y in 0..into.height() {
        let row = from.row(y.min(from.height() - 1));
        let last = row[row.len() - 1];
        let samples = row.iter().chain(std::iter::repeat(&last));
        for (out, &sample) in into.row_mut(y).iter_mut().zip(samples) {
            *out = table[usize::from(sample)];
        }
    }
}

fn line(level: Level, map: ToLimited, from: &[u8], into: &mut [u8]) {
    dispatch!(level, line_body(map: ToLimited, from: &[u8], into: &mut [u8]))
}

#[inline(always)]
fn line_body(map: ToLimited, from: &[u8], into: &mut [u8]) {
    for (out, &sample) in into.iter_mut().zip(from) {
        *out = limited(map, sample);
    }
}

fn line_in_place(level: Level, map: ToLimited, line: &mut [u8]) {
    dispatch!(level, line_in_place_body(map: ToLimited, line: &mut [u8]))
}

#[inline(always)]
fn line_in_place_body(map: ToLimited, line: &mut [u8]) {
    for sample in line {
        *sample = limited(map, *sample);
    }
}

/// Sixteen bits hold all of it: the division by 255, rounded down, is (t + 1 + t/256)/256, and `base` 256 times is below what is left.
#[inline(always)]
fn limited(map: ToLimited, sample: u8) -> u8 {
    let t = map.gain * u16::from(sample) + map.offset;
    ((t + (t >> 8) + (256 * u16::from(map.base) + 1)) >> 8) as u8
}
