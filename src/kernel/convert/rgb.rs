//! Packed RGB to planar 4:2:0.

use crate::image::{FromRgb, PictureMut, PlaneRef};
use crate::kernel::{Level, dispatch};

/// The order of packed RGB.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RgbOrder {
    /// R G B (`RGB3`).
    Rgb,
    /// B G R (`BGR3`).
    Bgr,
}

/// Converts `from`, a plane of bytes `3 * width` wide, into the 4:2:0 picture `into` with the weights `matrix`
/// (exact to within one step); chroma is that of the mean colour of two by two pixels.
pub fn rgb(level: Level, order: RgbOrder, matrix: FromRgb, from: PlaneRef<'_>, into: PictureMut<'_>) {
    let mut matrix = matrix;
    if order == RgbOrder::Bgr {
        matrix.weights.iter_mut().for_each(|weights| weights.reverse());
    }
    convert(level, matrix, from, into);
}

fn convert(level: Level, matrix: FromRgb, from: PlaneRef<'_>, into: PictureMut<'_>) {
    dispatch!(level, body(matrix: FromRgb, from: PlaneRef<'_>, into: PictureMut<'_>))
}

#[inline(always)]
fn body(matrix: FromRgb, from: PlaneRef<'_>, into: PictureMut<'_>) {
    let [mut y, mut u, mut v] = into.planes;
    let [in_y, in_u, in_v] = matrix.weights;
    let weigh = |weights: [i32; 3], rgb: [i32; 3]| weights[0] * rgb[0] + weights[1] * rgb[1] + weights[2] * rgb[2];
    let (width, height) = (y.width().min(from.width() / 3), y.height().min(from.height()));
    for row in 0..height {
        for (out, p) in y.row_mut(row).iter_mut().zip(from.row(row).as_chunks::<3>().0) {
            *out = ((weigh(in_y, p.map(i32::from)) + 128 + matrix.black) >> 8).clamp(0, 255) as u8;
        }
    }
    for row in 0..height.div_ceil(2).min(u.height()) {
        let above = from.row(2 * row).as_chunks::<3>().0;
        let below = from.row((2 * row + 1).min(height - 1)).as_chunks::<3>().0;
        let chroma = u.row_mut(row).iter_mut().zip(v.row_mut(row));
        for (column, (u, v)) in chroma.enumerate().take(width.div_ceil(2)) {
            let (left, right) = (2 * column, (2 * column + 1).min(width - 1));
            let four = [above[left], above[right], below[left], below[right]];
            // Sums of four: weights in 1/1024.
            let sum = [0, 1, 2].map(|c| four.iter().map(|p| i32::from(p[c])).sum::<i32>());
            *u = ((weigh(in_u, sum) + 512 + (128 << 10)) >> 10).clamp(0, 255) as u8;
            *v = ((weigh(in_v, sum) + 512 + (128 << 10)) >> 10).clamp(0, 255) as u8;
        }
    }
}
