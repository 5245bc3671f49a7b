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

/// Writes `from`, brought from limited to full range, into `into`: rows one after the other, without padding, as many as both have.
pub fn to_full(map: ToFull, from: PlaneRef<'_>, into: &mut [u8]) {
    let table: [u8; 256] = std::array::from_fn(|sample| map.apply(sample as u8));
    for (y, row) in into.chunks_exact_mut(from.width().max(1)).take(from.height()).enumerate() {
        for (out, &sample) in row.iter_mut().zip(from.row(y)) {
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

/// Sixteen bits hold all of it: the division by 255, rounded down, is (t + 1 + t/256)/256.
#[inline(always)]
fn limited(map: ToLimited, sample: u8) -> u8 {
    let t = map.gain * u16::from(sample) + map.offset;
    map.base + ((t + 1 + (t >> 8)) >> 8) as u8
}
