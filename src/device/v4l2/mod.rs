//! Real devices: V4L2 cameras and v4l2loopback.
//!
//! The only part of the device floor with `unsafe`: `node` and `create` (ioctls), and `queue` (memory shared with the driver). Everything
//! else here uses these three safely.

mod again;
mod capture;
mod create;
mod enumerate;
mod find;
mod hotplug;
mod loopback;
mod mode;
mod negotiate;
mod node;
mod queue;
mod role;
mod select;
mod sighting;
mod stall;
mod timeline;
mod transfers;
mod version;
mod viewers;

pub(crate) use again::{Known, Next, There};
pub(crate) use capture::Avoided;
pub use capture::{Capture, CaptureParams, Counts};
pub use enumerate::{DeviceInfo, FormatInfo, devices};
pub use find::find;
pub(crate) use hotplug::{Hotplug, News};
pub use loopback::{Loopback, LoopbackParams};
pub use mode::{Mode, choose};
pub use node::Direction;
pub(crate) use sighting::{Device, Roots};
pub(crate) use version::LoopbackVersion;
pub use viewers::Viewers;

/// Loads v4l2loopback with what gimbald needs: `exclusive_caps` so that browsers recognize a camera, `max_buffers` so that a slow reader
/// gets whole frames. A macro, so that other texts can contain it.
macro_rules! load_command {
    () => {
        "sudo modprobe v4l2loopback exclusive_caps=1 max_buffers=8 card_label=gimbald"
    };
}

/// The command that loads v4l2loopback for gimbald.
pub const LOAD_COMMAND: &str = load_command!();

/// What to do if there is no loopback device.
const LOAD_LOOPBACK: &str = concat!("load v4l2loopback: `", load_command!(), "` (package v4l2loopback-dkms)");
