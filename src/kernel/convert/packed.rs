//! Packed 4:2:2 (YUYV, UYVY) to planar 4:2:0.

use super::mean;
use crate::image::{PictureMut, PlaneRef};
use crate::kernel::{Level, dispatch};

/// The order of packed 4:2:2.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LumaFirst {
    /// Y0 U Y1 V (`YUYV`).
    Yes,
    /// U Y0 V Y1 (`UYVY`).
    No,
}

/// Unpacks `from`, a plane of bytes `4 * ceil(width / 2)` wide, into the 4:2:0 picture `into`. Converts as many rows and columns
/// as both have.
pub fn packed_422(level: Level, order: LumaFirst, from: PlaneRef<'_>, into: PictureMut<'_>) {
    match order {
        LumaFirst::Yes => yuyv(level, from, into),
        LumaFirst::No => uyvy(level, from, into),
    }
}

fn yuyv(level: Level, from: PlaneRef<'_>, into: PictureMut<'_>) {
    dispatch!(level, body::<0>(from: PlaneRef<'_>, into: PictureMut<'_>))
}

fn uyvy(level: Level, from: PlaneRef<'_>, into: PictureMut<'_>) {
    dispatch!(level, body::<1>(from: PlaneRef<'_>, into: PictureMut<'_>))
}

/// `LUMA` is the offset of Y in a pair of bytes.
#[inline(always)]
fn body<const LUMA: usize>(from: PlaneRef<'_>, into: PictureMut<'_>) {
    let [mut y, mut u, mut v] = into.planes;
    let height = from.height().min(y.height());
    // A pair of rows for all three planes while it is in the cache: a camera's frame comes from memory.
    for pair in 0..height.div_ceil(2) {
        let rows = [2 * pair, (2 * pair + 1).min(height - 1)];
        for row in rows {
            for (out, pair) in y.row_mut(row).iter_mut().zip(from.row(row).as_chunks::<2>().0) {
                *out = pair[LUMA];
            }
        }
        if pair >= u.height() {
            continue;
        }
        let [above, below] = rows.map(|row| from.row(row).as_chunks::<4>().0);
        let chroma = u.row_mut(pair).iter_mut().zip(v.row_mut(pair));
        for ((u, v), (a, b)) in chroma.zip(above.iter().zip(below)) {
            *u = mean(a[1 - LUMA], b[1 - LUMA]);
            *v = mean(a[3 - LUMA], b[3 - LUMA]);
        }
    }
}
