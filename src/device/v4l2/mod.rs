//! Real devices: V4L2 cameras and v4l2loopback.
//!
//! The only part of the device floor with `unsafe`: `node` (ioctls), `create` (one more) and `queue` (memory shared with the driver). Everything else
//! here uses those two safely.

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
mod viewers;

pub use again::{Known, Next, There};
pub use capture::{Avoided, Capture, CaptureParams, Counts};
pub use enumerate::{DeviceInfo, FormatInfo, devices};
pub use find::find;
pub use hotplug::{Hotplug, News};
pub use loopback::{Loopback, LoopbackParams};
pub use mode::{Intervals, Mode, Sizes, Wish, choose};
pub use node::Direction;
pub use sighting::{Device, Roots, Sighting, Usb};
pub use viewers::Viewers;

/// What to do where there is no loopback device.
const LOAD_LOOPBACK: &str = "load v4l2loopback: `sudo modprobe v4l2loopback exclusive_caps=1 card_label=gimbald` \
    (package v4l2loopback-dkms)";
