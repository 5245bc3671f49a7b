//! The synthetic camera in the raw formats of real ones, and a sink like a loopback: for benchmarks.

use super::synthetic::{self, Synthetic};
use super::{DeviceError, FrameSink, FrameSource, Lent, RawFrame, StreamFormat};
use crate::frame::Stamp;
use crate::image::{Picture, PictureMut, PixelFormat, PlaneRef, RawLayout, Sampling};
use crate::kernel::Level;
use crate::kernel::{cache, convert};
use turbojpeg::{Compressor, Subsamp, YuvImage};

/// Quality of the pictures that MJPEG cameras send, about.
const QUALITY: i32 = 85;

/// Gives the synthetic camera's frames in the raw format of another camera. They lie in memory as a camera's do: in no cache of the
/// processor that is to read them.
pub struct Rehearsal {
    camera: Synthetic,
    format: StreamFormat,
    encoder: Option<Compressor>,
    picture: Picture,
    planes: Vec<u8>,
    bytes: Vec<u8>,
}

impl std::fmt::Debug for Rehearsal {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Rehearsal").field("format", &self.format).finish_non_exhaustive()
    }
}

impl Rehearsal {
    /// A camera of the given settings that gives `pixel`: YUYV, UYVY, NV12, I420 or MJPEG (of 4:2:2, as webcams give it).
    ///
    /// # Errors
    /// A sentence that names the setting, or says that the encoder could not be made.
    pub fn new(params: &synthetic::Params, pixel: PixelFormat) -> Result<Self, String> {
        let camera = Synthetic::new(params)?;
        let format = StreamFormat { pixel, stride: pixel.tight_stride(params.width), ..camera.format() };
        let encoder = if pixel.is_compressed() {
            let mut encoder = Compressor::new().map_err(|error| error.to_string())?;
            encoder.set_quality(QUALITY).map_err(|error| error.to_string())?;
            Some(encoder)
        } else {
            None
        };
        let picture = Picture::new(Sampling::S420, params.width as usize, params.height as usize);
        let bytes = vec![0; format.frame_bytes().unwrap_or(0)];
        Ok(Self { camera, format, encoder, picture, planes: Vec::new(), bytes })
    }
}

impl FrameSource for Rehearsal {
    fn format(&self) -> StreamFormat {
        self.format
    }

    fn frames(&self) -> Option<u64> {
        self.camera.frames()
    }

    fn lend(&mut self) -> Result<Lent<'_>, DeviceError> {
        let refuse = |what: String| DeviceError::format("the synthetic camera", what);
        let Lent::Frame(frame) = self.camera.lend()? else { return Ok(Lent::End) };
        let drawn = frame.format;
        let planes = RawLayout::new(drawn.pixel, drawn.width, drawn.height, drawn.stride)
            .and_then(|layout| layout.planes(frame.bytes))
            .ok_or_else(|| refuse("its frame is too short".into()))?;
        for (to, from) in self.picture.as_mut().planes.iter_mut().zip(planes) {
            to.copy_from(from);
        }
        let stamp = frame.stamp;
        match &mut self.encoder {
            Some(encoder) => {
                let (width, height) = (drawn.width as usize, drawn.height as usize);
                widen(planes, &mut self.planes);
                let image = YuvImage { pixels: &self.planes[..], width, align: 1, height, subsamp: Subsamp::Sub2x1 };
                self.bytes = encoder.compress_yuv_to_vec(image).map_err(|error| refuse(error.to_string()))?;
            }
            None => {
                let picture = self.picture.as_ref();
                convert::pack(Level::detected(), picture, self.format.pixel, self.format.stride, &mut self.bytes)
                    .map_err(|error| refuse(error.to_string()))?;
            }
        }
        cache::flush(&self.bytes);
        Ok(Lent::Frame(RawFrame { format: self.format, bytes: &self.bytes, stamp }))
    }
}

/// Planes of 4:2:0 as planes of 4:2:2, one after the other: chroma rows repeated.
fn widen([y, u, v]: [PlaneRef<'_>; 3], into: &mut Vec<u8>) {
    into.clear();
    for row in 0..y.height() {
        into.extend_from_slice(y.row(row));
    }
    for plane in [u, v] {
        for row in 0..y.height() {
            into.extend_from_slice(plane.row(row / 2));
        }
    }
}

/// Buffers in turn, as many as v4l2loopback gives.
const BUFFERS: usize = 2;

/// Packs each picture into memory as the loopback does into the driver's, and throws it away.
#[derive(Debug)]
pub struct RehearsalSink {
    format: StreamFormat,
    canvas: Picture,
    buffers: [Vec<u8>; BUFFERS],
    next: usize,
}

impl RehearsalSink {
    /// For pictures of the size of `format`, packed as `pixel`.
    pub fn new(format: &StreamFormat, pixel: PixelFormat) -> Self {
        let format = StreamFormat { pixel, stride: pixel.tight_stride(format.width), ..*format };
        let buffers = std::array::from_fn(|_| vec![0; format.frame_bytes().unwrap_or(0)]);
        Self { format, canvas: format.picture(), buffers, next: 0 }
    }
}

impl FrameSink for RehearsalSink {
    fn format(&self) -> StreamFormat {
        self.format
    }

    fn canvas(&mut self) -> Result<PictureMut<'_>, DeviceError> {
        Ok(self.canvas.as_mut())
    }

    fn submit(&mut self, _: &Stamp) -> Result<(), DeviceError> {
        let bytes = &mut self.buffers[self.next];
        self.next = (self.next + 1) % BUFFERS;
        convert::pack(Level::detected(), self.canvas.as_ref(), self.format.pixel, self.format.stride, bytes)
            .map_err(|error| DeviceError::format("rehearsal", error.to_string()))?;
        std::hint::black_box(bytes);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stage::unpack::Unpack;

    #[test]
    fn every_format_shows_what_the_camera_saw() {
        let params = synthetic::Params { width: 96, height: 64, frames: 2, ..synthetic::Params::default() };
        for pixel in [PixelFormat::Yuyv, PixelFormat::Nv12, PixelFormat::I420, PixelFormat::Mjpeg] {
            let mut plain = Synthetic::new(&params).unwrap();
            let mut source = Rehearsal::new(&params, pixel).unwrap();
            for _ in 0..2 {
                let Lent::Frame(frame) = plain.lend().unwrap() else { panic!("too few frames") };
                let wanted = frame.bytes.to_vec();
                let Lent::Frame(frame) = source.lend().unwrap() else { panic!("too few frames") };
                let mut picture = Picture::default();
                Unpack::new()
                    .unpack(pixel, frame.format.colour.range, (96, 64), frame.format.stride, frame.bytes, &mut picture)
                    .unwrap();
                let mut off = 0.0;
                for (y, row) in wanted[..96 * 64].chunks(96).enumerate() {
                    for (a, b) in row.iter().zip(picture.luma().row(y)) {
                        off += f64::from(a.abs_diff(*b)) / (96.0 * 64.0);
                    }
                }
                assert!(off < if pixel.is_compressed() { 4.0 } else { 1e-9 }, "{pixel}: {off} grey levels");
            }
            assert!(matches!(source.lend().unwrap(), Lent::End));
        }
    }
}
