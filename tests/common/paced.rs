//! A recorded or synthetic source in its own time, as a camera gives its frames.

use std::thread;
use std::time::Duration;

use gimbald::device::{DeviceError, FrameSource, Lent, StreamFormat};
use gimbald::rt::clock::monotonic_ns;

/// No frame is waited for longer than this: a recording may have a gap of hours.
const LONGEST_WAIT_NS: i64 = 1_000_000_000;

/// Lends each frame of another source when it is due, counted from the first, and stamps it with that time on CLOCK_MONOTONIC.
/// Frames that are asked for too late come at once; none is left out.
pub struct Paced {
    source: Box<dyn FrameSource>,
    /// What to add to a stamp to get its time on the clock.
    offset_ns: Option<i64>,
}

impl std::fmt::Debug for Paced {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Paced").field("offset_ns", &self.offset_ns).finish_non_exhaustive()
    }
}

impl Paced {
    /// Paces `source`.
    pub fn new(source: Box<dyn FrameSource>) -> Self {
        Self { source, offset_ns: None }
    }
}

impl FrameSource for Paced {
    fn format(&self) -> StreamFormat {
        self.source.format()
    }

    fn frames(&self) -> Option<u64> {
        self.source.frames()
    }

    fn lend(&mut self) -> Result<Lent<'_>, DeviceError> {
        let lent = self.source.lend()?;
        let Lent::Frame(mut frame) = lent else { return Ok(lent) };
        let now = monotonic_ns();
        let offset = self.offset_ns.get_or_insert_with(|| now.saturating_sub(frame.stamp.time_ns));
        let mut due = frame.stamp.time_ns.saturating_add(*offset);
        if due.saturating_sub(now) > LONGEST_WAIT_NS {
            due = now + LONGEST_WAIT_NS;
            *offset = due.saturating_sub(frame.stamp.time_ns);
        }
        if let Ok(wait) = u64::try_from(due.saturating_sub(now)) {
            thread::sleep(Duration::from_nanos(wait));
        }
        frame.stamp.time_ns = due;
        Ok(Lent::Frame(frame))
    }
}
