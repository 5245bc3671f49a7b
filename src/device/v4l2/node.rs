//! One open V4L2 node and its ioctls, each as a safe method.
//!
//! The v4l crate gives the structs, the request numbers and the reading of size and rate unions. Its `Device` is left aside: it
//! leaks the descriptor into child processes, and panics on a card name cut in the middle of a letter and on an error of close.

mod control;

use std::io;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::path::{Path, PathBuf};

use rustix::fs::{Mode, OFlags};
use rustix::io::Errno;
use rustix::ioctl::{Opcode, Updater, ioctl};
use v4l::frameinterval::FrameIntervalEnum;
use v4l::framesize::FrameSizeEnum;
use v4l::v4l_sys::{
    V4L2_CAP_TIMEPERFRAME, v4l2_buf_type_V4L2_BUF_TYPE_VIDEO_CAPTURE, v4l2_buf_type_V4L2_BUF_TYPE_VIDEO_OUTPUT, v4l2_buffer,
    v4l2_capability, v4l2_field_V4L2_FIELD_NONE, v4l2_fmtdesc, v4l2_format, v4l2_frmivalenum, v4l2_frmsizeenum, v4l2_input,
    v4l2_memory_V4L2_MEMORY_MMAP, v4l2_pix_format, v4l2_requestbuffers, v4l2_streamparm,
};
use v4l::v4l2::vidioc;

use super::super::DeviceError;

/// Which way frames go through a node, seen from this program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// The node gives frames: a camera.
    Capture,
    /// The node takes frames: a loopback.
    Output,
}

impl Direction {
    /// V4L2's buffer type; single-planar, so no ioctl of this file ever carries a pointer.
    fn buffer_type(self) -> u32 {
        match self {
            Self::Capture => v4l2_buf_type_V4L2_BUF_TYPE_VIDEO_CAPTURE,
            Self::Output => v4l2_buf_type_V4L2_BUF_TYPE_VIDEO_OUTPUT,
        }
    }
}

/// Structs of V4L2 of which all zero bytes are a valid value.
///
/// # Safety
/// Implemented only for C structs of integers, arrays and unions of such, and raw pointers.
unsafe trait Zeroed: Sized {
    fn zeroed() -> Self {
        // SAFETY: the trait's promise.
        unsafe { std::mem::zeroed() }
    }
}

// SAFETY: C structs of integers, and of unions of those and raw pointers.
unsafe impl Zeroed for v4l2_capability {}
// SAFETY: as above.
unsafe impl Zeroed for v4l2_fmtdesc {}
// SAFETY: as above.
unsafe impl Zeroed for v4l2_frmsizeenum {}
// SAFETY: as above.
unsafe impl Zeroed for v4l2_frmivalenum {}
// SAFETY: as above.
unsafe impl Zeroed for v4l2_input {}
// SAFETY: as above.
unsafe impl Zeroed for v4l2_format {}
// SAFETY: as above.
unsafe impl Zeroed for v4l2_streamparm {}
// SAFETY: as above.
unsafe impl Zeroed for v4l2_requestbuffers {}
// SAFETY: as above.
unsafe impl Zeroed for v4l2_buffer {}

/// What QUERYCAP says, its texts made readable whatever their bytes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Identity {
    pub(super) driver: String,
    pub(super) card: String,
    pub(super) bus: String,
    /// V4L2_CAP_ bits of this node.
    pub(super) caps: u32,
}

/// An open node.
#[derive(Debug)]
pub(super) struct Node {
    fd: OwnedFd,
    path: PathBuf,
}

impl Node {
    /// Opens `path` for non-blocking use.
    pub(super) fn open(path: &Path) -> Result<Self, DeviceError> {
        let flags = OFlags::RDWR | OFlags::NONBLOCK | OFlags::CLOEXEC | OFlags::NOCTTY;
        let fd = retry(|| rustix::fs::open(path, flags, Mode::empty())).map_err(|errno| error(path, "open", errno))?;
        Ok(Self { fd, path: path.to_path_buf() })
    }

    /// Where it was opened.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// The descriptor, to poll and to map.
    pub(super) fn fd(&self) -> BorrowedFd<'_> {
        self.fd.as_fd()
    }

    /// `errno` as an error that names this node.
    pub(super) fn error(&self, doing: &'static str, errno: Errno) -> DeviceError {
        error(&self.path, doing, errno)
    }

    /// An ioctl whose argument is read and written by the kernel.
    ///
    /// # Safety
    /// `T` must be the type that the kernel takes for `REQUEST`, holding no pointer that the kernel would follow.
    unsafe fn update<const REQUEST: Opcode, T>(&self, value: &mut T) -> Result<(), Errno> {
        // The request's number carries the size of what the kernel copies: it must be T's.
        const { assert!(((REQUEST >> 16) & 0x3fff) as usize == size_of::<T>(), "the struct of another request") };
        retry(|| {
            // SAFETY: the kernel reads and writes size_of::<T>() bytes at `value`, which is exclusively ours; the rest is the
            // caller's promise.
            unsafe { ioctl(&self.fd, Updater::<REQUEST, T>::new(value)) }
        })
    }

    /// VIDIOC_QUERYCAP.
    pub(super) fn identity(&self) -> Result<Identity, Errno> {
        let mut cap = v4l2_capability::zeroed();
        // SAFETY: QUERYCAP fills a v4l2_capability, which holds no pointer.
        unsafe { self.update::<{ vidioc::VIDIOC_QUERYCAP as Opcode }, _>(&mut cap)? };
        Ok(Identity {
            driver: text(&cap.driver),
            card: text(&cap.card),
            bus: text(&cap.bus_info),
            // Before 3.4 drivers said only what all their nodes together can.
            caps: if cap.device_caps != 0 { cap.device_caps } else { cap.capabilities },
        })
    }

    /// VIDIOC_ENUMINPUT: whether there is anything that it captures from.
    pub(super) fn has_input(&self) -> bool {
        let mut input = v4l2_input::zeroed();
        // SAFETY: ENUMINPUT fills a v4l2_input, which holds no pointer.
        unsafe { self.update::<{ vidioc::VIDIOC_ENUMINPUT as Opcode }, _>(&mut input).is_ok() }
    }

    /// VIDIOC_ENUM_FMT: the four-letter code and name of format `index`, `None` after the last.
    pub(super) fn pixel_format(&self, direction: Direction, index: u32) -> Option<([u8; 4], String)> {
        let mut desc = v4l2_fmtdesc { index, type_: direction.buffer_type(), ..v4l2_fmtdesc::zeroed() };
        // SAFETY: ENUM_FMT fills a v4l2_fmtdesc, which holds no pointer.
        unsafe { self.update::<{ vidioc::VIDIOC_ENUM_FMT as Opcode }, _>(&mut desc).ok()? };
        Some((desc.pixelformat.to_le_bytes(), text(&desc.description)))
    }

    /// VIDIOC_ENUM_FRAMESIZES: size (or range of sizes) `index` of a format, `None` after the last.
    pub(super) fn frame_size(&self, fourcc: [u8; 4], index: u32) -> Option<FrameSizeEnum> {
        let pixel_format = u32::from_le_bytes(fourcc);
        let mut size = v4l2_frmsizeenum { index, pixel_format, ..v4l2_frmsizeenum::zeroed() };
        // SAFETY: ENUM_FRAMESIZES fills a v4l2_frmsizeenum, which holds no pointer.
        unsafe { self.update::<{ vidioc::VIDIOC_ENUM_FRAMESIZES as Opcode }, _>(&mut size).ok()? };
        FrameSizeEnum::try_from(size).ok()
    }

    /// VIDIOC_ENUM_FRAMEINTERVALS: interval (or range of them) `index` of a format at a size, `None` after the last.
    pub(super) fn frame_interval(&self, fourcc: [u8; 4], width: u32, height: u32, index: u32) -> Option<FrameIntervalEnum> {
        let pixel_format = u32::from_le_bytes(fourcc);
        let mut interval = v4l2_frmivalenum { index, pixel_format, width, height, ..v4l2_frmivalenum::zeroed() };
        // SAFETY: ENUM_FRAMEINTERVALS fills a v4l2_frmivalenum, which holds no pointer.
        unsafe { self.update::<{ vidioc::VIDIOC_ENUM_FRAMEINTERVALS as Opcode }, _>(&mut interval).ok()? };
        FrameIntervalEnum::try_from(interval).ok()
    }

    /// VIDIOC_G_FMT.
    pub(super) fn format(&self, direction: Direction) -> Result<v4l2_pix_format, Errno> {
        let mut format = v4l2_format { type_: direction.buffer_type(), ..v4l2_format::zeroed() };
        // SAFETY: G_FMT of a single-planar video type fills the union's `pix`, which holds no pointer.
        unsafe { self.update::<{ vidioc::VIDIOC_G_FMT as Opcode }, _>(&mut format)? };
        // SAFETY: every bit pattern is a v4l2_pix_format: integers only.
        Ok(unsafe { format.fmt.pix })
    }

    /// VIDIOC_S_FMT: asks for `pix` and gives what the driver made of it, which may be something else altogether.
    pub(super) fn set_format(&self, direction: Direction, pix: v4l2_pix_format) -> Result<v4l2_pix_format, Errno> {
        let mut format = v4l2_format { type_: direction.buffer_type(), ..v4l2_format::zeroed() };
        format.fmt.pix = pix;
        // SAFETY: S_FMT of a single-planar video type reads and fills the union's `pix`, which holds no pointer.
        unsafe { self.update::<{ vidioc::VIDIOC_S_FMT as Opcode }, _>(&mut format)? };
        // SAFETY: every bit pattern is a v4l2_pix_format: integers only.
        Ok(unsafe { format.fmt.pix })
    }

    /// VIDIOC_S_PARM: asks for a time between frames (seconds, numerator and denominator) and gives what the driver made of it;
    /// `None` where the driver has no say in it.
    pub(super) fn set_interval(&self, direction: Direction, interval: (u32, u32)) -> Result<Option<(u32, u32)>, Errno> {
        let mut parm = v4l2_streamparm { type_: direction.buffer_type(), ..v4l2_streamparm::zeroed() };
        // v4l2_captureparm and v4l2_outputparm have the same layout: capability, mode, timeperframe, ...
        // SAFETY: the union was zeroed whole, and every bit pattern is a v4l2_captureparm: integers only.
        let capture = unsafe { &mut parm.parm.capture };
        capture.timeperframe.numerator = interval.0;
        capture.timeperframe.denominator = interval.1;
        // SAFETY: S_PARM reads and fills a v4l2_streamparm, which holds no pointer.
        unsafe { self.update::<{ vidioc::VIDIOC_S_PARM as Opcode }, _>(&mut parm)? };
        // SAFETY: as above.
        let capture = unsafe { parm.parm.capture };
        let interval = (capture.timeperframe.numerator, capture.timeperframe.denominator);
        let said = capture.capability & V4L2_CAP_TIMEPERFRAME != 0 || direction == Direction::Output;
        Ok((said && interval.0 != 0 && interval.1 != 0).then_some(interval))
    }

    /// VIDIOC_REQBUFS for memory-mapped buffers: how many there are now. Zero frees them.
    pub(super) fn request_buffers(&self, direction: Direction, count: u32) -> Result<u32, Errno> {
        let memory = v4l2_memory_V4L2_MEMORY_MMAP;
        let mut request =
            v4l2_requestbuffers { count, type_: direction.buffer_type(), memory, ..v4l2_requestbuffers::zeroed() };
        // SAFETY: REQBUFS reads and fills a v4l2_requestbuffers, which holds no pointer.
        unsafe { self.update::<{ vidioc::VIDIOC_REQBUFS as Opcode }, _>(&mut request)? };
        Ok(request.count)
    }

    /// A buffer struct for the ioctls below.
    fn buffer(direction: Direction, index: u32) -> v4l2_buffer {
        let memory = v4l2_memory_V4L2_MEMORY_MMAP;
        v4l2_buffer { index, type_: direction.buffer_type(), memory, ..v4l2_buffer::zeroed() }
    }

    /// VIDIOC_QUERYBUF: (offset to map at, bytes) of buffer `index`.
    pub(super) fn query_buffer(&self, direction: Direction, index: u32) -> Result<(u64, usize), Errno> {
        let mut buffer = Self::buffer(direction, index);
        // SAFETY: QUERYBUF of a single-planar type fills a v4l2_buffer and follows no pointer in it.
        unsafe { self.update::<{ vidioc::VIDIOC_QUERYBUF as Opcode }, _>(&mut buffer)? };
        // SAFETY: for memory-mapped buffers the driver filled `offset`, an integer.
        let offset = unsafe { buffer.m.offset };
        Ok((u64::from(offset), buffer.length as usize))
    }

    /// VIDIOC_QBUF of buffer `index`: for output, `bytes` of it filled with a picture taken at `time_ns`; for capture both are 0.
    pub(super) fn queue_buffer(&self, direction: Direction, index: u32, bytes: u32, time_ns: i64) -> Result<(), Errno> {
        let mut buffer = Self::buffer(direction, index);
        buffer.bytesused = bytes;
        buffer.field = v4l2_field_V4L2_FIELD_NONE;
        buffer.timestamp.tv_sec = time_ns.div_euclid(1_000_000_000);
        buffer.timestamp.tv_usec = time_ns.rem_euclid(1_000_000_000) / 1000;
        // SAFETY: QBUF of a memory-mapped, single-planar buffer follows no pointer in it.
        unsafe { self.update::<{ vidioc::VIDIOC_QBUF as Opcode }, _>(&mut buffer) }
    }

    /// VIDIOC_DQBUF: the buffer that was filled (or emptied) first, `None` where there is none yet.
    pub(super) fn dequeue_buffer(&self, direction: Direction) -> Result<Option<v4l2_buffer>, Errno> {
        let mut buffer = Self::buffer(direction, 0);
        // SAFETY: DQBUF of a memory-mapped, single-planar buffer fills a v4l2_buffer and follows no pointer in it.
        match unsafe { self.update::<{ vidioc::VIDIOC_DQBUF as Opcode }, _>(&mut buffer) } {
            Ok(()) => Ok(Some(buffer)),
            Err(Errno::AGAIN) => Ok(None),
            Err(errno) => Err(errno),
        }
    }

    /// VIDIOC_STREAMON.
    pub(super) fn stream_on(&self, direction: Direction) -> Result<(), Errno> {
        let mut kind = direction.buffer_type().cast_signed();
        // SAFETY: STREAMON reads an int.
        unsafe { self.update::<{ vidioc::VIDIOC_STREAMON as Opcode }, _>(&mut kind) }
    }

    /// VIDIOC_STREAMOFF: also takes every buffer out of the driver's queue.
    pub(super) fn stream_off(&self, direction: Direction) -> Result<(), Errno> {
        let mut kind = direction.buffer_type().cast_signed();
        // SAFETY: STREAMOFF reads an int.
        unsafe { self.update::<{ vidioc::VIDIOC_STREAMOFF as Opcode }, _>(&mut kind) }
    }
}

/// A pix format to ask for: progressive frames of a format and size, stride and bytes left to the driver.
pub(super) fn wish(fourcc: [u8; 4], width: u32, height: u32) -> v4l2_pix_format {
    let mut format = v4l2_format::zeroed();
    format.fmt.pix = v4l2_pix_format {
        width,
        height,
        pixelformat: u32::from_le_bytes(fourcc),
        field: v4l2_field_V4L2_FIELD_NONE,
        // SAFETY: the union was zeroed whole, and every bit pattern is a v4l2_pix_format: integers only.
        ..unsafe { format.fmt.pix }
    };
    // SAFETY: as above.
    unsafe { format.fmt.pix }
}

/// `errno` while `doing` something with `path`, told so that one can act on it.
pub(super) fn error(path: &Path, doing: &'static str, errno: Errno) -> DeviceError {
    let path = path.to_path_buf();
    let hint = match errno {
        Errno::NODEV | Errno::NXIO => return DeviceError::Gone { path },
        Errno::BUSY => return DeviceError::Busy { path },
        Errno::NOTTY => {
            return DeviceError::Unsupported {
                path,
                what: "not a video device; `gimbald devices` lists those there are".into(),
            };
        }
        Errno::NOENT => "; `gimbald devices` lists the video devices there are",
        Errno::ACCESS | Errno::PERM => {
            "; add the user to the group that owns the device (`sudo usermod -aG video USER`, then log in again), or for a service \
             set SupplementaryGroups=video and DeviceAllow=char-video4linux rw"
        }
        Errno::NOSPC => "; not enough USB bandwidth: choose a smaller size, a lower rate or MJPG, or another USB port",
        _ => "",
    };
    DeviceError::Io { path, doing, hint, source: io::Error::from(errno) }
}

/// Calls again while a signal interrupts.
fn retry<T>(mut call: impl FnMut() -> Result<T, Errno>) -> Result<T, Errno> {
    loop {
        match call() {
            Err(Errno::INTR) => {}
            other => return other,
        }
    }
}

/// The text in a fixed-size field, up to its first zero; what is not UTF-8 (drivers cut long names anywhere) is replaced.
fn text(field: &[u8]) -> String {
    let end = field.iter().position(|&byte| byte == 0).unwrap_or(field.len());
    String::from_utf8_lossy(&field[..end]).trim().to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_cut_inside_a_letter_are_read() {
        assert_eq!(text(b"Cam\xc3"), "Cam\u{fffd}");
        assert_eq!(text(b" C920 \0rest"), "C920");
    }

    #[test]
    fn what_is_no_video_device_is_told_apart() {
        let node = Node::open(Path::new("/dev/null")).unwrap();
        let errno = node.identity().unwrap_err();
        assert!(matches!(node.error("ask", errno), DeviceError::Unsupported { .. }), "{errno}");
        let absent = Node::open(Path::new("/dev/no-such-video")).unwrap_err().to_string();
        assert!(absent.contains("/dev/no-such-video") && absent.contains("gimbald devices"), "{absent}");
        assert!(Node::open(Path::new("/dev/a\0b")).is_err(), "a zero in a path is an error, no panic");
    }
}
