//! Where the planes of a raw frame lie in its bytes.

use super::{PixelFormat, PlaneMut, PlaneRef};

/// The planes of a raw frame, in bytes: width and rows of each, and the stride; as V4L2 lays them in one buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RawLayout {
    planes: [RawPlane; 3],
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct RawPlane {
    offset: usize,
    width: usize,
    height: usize,
    stride: usize,
}

impl RawLayout {
    /// The layout of a frame of `width` x `height` pixels whose first plane has rows `stride` bytes apart. Packed formats have
    /// one plane, NV12 two (luma, and chroma as U V pairs), planar ones Y U V; planes there are not are empty. `None` for
    /// compressed formats, where a row is longer than the stride, and where numbers do not fit.
    pub fn new(format: PixelFormat, width: u32, height: u32, stride: usize) -> Option<Self> {
        let (width, rows) = (width as usize, height as usize);
        if format.is_compressed() || format.tight_stride(u32::try_from(width).ok()?) > stride {
            return None;
        }
        let first = RawPlane { offset: 0, width: format.tight_stride(width as u32), height: rows, stride };
        let half = stride.div_ceil(2);
        let (second, third) = match format {
            PixelFormat::Nv12 => ((width.div_ceil(2) * 2, rows.div_ceil(2), stride.checked_next_multiple_of(2)?), (0, 0, 0)),
            PixelFormat::I420 => ((width.div_ceil(2), rows.div_ceil(2), half), (width.div_ceil(2), rows.div_ceil(2), half)),
            PixelFormat::I422 => ((width.div_ceil(2), rows, half), (width.div_ceil(2), rows, half)),
            PixelFormat::I444 => ((width, rows, stride), (width, rows, stride)),
            _ => ((0, 0, 0), (0, 0, 0)),
        };
        let mut planes = [first, RawPlane::default(), RawPlane::default()];
        let mut offset = stride.checked_mul(rows)?;
        for (plane, (width, height, stride)) in planes[1..].iter_mut().zip([second, third]) {
            *plane = RawPlane { offset, width, height, stride };
            offset = offset.checked_add(stride.checked_mul(height)?)?;
        }
        Some(Self { planes })
    }

    /// The least number of bytes such a frame has; the last row needs no padding.
    pub fn least_bytes(&self) -> usize {
        let end = |p: &RawPlane| if p.height * p.width == 0 { 0 } else { p.offset + (p.height - 1) * p.stride + p.width };
        self.planes.iter().map(end).max().unwrap_or(0)
    }

    /// The planes of a frame in `bytes`; `None` where there are too few.
    pub fn planes<'a>(&self, bytes: &'a [u8]) -> Option<[PlaneRef<'a>; 3]> {
        let [a, b, c] = self.planes;
        let plane = |p: RawPlane| PlaneRef::new(bytes.get(p.offset.min(bytes.len())..)?, p.width, p.height, p.stride);
        Some([plane(a)?, plane(b)?, plane(c)?])
    }

    /// The planes of a frame in `bytes`, to write; `None` where there are too few.
    pub fn planes_mut<'a>(&self, bytes: &'a mut [u8]) -> Option<[PlaneMut<'a>; 3]> {
        let [a, b, c] = self.planes;
        let split = |at: usize, bytes: &'a mut [u8]| bytes.split_at_mut_checked(at.min(bytes.len()));
        let (first, rest) = split(b.offset, bytes)?;
        let (second, third) = split(c.offset.saturating_sub(b.offset), rest)?;
        let plane = |p: RawPlane, bytes: &'a mut [u8]| PlaneMut::new(bytes, p.width, p.height, p.stride);
        Some([plane(a, first)?, plane(b, second)?, plane(c, third)?])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn planes_lie_one_after_the_other() {
        let layout = RawLayout::new(PixelFormat::I420, 5, 3, 6).unwrap();
        assert_eq!(layout.least_bytes(), 18 + 6 + 6);
        let bytes: Vec<u8> = (0..30).collect();
        let [y, u, v] = layout.planes(&bytes).unwrap();
        assert_eq!((y.at(0, 1), u.at(0, 0), v.at(2, 1)), (6, 18, 29));
        assert!(layout.planes(&bytes[..29]).is_none());
        assert!(layout.planes(&[]).is_none());
        let mut bytes = bytes;
        let [y, u, v] = layout.planes_mut(&mut bytes).unwrap();
        assert_eq!((y.as_ref().at(0, 1), u.as_ref().at(0, 0), v.as_ref().at(2, 1)), (6, 18, 29));
        assert!(layout.planes_mut(&mut bytes[..29]).is_none());
    }

    #[test]
    fn least_bytes_never_exceed_the_whole_frame() {
        for format in PixelFormat::ALL {
            for (width, height) in [(1, 1), (5, 3), (16, 9), (0, 4)] {
                for pad in [0, 1, 7] {
                    let stride = format.tight_stride(width) + pad;
                    let (layout, bytes) = (RawLayout::new(format, width, height, stride), format.frame_bytes(height, stride));
                    assert_eq!(layout.is_some(), bytes.is_some());
                    assert!(layout.map(|l| l.least_bytes()) <= bytes, "{format} {width}x{height} stride {stride}");
                }
            }
        }
    }

    #[test]
    fn nonsense_is_refused() {
        assert!(RawLayout::new(PixelFormat::Yuyv, 8, 2, 15).is_none(), "rows longer than the stride");
        assert!(RawLayout::new(PixelFormat::I444, 8, u32::MAX, usize::MAX / 2).is_none(), "overflow");
        assert!(RawLayout::new(PixelFormat::Mjpeg, 8, 8, 0).is_none());
        for (format, height) in PixelFormat::ALL.into_iter().flat_map(|format| [0, 1, u32::MAX].map(|height| (format, height)))
        {
            let layout = RawLayout::new(format, 8, height, usize::MAX);
            assert_eq!(layout.is_some(), format.frame_bytes(height, usize::MAX).is_some(), "{format} {height}");
        }
    }
}
