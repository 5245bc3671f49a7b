//! A v4l2loopback device as a sink: other programs see what gimbald writes as a camera.

use std::path::{Path, PathBuf};

use rustix::io::Errno;
use v4l::v4l_sys::{
    V4L2_CAP_VIDEO_OUTPUT, V4L2_PIX_FMT_PRIV_MAGIC, v4l2_colorspace_V4L2_COLORSPACE_SRGB,
    v4l2_quantization_V4L2_QUANTIZATION_LIM_RANGE, v4l2_ycbcr_encoding_V4L2_YCBCR_ENC_601,
};

use super::super::{DeviceError, FrameSink, StreamFormat};
use super::LOAD_LOOPBACK;
use super::create::create;
use super::enumerate::LOOPBACK_DRIVER;
use super::find::candidates;
use super::node::{Direction, Node, wish};
use super::queue::Queue;
use super::version::{self, LoopbackVersion};
use crate::frame::Stamp;
use crate::image::{Colour, Picture, PictureMut, PictureRef, PixelFormat, RawLayout, Sampling};
use crate::kernel::{Level, convert::pack};
use crate::rt::clock::monotonic_ns;

/// v4l2loopback's control `keep_format`: readers wait for a writer that went away instead of losing the device, and the format
/// stays locked. It outlives the program that set it.
const KEEP_FORMAT: u32 = 0x0098_f900;

/// Which device, and what to send to it.
#[derive(Clone, Debug, PartialEq)]
pub struct LoopbackParams {
    /// Number, path or card name, as [`super::find()`] takes it; `auto` is the first that is free.
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
    /// Whether a device is to be made where none answers to `device` or all that do are in use.
    pub create: bool,
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
    /// The driver does not say which buffer is free: they are taken in turns.
    turns: bool,
    /// The canvas lies in `current` itself.
    direct: bool,
    /// The canvas where the frames' layout is not the pipeline's, or where no buffer is free.
    spare: Picture,
    level: Level,
    /// The buffer that was sent last, and room for a copy of one.
    last: Option<usize>,
    copy: Vec<u8>,
    last_time_ns: i64,
    handed_over: bool,
    sent: u64,
    dropped: u64,
}

impl Loopback {
    /// Opens the device, sets its format and starts it, so that other programs see a camera. Where a reader holds another size or
    /// layout that can be written, that one is taken: [`FrameSink::format`] says which.
    ///
    /// # Errors
    /// [`DeviceError::Busy`] where another program writes to it, [`DeviceError::Unsupported`] where it is no loopback or another program
    /// holds another format, else [`DeviceError::Io`]; each says what to do.
    pub fn open(params: &LoopbackParams) -> Result<Self, DeviceError> {
        let missing = match candidates(&params.device, Direction::Output, &[]) {
            Err(error) => error,
            Ok(paths) => {
                let mut missing = DeviceError::Gone { path: PathBuf::from(&params.device) };
                for path in paths {
                    let there = path.exists();
                    match Self::open_path(path, params) {
                        Err(error) if matches!(error, DeviceError::Busy { .. }) || !there => missing = error,
                        other => return other,
                    }
                }
                missing
            }
        };
        // One that is there by this very name is not to be made a second time.
        let named = params.device.trim();
        let path = if named.starts_with('/') { PathBuf::from(named) } else { PathBuf::from(format!("/dev/video{named}")) };
        if !params.create || path.exists() {
            return Err(missing);
        }
        Self::open_path(create(&params.device)?, params)
    }

    fn open_path(path: PathBuf, params: &LoopbackParams) -> Result<Self, DeviceError> {
        let refuse = |what: String| Err(DeviceError::Unsupported { path: path.clone(), what });
        if writable(params.pixel.fourcc()).is_none() {
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
        let was_kept = check_output(&node)?;
        let format = set_format(&node, params).inspect_err(|_| keep_format(&node, was_kept))?;
        let Some(whole) = format.frame_bytes() else {
            return refuse(format!("frames of {}x{} are too large", format.width, format.height));
        };
        let turns = uses_turns(&node);
        let queue = Queue::new(node, Direction::Output, params.buffers.clamp(2, 32))?;
        if queue.len() == 0 || queue.capacity() < whole {
            let (count, size) = (queue.len(), queue.capacity());
            return refuse(format!(
                "the driver allocated {count} buffers of {size} bytes; at least one of {whole} is required"
            ));
        }
        let mut loopback = Self {
            queue,
            format,
            whole,
            current: None,
            turns,
            direct: false,
            spare: Picture::new(Sampling::S420, format.width as usize, format.height as usize),
            level: Level::detected(),
            last: None,
            copy: Vec::new(),
            last_time_ns: i64::MIN,
            handed_over: false,
            sent: 0,
            dropped: 0,
        };
        loopback.queue.start().map_err(|errno| loopback.queue.node().error("start the stream to", errno))?;
        keep_format(loopback.queue.node(), true);
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

    /// Buffers shared with the driver.
    pub fn buffers(&self) -> usize {
        self.queue.len()
    }

    /// To be called before the end where another process will go on writing soon: readers then wait for it, instead of seeing
    /// their camera go.
    pub fn hand_over(&mut self) {
        self.handed_over = true;
    }

    /// What was drawn into the canvas that was lent last and not sent yet; `None` where the driver's buffer is too small for it.
    pub fn drawn(&self) -> Option<PictureRef<'_>> {
        let Some(index) = self.current.filter(|_| self.direct) else { return Some(self.spare.as_ref()) };
        let StreamFormat { pixel, width, height, stride, .. } = self.format;
        let planes = RawLayout::new(pixel, width, height, stride)?.planes(self.queue.bytes(index))?;
        Some(PictureRef { sampling: Sampling::S420, planes })
    }

    /// Frames sent, and frames given up because the driver had no buffer free.
    pub fn counts(&self) -> (u64, u64) {
        (self.sent, self.dropped)
    }

    /// Sends a buffer as it is, as of now; costs next to nothing. For when every buffer holds the same picture: a reader that comes
    /// is given the newest first, and may stop when that is old.
    ///
    /// # Errors
    /// As [`FrameSink::submit`].
    pub fn renew(&mut self) -> Result<(), DeviceError> {
        self.current = None;
        match self.free_buffer()? {
            Some(index) => self.send(index, monotonic_ns()),
            None => Ok(()),
        }
    }

    /// Sends the last picture again, as of now; nothing where there was none or no buffer is free. For when the camera is away:
    /// some readers give up a camera that falls silent.
    ///
    /// # Errors
    /// As [`FrameSink::submit`].
    pub fn repeat(&mut self) -> Result<(), DeviceError> {
        let Some(last) = self.last else { return Ok(()) };
        // What a reader may be looking at is not queued a second time, but copied.
        let other = if self.turns {
            self.queue.reclaim(last);
            self.next_in_turn()?.filter(|&index| index != last)
        } else {
            // v4l2loopback never says that it has none to give back: ask once for each.
            for _ in 0..self.queue.len() {
                let _ = self.queue.dequeue();
            }
            (0..self.queue.len()).find(|&index| index != last && !self.queue.bytes(index).is_empty())
        };
        let Some(other) = other.filter(|_| !self.queue.bytes(last).is_empty()) else { return Ok(()) };
        let mut copy = std::mem::take(&mut self.copy);
        copy.clear();
        copy.extend_from_slice(self.queue.bytes(last));
        let shared = copy.len().min(self.queue.bytes(other).len());
        self.queue.bytes_mut(other)[..shared].copy_from_slice(&copy[..shared]);
        self.copy = copy;
        self.current = None;
        self.send(other, monotonic_ns())
    }

    fn send(&mut self, index: usize, time_ns: i64) -> Result<(), DeviceError> {
        // Readers may fail when time goes back, as from a picture sent again to one that a camera took before that; and V4L2
        // carries whole microseconds, of which zero would mean "now": v4l2loopback wants always or never.
        let time_ns = time_ns.max(self.last_time_ns.saturating_add(1000)).max(1000);
        self.last_time_ns = time_ns;
        self.queue.enqueue(index, self.whole, time_ns).map_err(|errno| self.queue.node().error("send a frame to", errno))?;
        self.last = Some(index);
        self.sent += 1;
        Ok(())
    }

    /// As [`Queue::reclaim_next`].
    fn next_in_turn(&mut self) -> Result<Option<usize>, DeviceError> {
        self.queue.reclaim_next(self.last).map_err(|errno| self.queue.node().error("choose a buffer of", errno))
    }

    /// A buffer to fill: one that is ours, else one the driver is done with, else none. Never waits.
    fn free_buffer(&mut self) -> Result<Option<usize>, DeviceError> {
        if self.turns {
            return self.next_in_turn();
        }
        if let Some(index) = self.queue.free() {
            return Ok(Some(index));
        }
        match self.queue.dequeue() {
            Ok(returned) => Ok(returned.map(|returned| returned.index)),
            Err(errno) => Err(self.queue.node().error("dequeue a buffer from", errno)),
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
        self.direct = self.format.pixel == PixelFormat::I420 && self.current.is_some();
        if self.direct
            && let Some(index) = self.current
            && let Some(picture) = planar(&self.format, self.queue.bytes_mut(index))
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
            let StreamFormat { pixel, stride, .. } = self.format;
            pack(self.level, self.spare.as_ref(), pixel, stride, self.queue.bytes_mut(index)).map_err(|error| {
                DeviceError::Unsupported { path: self.queue.node().path().to_path_buf(), what: error.to_string() }
            })?;
        }
        self.direct = false;
        self.send(index, stamp.time_ns)
    }
}

impl Drop for Loopback {
    fn drop(&mut self) {
        keep_format(self.queue.node(), self.handed_over);
        tracing::info!(loopback = %self.path().display(), sent = self.sent, dropped = self.dropped, "loopback closed");
    }
}

/// Whether the node takes frames; a format that a writer left locked behind is let go. Says whether there was one.
fn check_output(node: &Node) -> Result<bool, DeviceError> {
    let ask = || node.identity().map_err(|errno| node.error("query the capabilities of", errno));
    let identity = ask()?;
    let path = node.path().to_path_buf();
    if identity.driver != LOOPBACK_DRIVER && identity.caps & V4L2_CAP_VIDEO_OUTPUT == 0 {
        let (card, driver) = (identity.card, identity.driver);
        let what = format!("{card} (driver {driver}) does not accept frames: it is not a loopback device; {LOAD_LOOPBACK}");
        return Err(DeviceError::Unsupported { path, what });
    }
    let was_kept = identity.driver == LOOPBACK_DRIVER && node.control(KEEP_FORMAT) == Ok(1);
    if was_kept {
        keep_format(node, false);
    }
    // Made with exclusive_caps, it says that it takes none while a program writes to it, or the format was locked.
    if ask()?.caps & V4L2_CAP_VIDEO_OUTPUT == 0 {
        keep_format(node, was_kept);
        return Err(DeviceError::Busy { path });
    }
    Ok(was_kept)
}

/// Whether this is a v4l2loopback older than 0.15, whose buffers have to be used in turn ([`Queue::reclaim_next`]).
fn uses_turns(node: &Node) -> bool {
    node.identity().is_ok_and(|identity| identity.driver == LOOPBACK_DRIVER)
        && LoopbackVersion::parse(&std::fs::read_to_string(version::FILE).unwrap_or_default()) < LoopbackVersion::ANY_BUFFER
}

/// Sets the control, where there is one: the module's older relatives work without.
fn keep_format(node: &Node, keep: bool) {
    if let Err(errno) = node.set_control(KEEP_FORMAT, keep.into()) {
        tracing::debug!(device = %node.path().display(), %errno, "no control keep_format");
    }
}

/// Sets format and rate. v4l2loopback returns the format that another program holds, and success: so compare.
fn set_format(node: &Node, params: &LoopbackParams) -> Result<StreamFormat, DeviceError> {
    let mut asked = wish(params.pixel.fourcc(), params.width, params.height);
    let tight = StreamFormat::tight(params.width, params.height, params.pixel, params.interval);
    asked.bytesperline = u32::try_from(tight.stride).unwrap_or(0);
    asked.sizeimage = tight.frame_bytes().and_then(|bytes| u32::try_from(bytes).ok()).unwrap_or(0);
    // What pictures are inside, for modules that pass it on to readers (0.12); V4L2 ignores all but the first where `priv` is not set.
    asked.colorspace = v4l2_colorspace_V4L2_COLORSPACE_SRGB;
    asked.priv_ = V4L2_PIX_FMT_PRIV_MAGIC;
    asked.quantization = v4l2_quantization_V4L2_QUANTIZATION_LIM_RANGE;
    asked.__bindgen_anon_1.ycbcr_enc = v4l2_ycbcr_encoding_V4L2_YCBCR_ENC_601;
    let given = node.set_format(Direction::Output, asked).map_err(|errno| match errno {
        Errno::INVAL => DeviceError::Unsupported {
            path: node.path().to_path_buf(),
            what: format!("refuses {} {}x{}; choose YUYV, or another size", params.pixel, params.width, params.height),
        },
        errno => node.error("set the format of", errno),
    })?;
    let code = given.pixelformat.to_le_bytes();
    let (width, height) = (given.width, given.height);
    if (given.pixelformat, width, height) != (asked.pixelformat, asked.width, asked.height) {
        let held = format!(
            "keeps {} {width}x{height} although {} {}x{} was requested: a program that reads from it holds that format",
            String::from_utf8_lossy(&code),
            params.pixel,
            params.width,
            params.height
        );
        let even = width > 0 && height > 0 && width.is_multiple_of(2) && height.is_multiple_of(2);
        if !even || writable(code).is_none() {
            let what = format!("{held}, and it cannot be written; close that program");
            return Err(DeviceError::Unsupported { path: node.path().to_path_buf(), what });
        }
        tracing::warn!(loopback = %node.path().display(), "{held}; the picture is scaled to fit");
    }
    let pixel = writable(code).unwrap_or(params.pixel);
    let tight = StreamFormat::tight(width, height, pixel, params.interval);
    // The rate is for readers that ask; a refusal changes nothing of what we send.
    let interval = node.set_interval(Direction::Output, params.interval).ok().flatten().unwrap_or(params.interval);
    let stride = (given.bytesperline as usize).max(tight.stride);
    Ok(StreamFormat { stride, interval, colour: params.colour, ..tight })
}

/// The layout of that code, where frames of it can be written.
fn writable(code: [u8; 4]) -> Option<PixelFormat> {
    PixelFormat::from_fourcc(code).filter(|pixel| matches!(pixel, PixelFormat::Yuyv | PixelFormat::I420 | PixelFormat::Nv12))
}

/// `bytes` as a picture to draw into, where their layout is the pipeline's own (I420).
fn planar<'a>(format: &StreamFormat, bytes: &'a mut [u8]) -> Option<PictureMut<'a>> {
    let layout = RawLayout::new(format.pixel, format.width, format.height, format.stride)?;
    Some(PictureMut { sampling: Sampling::S420, planes: layout.planes_mut(bytes)? })
}

#[cfg(test)]
mod tests {
    use super::*;

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
            create: false,
        };
        let error = |params: LoopbackParams| Loopback::open(&params).unwrap_err().to_string();
        assert!(error(params.clone()).contains("modprobe v4l2loopback"));
        assert!(error(LoopbackParams { width: 641, ..params.clone() }).contains("641x480"));
        assert!(error(LoopbackParams { pixel: PixelFormat::Rgb24, ..params }).contains("YUYV"));
    }
}
