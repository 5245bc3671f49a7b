//! A node's controls and events.

use rustix::io::Errno;
use rustix::ioctl::{Opcode, Updater, ioctl, opcode};
use v4l::v4l_sys::{V4L2_EVENT_SUB_FL_SEND_INITIAL, v4l2_control, v4l2_event, v4l2_event_subscription};
use v4l::v4l2::vidioc;

use super::{Node, Zeroed, retry};

// SAFETY: C structs of integers, and of unions of those.
unsafe impl Zeroed for v4l2_event {}
// SAFETY: as above.
unsafe impl Zeroed for v4l2_event_subscription {}

/// Requests that the v4l crate does not name.
const SUBSCRIBE: Opcode = opcode::write::<v4l2_event_subscription>(b'V', 90);
const NEXT_EVENT: Opcode = opcode::read::<v4l2_event>(b'V', 89);

/// An event that a node tells.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in super::super) struct Event {
    /// Its kind: a V4L2_EVENT_ number.
    pub(in super::super) kind: u32,
    /// The first word of what it says.
    pub(in super::super) word: u32,
}

impl Node {
    /// VIDIOC_G_CTRL: the value of a control.
    pub(in super::super) fn control(&self, id: u32) -> Result<i32, Errno> {
        let mut control = v4l2_control { id, value: 0 };
        // SAFETY: G_CTRL fills a v4l2_control, which holds no pointer.
        unsafe { self.update::<{ vidioc::VIDIOC_G_CTRL as Opcode }, _>(&mut control)? };
        Ok(control.value)
    }

    /// VIDIOC_S_CTRL: sets a control.
    pub(in super::super) fn set_control(&self, id: u32, value: i32) -> Result<(), Errno> {
        let mut control = v4l2_control { id, value };
        // SAFETY: S_CTRL reads a v4l2_control, which holds no pointer.
        unsafe { self.update::<{ vidioc::VIDIOC_S_CTRL as Opcode }, _>(&mut control) }
    }

    /// VIDIOC_SUBSCRIBE_EVENT, the present state first where there is one.
    pub(in super::super) fn subscribe(&self, kind: u32) -> Result<(), Errno> {
        let flags = V4L2_EVENT_SUB_FL_SEND_INITIAL;
        let mut wish = v4l2_event_subscription { type_: kind, flags, ..v4l2_event_subscription::zeroed() };
        // SAFETY: SUBSCRIBE_EVENT reads a v4l2_event_subscription, which holds no pointer.
        retry(|| unsafe { ioctl(&self.fd, Updater::<SUBSCRIBE, _>::new(&mut wish)) })
    }

    /// VIDIOC_DQEVENT: the event that came first, `None` where there is none.
    pub(in super::super) fn next_event(&self) -> Result<Option<Event>, Errno> {
        let mut event = v4l2_event::zeroed();
        // SAFETY: DQEVENT fills a v4l2_event, which holds no pointer.
        match retry(|| unsafe { ioctl(&self.fd, Updater::<NEXT_EVENT, _>::new(&mut event)) }) {
            // SAFETY: every bit pattern is an array of bytes.
            Ok(()) => Ok(Some(Event { kind: event.type_, word: first_word(unsafe { &event.u.data }) })),
            // V4L2 says ENOENT where a queue is empty.
            Err(Errno::NOENT | Errno::AGAIN) => Ok(None),
            Err(errno) => Err(errno),
        }
    }
}

fn first_word(data: &[u8; 64]) -> u32 {
    u32::from_ne_bytes([data[0], data[1], data[2], data[3]])
}
