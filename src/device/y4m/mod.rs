//! y4m (YUV4MPEG2): the plain video that every tool can write and read through a pipe.
//!
//! Read: 4:2:0 (with `C420jpeg`, `C420mpeg2`, `C420paldv` for the place of chroma), 4:2:2, 4:4:4, 4:1:1 (which becomes 4:2:2), mono; 8
//! bits; progressive; at most [`MAX_SIDE`](crate::image::MAX_SIDE) pixels wide and high. Chroma is named by `C`, or where that is missing by `XYSCSS=`; a header
//! with neither means `C420jpeg`. Parameters of single frames are skipped.
//! `XCOLORRANGE=FULL` and `=LIMITED` are understood and written. A rate of 0 (unknown) is taken as 25 frames a second.

mod header;
mod reader;
mod writer;

#[cfg(test)]
mod tests;

pub use reader::Y4mSource;
pub use writer::Y4mSink;

/// What a y4m stream begins with.
pub(super) const MAGIC: &[u8] = b"YUV4MPEG2";
