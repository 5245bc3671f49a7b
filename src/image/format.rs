//! The raw formats a camera or a file gives, by name.

use std::fmt;

/// The most pixels of a picture that comes compressed: 7680 x 4320. Its size costs the sender nothing, unlike that of raw frames.
pub const MAX_COMPRESSED_PIXELS: u64 = 7680 * 4320;

/// How a raw frame's bytes are laid out, as V4L2 and y4m name it. All samples have 8 bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum PixelFormat {
    /// `YUYV`: packed 4:2:2, Y0 U Y1 V.
    Yuyv,
    /// `UYVY`: packed 4:2:2, U Y0 V Y1.
    Uyvy,
    /// `NV12`: 4:2:0, a luma plane, then a plane of interleaved U V.
    Nv12,
    /// `YU12` (I420): planar 4:2:0, Y then U then V.
    I420,
    /// `422P`: planar 4:2:2.
    I422,
    /// `444P` (V4L2: `YM24` in one buffer): planar 4:4:4.
    I444,
    /// `GREY`: luma alone.
    Grey,
    /// `RGB3`: packed R G B.
    Rgb24,
    /// `BGR3`: packed B G R.
    Bgr24,
    /// `MJPG`: one JPEG picture a frame.
    Mjpeg,
}

impl PixelFormat {
    /// Every format, in the order of the enum.
    pub const ALL: [Self; 10] = [
        Self::Yuyv,
        Self::Uyvy,
        Self::Nv12,
        Self::I420,
        Self::I422,
        Self::I444,
        Self::Grey,
        Self::Rgb24,
        Self::Bgr24,
        Self::Mjpeg,
    ];

    /// The four characters by which V4L2 knows the format.
    pub fn fourcc(self) -> [u8; 4] {
        *match self {
            Self::Yuyv => b"YUYV",
            Self::Uyvy => b"UYVY",
            Self::Nv12 => b"NV12",
            Self::I420 => b"YU12",
            Self::I422 => b"422P",
            Self::I444 => b"444P",
            Self::Grey => b"GREY",
            Self::Rgb24 => b"RGB3",
            Self::Bgr24 => b"BGR3",
            Self::Mjpeg => b"MJPG",
        }
    }

    /// The format of a V4L2 code; `None` where gimbald cannot read it. `JPEG` is taken as `MJPG`.
    pub fn from_fourcc(code: [u8; 4]) -> Option<Self> {
        if &code == b"JPEG" {
            return Some(Self::Mjpeg);
        }
        Self::ALL.into_iter().find(|format| format.fourcc() == code)
    }

    /// Whether a frame's size in bytes varies with its content.
    pub fn is_compressed(self) -> bool {
        self == Self::Mjpeg
    }

    /// Whether samples are R, G and B.
    pub fn is_rgb(self) -> bool {
        matches!(self, Self::Rgb24 | Self::Bgr24)
    }

    /// Whether pictures of `width` x `height` are too large to be decoded: more than [`MAX_COMPRESSED_PIXELS`].
    pub fn is_too_large(self, width: u32, height: u32) -> bool {
        self.is_compressed() && u64::from(width) * u64::from(height) > MAX_COMPRESSED_PIXELS
    }

    /// Bytes of a row of the first plane where rows have no padding; 0 for compressed formats.
    pub fn tight_stride(self, width: u32) -> usize {
        let width = width as usize;
        match self {
            Self::Yuyv | Self::Uyvy => width.div_ceil(2) * 4,
            Self::Nv12 | Self::I420 | Self::I422 | Self::I444 | Self::Grey => width,
            Self::Rgb24 | Self::Bgr24 => width * 3,
            Self::Mjpeg => 0,
        }
    }

    /// Bytes of a whole frame with rows of the first plane `stride` bytes apart (chroma rows follow in proportion, as V4L2
    /// lays them); `None` for compressed formats and where the number does not fit.
    pub fn frame_bytes(self, height: u32, stride: usize) -> Option<usize> {
        let rows = height as usize;
        let luma = stride.checked_mul(rows)?;
        match self {
            Self::Yuyv | Self::Uyvy | Self::Grey | Self::Rgb24 | Self::Bgr24 => Some(luma),
            Self::Nv12 => luma.checked_add(stride.checked_next_multiple_of(2)?.checked_mul(rows.div_ceil(2))?),
            Self::I420 => luma.checked_add(stride.div_ceil(2).checked_mul(rows.div_ceil(2))?.checked_mul(2)?),
            Self::I422 => luma.checked_add(stride.div_ceil(2).checked_mul(rows)?.checked_mul(2)?),
            Self::I444 => luma.checked_mul(3),
            Self::Mjpeg => None,
        }
    }
}

impl fmt::Display for PixelFormat {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(std::str::from_utf8(&self.fourcc()).unwrap_or("????"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fourcc_and_back() {
        for format in PixelFormat::ALL {
            assert_eq!(PixelFormat::from_fourcc(format.fourcc()), Some(format));
        }
        assert_eq!(PixelFormat::from_fourcc(*b"H264"), None);
    }

    #[test]
    fn bytes_of_odd_and_huge_frames() {
        let bytes = |format: PixelFormat, w: u32, h| format.frame_bytes(h, format.tight_stride(w));
        assert_eq!(bytes(PixelFormat::I420, 5, 3), Some(15 + 2 * 3 * 2));
        assert_eq!(bytes(PixelFormat::Nv12, 5, 3), Some(15 + 6 * 2));
        assert_eq!(bytes(PixelFormat::Yuyv, 5, 3), Some(12 * 3));
        assert_eq!(bytes(PixelFormat::Mjpeg, 5, 3), None);
        assert_eq!(PixelFormat::I444.frame_bytes(u32::MAX, usize::MAX / 2), None, "no overflow");
    }
}
