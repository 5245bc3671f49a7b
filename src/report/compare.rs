//! Writes input and output side by side to a sink of its own.

use crate::device::{DeviceError, FrameSink, StreamFormat};
use crate::frame::Frame;
use crate::image::{PictureMut, PictureRef};
use crate::pipeline::Observer;
use crate::rt::stop::Stop;

/// Shows each frame beside what was made of it.
pub struct Compare {
    sink: Box<dyn FrameSink>,
    failed: Option<DeviceError>,
    stop: Stop,
}

/// The planar format of a side-by-side picture of `output`: twice its width. Odd widths are padded by one column, so that
/// chroma samples stay with their picture.
pub fn compare_format(output: &StreamFormat) -> StreamFormat {
    let planar = output.planar();
    let width = output.width.next_multiple_of(2).saturating_mul(2);
    StreamFormat { width, stride: planar.pixel.tight_stride(width), ..planar }
}

impl Compare {
    /// Draws into `sink`, which has the format that [`compare_format`] gives. Where the sink fails, `stop` is set.
    pub fn new(sink: Box<dyn FrameSink>, stop: Stop) -> Self {
        Self { sink, failed: None, stop }
    }

    /// Ends the sink's stream.
    ///
    /// # Errors
    /// The first that occurred since the beginning.
    pub fn finish(mut self) -> Result<(), DeviceError> {
        match self.failed.take() {
            Some(error) => Err(error),
            None => self.sink.finish(),
        }
    }

    fn show(&mut self, frame: &Frame, output: PictureRef<'_>) -> Result<(), DeviceError> {
        side_by_side(frame.picture.as_ref(), output, self.sink.canvas()?);
        self.sink.submit(&frame.stamp)
    }
}

impl Observer for Compare {
    fn drawn(&mut self, frame: &Frame, output: PictureRef<'_>) {
        if self.failed.is_none()
            && let Err(error) = self.show(frame, output)
        {
            self.failed = Some(error);
            self.stop.set();
        }
    }
}

/// Copies `left` and `right` into the halves of `canvas`, black where a picture is smaller than its half.
fn side_by_side(left: PictureRef<'_>, right: PictureRef<'_>, mut canvas: PictureMut<'_>) {
    for (index, plane) in canvas.planes.iter_mut().enumerate() {
        // A mono picture beside a coloured canvas leaves the neutral chroma; 16 is black in either range.
        plane.fill(if index == 0 { 16 } else { 128 });
        let half = plane.width() / 2;
        for (picture, start) in [(left, 0), (right, half)] {
            let from = picture.planes[index];
            let width = from.width().min(half);
            for y in 0..from.height().min(plane.height()) {
                plane.row_mut(y)[start..start + width].copy_from_slice(&from.row(y)[..width]);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::{Picture, PixelFormat, Sampling};

    fn filled(sampling: Sampling, width: usize, height: usize, value: u8) -> Picture {
        let mut picture = Picture::new(sampling, width, height);
        picture.as_mut().planes.iter_mut().enumerate().for_each(|(i, plane)| plane.fill(value + i as u8));
        picture
    }

    #[test]
    fn halves_keep_apart_at_odd_sizes() {
        for (pixel, sampling) in
            [(PixelFormat::I420, Sampling::S420), (PixelFormat::I422, Sampling::S422), (PixelFormat::Grey, Sampling::Mono)]
        {
            let output = StreamFormat::tight(5, 3, pixel, (1, 30));
            let format = compare_format(&output);
            assert_eq!((format.width, format.height, format.pixel), (12, 3, pixel));
            let mut canvas = Picture::new(format.sampling(), 12, 3);
            let (left, right) = (filled(sampling, 5, 3, 40), filled(sampling, 5, 3, 90));
            side_by_side(left.as_ref(), right.as_ref(), canvas.as_mut());
            assert_eq!(canvas.luma().row(2), [40, 40, 40, 40, 40, 16, 90, 90, 90, 90, 90, 16]);
            if sampling != Sampling::Mono {
                assert_eq!(canvas.as_ref().planes[1].row(1), [41, 41, 41, 91, 91, 91]);
            }
        }
    }
}
