//! Creates a loopback device through v4l2loopback's control device.

use std::ffi::c_void;
use std::os::fd::OwnedFd;
use std::path::{Path, PathBuf};
use std::time::Duration;

use rustix::fs::{Mode, OFlags};
use rustix::io::Errno;
use rustix::ioctl::{Ioctl, IoctlOutput, Opcode, ioctl};

use super::super::DeviceError;
use super::LOAD_LOOPBACK;
use super::node::Node;

/// The module's control device; its owner alone may write to it unless a udev rule says otherwise.
const CONTROL: &str = "/dev/v4l2loopback";
/// The label of a device that was not asked for by one.
const LABEL: &str = "gimbald";
/// How long its node may take to appear, and how often it is looked for.
const APPEARS: (u32, Duration) = (100, Duration::from_millis(20));

/// Makes the device that `device` asks for: that number, or any with that label. Readers see it as a camera while it is written to
/// (`exclusive_caps`).
///
/// # Errors
/// [`DeviceError::Unsupported`] where the module is not loaded or too old, [`DeviceError::Io`] where it refuses, and where this
/// process may not ask it.
pub(super) fn create(device: &str) -> Result<PathBuf, DeviceError> {
    let control = Path::new(CONTROL);
    let flags = OFlags::RDWR | OFlags::CLOEXEC;
    let fd = rustix::fs::open(control, flags, Mode::empty()).map_err(|errno| match errno {
        Errno::NOENT | Errno::NXIO | Errno::NODEV => DeviceError::Unsupported {
            path: control.to_path_buf(),
            what: format!("does not exist, so no loopback device can be created; {LOAD_LOOPBACK}"),
        },
        errno => DeviceError::Io {
            path: control.to_path_buf(),
            doing: "create a loopback device with it: open",
            hint: "; only root can, or the group in a udev rule: KERNEL==\"v4l2loopback\", GROUP=\"video\", MODE=\"0660\"",
            source: errno.into(),
        },
    })?;
    let number = add(&fd, &Request::of(device)).map_err(|errno| match errno {
        Errno::NOSYS | Errno::NOTTY => DeviceError::Unsupported {
            path: control.to_path_buf(),
            what: "this version of v4l2loopback cannot create devices at run time (0.13 and later can); use its module parameter `devices=`"
                .into(),
        },
        errno => DeviceError::io(control, "create a loopback device with it", errno.into()),
    })?;
    let path = PathBuf::from(format!("/dev/video{number}"));
    // udev gives it its permissions a moment later.
    let there = (0..APPEARS.0).any(|_| {
        Node::open(&path).is_ok() || {
            std::thread::sleep(APPEARS.1);
            false
        }
    });
    tracing::info!(loopback = %path.display(), there, "loopback device made");
    Ok(path)
}

/// The module's `struct v4l2_loopback_config`; zeros are its defaults.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C)]
struct Request {
    /// -1: any.
    number: i32,
    unused: i32,
    label: [u8; 32],
    min_width: u32,
    max_width: u32,
    min_height: u32,
    max_height: u32,
    /// As many as the module was loaded with: 0.13 refuses to show a buffer beyond those, though it gives it.
    max_buffers: i32,
    max_openers: i32,
    debug: i32,
    /// 0 is exclusive_caps=1.
    announce_all_caps: i32,
}

impl Request {
    fn of(device: &str) -> Self {
        let device = device.trim();
        let digits = device.strip_prefix("/dev/video").unwrap_or(device);
        let number: i32 = digits.parse().unwrap_or(-1).max(-1);
        let named = number < 0 && !device.is_empty() && !device.eq_ignore_ascii_case("auto") && !device.starts_with('/');
        let text = if named { device } else { LABEL };
        let mut label = [0; 32];
        // Cut between letters, with room for the zero at the end.
        let end = (0..label.len()).rev().find(|&end| text.is_char_boundary(end)).unwrap_or(0).min(text.len());
        label[..end].copy_from_slice(&text.as_bytes()[..end]);
        Self { number, unused: number, label, ..Self::default() }
    }
}

/// V4L2LOOPBACK_CTL_ADD by its first number, which every version takes. Gives the new device's.
fn add(control: &OwnedFd, request: &Request) -> Result<i32, Errno> {
    let mut request = *request;
    // SAFETY: the control device reads one v4l2_loopback_config, which `Request` is, field by field; it holds no pointer.
    unsafe { ioctl(control, Add(&mut request)) }
}

struct Add<'a>(&'a mut Request);

// SAFETY: the pointer is to a `Request` that is exclusively ours for as long as the call lasts; the output is the call's own value.
unsafe impl Ioctl for Add<'_> {
    type Output = i32;
    const IS_MUTATING: bool = true;

    fn opcode(&self) -> Opcode {
        0x4c80
    }

    fn as_ptr(&mut self) -> *mut c_void {
        std::ptr::from_mut(self.0).cast()
    }

    unsafe fn output_from_ptr(out: IoctlOutput, _: *mut c_void) -> rustix::io::Result<i32> {
        Ok(out)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_request_says_what_was_asked_for() {
        assert_eq!(size_of::<Request>(), 72);
        let label = |request: &Request| String::from_utf8_lossy(&request.label).trim_end_matches('\0').to_string();
        for (device, number, name) in [
            ("auto", -1, "gimbald"),
            ("", -1, "gimbald"),
            ("7", 7, "gimbald"),
            ("/dev/video12", 12, "gimbald"),
            ("/dev/v4l/by-id/x", -1, "gimbald"),
            ("Steady cam", -1, "Steady cam"),
            ("-5", -1, "-5"),
        ] {
            let request = Request::of(device);
            assert_eq!((request.number, label(&request).as_str()), (number, name), "{device}");
        }
        let long = Request::of(&"ä".repeat(30));
        assert_eq!((label(&long), long.label[31]), ("ä".repeat(15), 0), "cut between letters");
    }
}
