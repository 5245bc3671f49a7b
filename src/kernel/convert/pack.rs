//! A planar picture into the bytes of a raw frame: what sinks and recordings take.

use super::{NEUTRAL, mean, thin};
use crate::image::{PictureRef, PixelFormat, PlaneMut, PlaneRef, RawLayout, Sampling};
use crate::kernel::{Level, dispatch};

/// Why a picture could not be packed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PackError {
    /// This form of picture has no way into this format.
    #[error("a {sampling:?} picture cannot be written as {format}")]
    Unsupported {
        /// The picture's chroma.
        sampling: Sampling,
        /// The format asked for.
        format: PixelFormat,
    },
    /// The frame is too small, or its rows are.
    #[error("{format} of {width}x{height} with rows of {stride} bytes does not fit into {bytes} bytes")]
    TooSmall {
        /// The format asked for.
        format: PixelFormat,
        /// The picture's width.
        width: usize,
        /// The picture's height.
        height: usize,
        /// The stride asked for.
        stride: usize,
        /// The bytes there were.
        bytes: usize,
    },
}

/// Writes `picture` as `format` with rows of the first plane `stride` bytes apart. Padding keeps its old bytes.
///
/// From any sampling: YUYV, UYVY, NV12, I420, GREY (chroma averaged or repeated; grey where there is none). I422 and I444 only
/// from their own sampling.
///
/// # Errors
/// [`PackError`]; `bytes` is then untouched.
pub fn pack(
    level: Level,
    picture: PictureRef<'_>,
    format: PixelFormat,
    stride: usize,
    bytes: &mut [u8],
) -> Result<(), PackError> {
    let (width, height, len) = (picture.width(), picture.height(), bytes.len());
    let unsupported = PackError::Unsupported { sampling: picture.sampling, format };
    let same = match format {
        PixelFormat::I422 => picture.sampling == Sampling::S422,
        PixelFormat::I444 => picture.sampling == Sampling::S444,
        PixelFormat::Rgb24 | PixelFormat::Bgr24 | PixelFormat::Mjpeg => false,
        _ => true,
    };
    if !same {
        return Err(unsupported);
    }
    let [mut first, mut second, mut third] = u32::try_from(width)
        .ok()
        .zip(u32::try_from(height).ok())
        .and_then(|(width, height)| RawLayout::new(format, width, height, stride))
        .and_then(|layout| layout.planes_mut(bytes))
        .ok_or(PackError::TooSmall { format, width, height, stride, bytes: len })?;
    let [y, u, v] = picture.planes;
    match format {
        PixelFormat::Yuyv => packed::<0>(level, picture, first),
        PixelFormat::Uyvy => packed::<1>(level, picture, first),
        PixelFormat::Grey => first.copy_from(y),
        PixelFormat::Nv12 => {
            first.copy_from(y);
            interleave(level, picture, second);
        }
        _ => {
            first.copy_from(y);
            match picture.sampling.shift() {
                None => {
                    second.fill(NEUTRAL);
                    third.fill(NEUTRAL);
                }
                Some((x, y)) => {
                    let (columns, rows) = (format == PixelFormat::I420 && x == 0, format == PixelFormat::I420 && y == 0);
                    thin(level, columns, rows, u, second.reborrow());
                    thin(level, columns, rows, v, third.reborrow());
                }
            }
        }
    }
    Ok(())
}

fn packed<const LUMA: usize>(level: Level, picture: PictureRef<'_>, into: PlaneMut<'_>) {
    if LUMA == 0 {
        yuyv(level, picture, into);
    } else {
        uyvy(level, picture, into);
    }
}

fn yuyv(level: Level, picture: PictureRef<'_>, into: PlaneMut<'_>) {
    dispatch!(level, packed_body::<0>(picture: PictureRef<'_>, into: PlaneMut<'_>))
}

fn uyvy(level: Level, picture: PictureRef<'_>, into: PlaneMut<'_>) {
    dispatch!(level, packed_body::<1>(picture: PictureRef<'_>, into: PlaneMut<'_>))
}

#[inline(always)]
fn packed_body<const LUMA: usize>(picture: PictureRef<'_>, mut into: PlaneMut<'_>) {
    let [y, u, v] = picture.planes;
    let rows_per_chroma = if picture.sampling == Sampling::S420 { 2 } else { 1 };
    let word = |y: [u8; 2], u: u8, v: u8| if LUMA == 0 { [y[0], u, y[1], v] } else { [u, y[0], v, y[1]] };
    for row in 0..y.height() {
        let luma = y.row(row);
        let (pairs, rest) = luma.as_chunks::<2>();
        let out = into.row_mut(row).as_chunks_mut::<4>().0;
        // The last chroma sample of an odd row stands beside a repeated luma sample.
        let last = rest.first().map(|&y| [y, y]);
        match picture.sampling {
            Sampling::Mono => {
                for (out, &y) in out.iter_mut().zip(pairs.iter().chain(&last)) {
                    *out = word(y, NEUTRAL, NEUTRAL);
                }
            }
            Sampling::S444 => {
                let (us, vs) = (u.row(row), v.row(row));
                for ((out, &y), (u, v)) in
                    out.iter_mut().zip(pairs).zip(us.as_chunks::<2>().0.iter().zip(vs.as_chunks::<2>().0))
                {
                    *out = word(y, mean(u[0], u[1]), mean(v[0], v[1]));
                }
                if let (Some(out), Some(y), Some(&u), Some(&v)) = (out.last_mut(), last, us.last(), vs.last()) {
                    *out = word(y, u, v);
                }
            }
            Sampling::S420 | Sampling::S422 => {
                let (us, vs) = (u.row(row / rows_per_chroma), v.row(row / rows_per_chroma));
                for ((out, &y), (&u, &v)) in out.iter_mut().zip(pairs).zip(us.iter().zip(vs)) {
                    *out = word(y, u, v);
                }
                if let (Some(out), Some(y), Some(&u), Some(&v)) = (out.last_mut(), last, us.last(), vs.last()) {
                    *out = word(y, u, v);
                }
            }
        }
    }
}

fn interleave(level: Level, picture: PictureRef<'_>, into: PlaneMut<'_>) {
    dispatch!(level, interleave_body(picture: PictureRef<'_>, into: PlaneMut<'_>))
}

#[inline(always)]
fn interleave_body(picture: PictureRef<'_>, mut into: PlaneMut<'_>) {
    let [_, u, v] = picture.planes;
    let pick = |plane: PlaneRef<'_>, column: usize, row: usize| -> u8 {
        let below = (2 * row + 1).min(plane.height() - 1);
        if picture.sampling == Sampling::S422 {
            return mean(plane.at(column, 2 * row), plane.at(column, below));
        }
        let (left, right) = (2 * column, (2 * column + 1).min(plane.width() - 1));
        super::mean4(plane.at(left, 2 * row), plane.at(right, 2 * row), plane.at(left, below), plane.at(right, below))
    };
    for row in 0..into.height() {
        let out = into.row_mut(row).as_chunks_mut::<2>().0;
        match picture.sampling {
            Sampling::Mono => out.fill([NEUTRAL; 2]),
            Sampling::S420 => {
                for (out, (&u, &v)) in out.iter_mut().zip(u.row(row).iter().zip(v.row(row))) {
                    *out = [u, v];
                }
            }
            Sampling::S422 | Sampling::S444 => {
                for (column, out) in out.iter_mut().enumerate() {
                    *out = [pick(u, column, row), pick(v, column, row)];
                }
            }
        }
    }
}
