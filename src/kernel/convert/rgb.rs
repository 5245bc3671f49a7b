//! Packed RGB to planar 4:2:0, BT.601, limited range (luma 16 to 235).

use crate::image::{PictureMut, PlaneRef};
use crate::kernel::{Level, dispatch};

/// The order of packed RGB.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RgbOrder {
    /// R G B (`RGB3`).
    Rgb,
    /// B G R (`BGR3`).
    Bgr,
}

/// Converts `from`, a plane of bytes `3 * width` wide, into the 4:2:0 picture `into`. Weights are ITU-R BT.601's in 1/256
/// (exact to within one step); chroma is that of the mean colour of two by two pixels.
pub fn rgb(level: Level, order: RgbOrder, from: PlaneRef<'_>, into: PictureMut<'_>) {
    let (r, b) = if order == RgbOrder::Rgb { (0, 2) } else { (2, 0) };
    convert(level, r, b, from, into);
}

fn convert(level: Level, r: usize, b: usize, from: PlaneRef<'_>, into: PictureMut<'_>) {
    dispatch!(level, body(r: usize, b: usize, from: PlaneRef<'_>, into: PictureMut<'_>))
}

#[inline(always)]
fn body(r: usize, b: usize, from: PlaneRef<'_>, into: PictureMut<'_>) {
    let [mut y, mut u, mut v] = into.planes;
    let (width, height) = (y.width().min(from.width() / 3), y.height().min(from.height()));
    for row in 0..height {
        for (out, p) in y.row_mut(row).iter_mut().zip(from.row(row).as_chunks::<3>().0) {
            *out = ((66 * i32::from(p[r]) + 129 * i32::from(p[1]) + 25 * i32::from(p[b]) + 128 + (16 << 8)) >> 8) as u8;
        }
    }
    for row in 0..height.div_ceil(2).min(u.height()) {
        let above = from.row(2 * row).as_chunks::<3>().0;
        let below = from.row((2 * row + 1).min(height - 1)).as_chunks::<3>().0;
        let chroma = u.row_mut(row).iter_mut().zip(v.row_mut(row));
        for (column, (u, v)) in chroma.enumerate().take(width.div_ceil(2)) {
            let (left, right) = (2 * column, (2 * column + 1).min(width - 1));
            let four = [above[left], above[right], below[left], below[right]];
            let sum = |c: usize| four.iter().map(|p| i32::from(p[c])).sum::<i32>();
            // Sums of four: weights in 1/1024.
            let (red, green, blue) = (sum(r), sum(1), sum(b));
            *u = ((-38 * red - 74 * green + 112 * blue + 512 + (128 << 10)) >> 10) as u8;
            *v = ((112 * red - 94 * green - 18 * blue + 512 + (128 << 10)) >> 10) as u8;
        }
    }
}
