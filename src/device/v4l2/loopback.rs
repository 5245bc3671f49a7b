//! A v4l2loopback device as a sink: what gimbald draws becomes a camera for every other program.

use std::path::Path;

use rustix::io::Errno;
use v4l::v4l_sys::{
    V4L2_CAP_VIDEO_CAPTURE, V4L2_CAP_VIDEO_OUTPUT, v4l2_colorspace_V4L2_COLORSPACE_SRGB,
    v4l2_quantization_V4L2_QUANTIZATION_DEFAULT, v4l2_quantization_V4L2_QUANTIZATION_FULL_RANGE,
    v4l2_quantization_V4L2_QUANTIZATION_LIM_RANGE,
};

use super::super::{DeviceError, FrameSink, StreamFormat};
use super::LOAD_LOOPBACK;
use super::enumerate::LOOPBACK_DRIVER;
use super::find::find;
use super::node::{Direction, Node, wish};
use super::queue::Queue;
use crate::frame::Stamp;
use crate::image::{Colour, Picture, PictureMut, PictureRef, PixelFormat, PlaneMut, Range, Sampling};
use crate::rt::clock::monotonic_ns;

/// Which device, and what to send to it.
#[derive(Clone, Debug, PartialEq)]
pub struct LoopbackParams {
    /// Number, path or card name, as [`find`] takes it.
    pub device: String,
    /// Layout of the frames: YUYV, I420 or NV12.
    pub pixel: PixelFormat,
    /// Luma samples in a row; even.
    pub width: u32,
    /// Luma rows; even.
    pub height: u32,
    /// Nominal time between frames (seconds, numerator and denominator).
    pub interval: (u32, u32),
    /// Meaning of the samples.
    pub colour: Colour,
    /// Buffers to share with the driver (2 to 32); v4l2loopback gives no more than its `max_buffers`, usually 2.
    pub buffers: u32,
}

/// An open, streaming loopback device.
#[derive(Debug)]
pub struct Loopback {
    queue: Queue,
    format: StreamFormat,
    /// Bytes of a frame.
    whole: usize,
    /// The buffer that the canvas lies in or will be packed into.
    current: Option<usize>,
    /// The canvas lies in `current` itself.
    direct: bool,
    /// The canvas where the frames' layout is not the pipeline's, or where no buffer is free.
    spare: Picture,
    sent: u64,
    dropped: u64,
}

impl Loopback {
    /// Opens the device, sets its format and starts it, so that other programs see a camera.
    ///
    /// # Errors
    /// [`DeviceError::Busy`] where another program writes to it, [`DeviceError::Unsupported`] where it is no loopback or somebody
    /// holds another format, else [`DeviceError::Io`]; each says what to do.
    pub fn open(params: &LoopbackParams) -> Result<Self, DeviceError> {
        let path = find(&params.device, Direction::Output)?;
        let refuse = |what: String| Err(DeviceError::Unsupported { path: path.clone(), what });
        if !matches!(params.pixel, PixelFormat::Yuyv | PixelFormat::I420 | PixelFormat::Nv12) {
            return refuse(format!("frames of {} cannot be written to a loopback; choose YUYV, YU12 or NV12", params.pixel));
        }
        if params.width == 0 || params.height == 0 || !params.width.is_multiple_of(2) || !params.height.is_multiple_of(2) {
            let (width, height) = (params.width, params.height);
            return refuse(format!("size {width}x{height}: expected even numbers, as call apps refuse odd ones"));
        }
        let node = Node::open(&path).map_err(|error| match error {
            DeviceError::Io { source, path, .. } if source.kind() == std::io::ErrorKind::NotFound => {
                DeviceError::Unsupported { path, what: format!("there is no such device; {LOAD_LOOPBACK}") }
            }
            other => other,
        })?;
        check_output(&node)?;
        let format = set_format(&node, params)?;
        let Some(whole) = format.frame_bytes() else {
            return refuse(format!("frames of {}x{} are too large", format.width, format.height));
        };
        let queue = Queue::new(node, Direction::Output, params.buffers.clamp(2, 32))?;
        if queue.len() == 0 || queue.capacity() < whole {
            let (count, size) = (queue.len(), queue.capacity());
            return refuse(format!("the driver gives {count} buffers of {size} bytes; at least one of {whole} is needed"));
        }
        let mut loopback = Self {
            queue,
            format,
            whole,
            current: None,
            direct: false,
            spare: Picture::new(Sampling::S420, format.width as usize, format.height as usize),
            sent: 0,
            dropped: 0,
        };
        loopback.queue.start().map_err(|errno| loopback.queue.node().error("start the stream to", errno))?;
        tracing::info!(
            loopback = %path.display(), format = %format.pixel, width = format.width, height = format.height,
            buffers = loopback.queue.len(), "loopback opened"
        );
        Ok(loopback)
    }

    /// The device's node.
    pub fn path(&self) -> &Path {
        self.queue.node().path()
    }

    /// Frames sent, and frames given up because the driver had no buffer free.
    pub fn counts(&self) -> (u64, u64) {
        (self.sent, self.dropped)
    }

    /// A buffer to fill: one that is ours, else one the driver is done with, else none. Never waits.
    fn free_buffer(&mut self) -> Result<Option<usize>, DeviceError> {
        if let Some(index) = self.queue.ours() {
            return Ok(Some(index));
        }
        match self.queue.dequeue() {
            Ok(returned) => Ok(returned.map(|returned| returned.index)),
            Err(errno) => Err(self.queue.node().error("take a buffer back from", errno)),
        }
    }
}

impl FrameSink for Loopback {
    fn format(&self) -> StreamFormat {
        self.format
    }

    fn canvas(&mut self) -> Result<PictureMut<'_>, DeviceError> {
        if self.current.is_none() {
            self.current = self.free_buffer()?;
        }
        let (width, height, stride) = (self.format.width as usize, self.format.height as usize, self.format.stride);
        self.direct = self.format.pixel == PixelFormat::I420 && self.current.is_some();
        if self.direct
            && let Some(index) = self.current
            && let Some(picture) = planar(self.queue.bytes_mut(index), width, height, stride)
        {
            return Ok(picture);
        }
        self.direct = false;
        Ok(self.spare.as_mut())
    }

    fn submit(&mut self, stamp: &Stamp) -> Result<(), DeviceError> {
        if self.current.is_none() {
            self.current = self.free_buffer()?;
        }
        let Some(index) = self.current.take() else {
            self.dropped += 1;
            return Ok(());
        };
        if !self.direct {
            pack(self.spare.as_ref(), &self.format, self.queue.bytes_mut(index));
        }
        self.direct = false;
        // Zero would mean "now", and v4l2loopback wants always or never.
        let time_ns = if stamp.time_ns >= 1000 { stamp.time_ns } else { monotonic_ns() };
        match self.queue.enqueue(index, self.whole, time_ns) {
            Ok(()) => {
                self.sent += 1;
                Ok(())
            }
            Err(errno) => Err(self.queue.node().error("send a frame to", errno)),
        }
    }
}

impl Drop for Loopback {
    fn drop(&mut self) {
        tracing::info!(loopback = %self.path().display(), sent = self.sent, dropped = self.dropped, "loopback closed");
    }
}

/// Whether the node takes frames.
fn check_output(node: &Node) -> Result<(), DeviceError> {
    let identity = node.identity().map_err(|errno| node.error("ask for the abilities of", errno))?;
    let path = node.path().to_path_buf();
    if identity.caps & V4L2_CAP_VIDEO_OUTPUT != 0 {
        return Ok(());
    }
    if identity.driver == LOOPBACK_DRIVER && identity.caps & V4L2_CAP_VIDEO_CAPTURE != 0 {
        // Made with exclusive_caps: it says so while somebody writes to it.
        return Err(DeviceError::Busy { path });
    }
    let what =
        format!("{} (driver {}) takes no frames: it is no loopback device; {LOAD_LOOPBACK}", identity.card, identity.driver);
    Err(DeviceError::Unsupported { path, what })
}

/// Sets format and rate. v4l2loopback answers what somebody else holds, with success: so compare.
fn set_format(node: &Node, params: &LoopbackParams) -> Result<StreamFormat, DeviceError> {
    let mut asked = wish(params.pixel.fourcc(), params.width, params.height);
    let tight = StreamFormat::tight(params.width, params.height, params.pixel, params.interval);
    asked.bytesperline = u32::try_from(tight.stride).unwrap_or(0);
    asked.sizeimage = tight.frame_bytes().and_then(|bytes| u32::try_from(bytes).ok()).unwrap_or(0);
    asked.colorspace = v4l2_colorspace_V4L2_COLORSPACE_SRGB;
    asked.quantization = match params.colour.range {
        Range::Unknown => v4l2_quantization_V4L2_QUANTIZATION_DEFAULT,
        Range::Limited => v4l2_quantization_V4L2_QUANTIZATION_LIM_RANGE,
        Range::Full => v4l2_quantization_V4L2_QUANTIZATION_FULL_RANGE,
    };
    let given = node.set_format(Direction::Output, asked).map_err(|errno| match errno {
        Errno::INVAL => DeviceError::Unsupported {
            path: node.path().to_path_buf(),
            what: format!("refuses {} {}x{}; choose YUYV, or another size", params.pixel, params.width, params.height),
        },
        errno => node.error("set the format of", errno),
    })?;
    if (given.pixelformat, given.width, given.height) != (asked.pixelformat, asked.width, asked.height) {
        let code = given.pixelformat.to_le_bytes();
        let what = format!(
            "stays at {} {}x{} when asked for {} {}x{}: a program that watches it holds that format; close that program, or set \
             the output to that format",
            String::from_utf8_lossy(&code),
            given.width,
            given.height,
            params.pixel,
            params.width,
            params.height
        );
        return Err(DeviceError::Unsupported { path: node.path().to_path_buf(), what });
    }
    // The rate is for readers that ask; a refusal changes nothing of what we send.
    let interval = node.set_interval(Direction::Output, params.interval).ok().flatten().unwrap_or(params.interval);
    let stride = (given.bytesperline as usize).max(tight.stride);
    Ok(StreamFormat { stride, interval, colour: params.colour, ..tight })
}

/// `bytes` as a planar 4:2:0 picture, chroma rows half as far apart as luma rows; `None` where they do not hold it.
fn planar(bytes: &mut [u8], width: usize, height: usize, stride: usize) -> Option<PictureMut<'_>> {
    let (cw, ch) = Sampling::S420.chroma_size(width, height);
    let chroma_stride = stride.div_ceil(2);
    let (y, rest) = bytes.split_at_mut_checked(stride.checked_mul(height)?)?;
    let (u, rest) = rest.split_at_mut_checked(chroma_stride.checked_mul(ch)?)?;
    let (v, _) = rest.split_at_mut_checked(chroma_stride.checked_mul(ch)?)?;
    let planes = [
        PlaneMut::new(y, width, height, stride)?,
        PlaneMut::new(u, cw, ch, chroma_stride)?,
        PlaneMut::new(v, cw, ch, chroma_stride)?,
    ];
    Some(PictureMut { sampling: Sampling::S420, planes })
}

/// Writes `picture` (4:2:0) into `bytes` as `format` has it.
fn pack(picture: PictureRef<'_>, format: &StreamFormat, bytes: &mut [u8]) {
    let (width, stride) = (picture.width(), format.stride);
    let [y, u, v] = picture.planes;
    match format.pixel {
        PixelFormat::Yuyv => {
            for (row, out) in bytes.chunks_exact_mut(stride).take(picture.height()).enumerate() {
                let chroma = u.row(row / 2).iter().zip(v.row(row / 2));
                for ((out, luma), (u, v)) in out.chunks_exact_mut(4).zip(y.row(row).chunks_exact(2)).zip(chroma) {
                    out.copy_from_slice(&[luma[0], *u, luma[1], *v]);
                }
            }
        }
        PixelFormat::Nv12 => {
            let Some((luma, chroma)) = bytes.split_at_mut_checked(stride * picture.height()) else { return };
            for (row, out) in luma.chunks_exact_mut(stride).enumerate() {
                out[..width].copy_from_slice(y.row(row));
            }
            for (row, out) in chroma.chunks_exact_mut(stride).take(u.height()).enumerate() {
                for (out, (u, v)) in out.chunks_exact_mut(2).zip(u.row(row).iter().zip(v.row(row))) {
                    out.copy_from_slice(&[*u, *v]);
                }
            }
        }
        // I420, drawn aside because no buffer was free then.
        _ => {
            if let Some(mut to) = planar(bytes, width, picture.height(), stride) {
                for (to, from) in to.planes.iter_mut().zip([y, u, v]) {
                    to.copy_from(from);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A picture each of whose samples tells its place.
    fn picture(width: usize, height: usize) -> Picture {
        let mut picture = Picture::new(Sampling::S420, width, height);
        for (plane, base) in picture.as_mut().planes.iter_mut().zip([0, 100, 200]) {
            for row in 0..plane.height() {
                for (x, sample) in plane.row_mut(row).iter_mut().enumerate() {
                    *sample = (base + row * 10 + x) as u8;
                }
            }
        }
        picture
    }

    fn packed(pixel: PixelFormat, stride: usize, len: usize) -> Vec<u8> {
        let format = StreamFormat { stride, ..StreamFormat::tight(4, 2, pixel, (1, 30)) };
        let mut bytes = vec![255; len];
        pack(picture(4, 2).as_ref(), &format, &mut bytes);
        bytes
    }

    #[test]
    fn packed_as_v4l2_has_it() {
        let yuyv = [0, 100, 1, 200, 2, 101, 3, 201, 10, 100, 11, 200, 12, 101, 13, 201];
        assert_eq!(packed(PixelFormat::Yuyv, 8, 16), yuyv);
        let nv12 = [0, 1, 2, 3, 10, 11, 12, 13, 100, 200, 101, 201];
        assert_eq!(packed(PixelFormat::Nv12, 4, 12), nv12);
        let i420 = [0, 1, 2, 3, 10, 11, 12, 13, 100, 101, 200, 201];
        assert_eq!(packed(PixelFormat::I420, 4, 12), i420);
    }

    #[test]
    fn rows_further_apart_keep_their_padding() {
        let bytes = packed(PixelFormat::Nv12, 6, 18);
        assert_eq!(bytes, [0, 1, 2, 3, 255, 255, 10, 11, 12, 13, 255, 255, 100, 200, 101, 201, 255, 255]);
        assert_eq!(packed(PixelFormat::I420, 6, 18)[12..], [100, 101, 255, 200, 201, 255], "chroma 3 apart");
    }

    #[test]
    fn too_little_memory_is_no_panic() {
        for pixel in [PixelFormat::Yuyv, PixelFormat::Nv12, PixelFormat::I420] {
            packed(pixel, 8, 7);
        }
    }

    #[test]
    fn what_cannot_be_is_said_before_anything_is_opened() {
        let params = LoopbackParams {
            device: "/dev/no-such-loopback".into(),
            pixel: PixelFormat::Yuyv,
            width: 640,
            height: 480,
            interval: (1, 30),
            colour: Colour::default(),
            buffers: 2,
        };
        let error = |params: LoopbackParams| Loopback::open(&params).unwrap_err().to_string();
        assert!(error(params.clone()).contains("modprobe v4l2loopback"));
        assert!(error(LoopbackParams { width: 641, ..params.clone() }).contains("641x480"));
        assert!(error(LoopbackParams { pixel: PixelFormat::Rgb24, ..params }).contains("YUYV"));
    }
}
