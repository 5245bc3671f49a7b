//! A source that ends after a number of frames, or when the camera is silent for too long.

use crate::device::{DeviceError, FrameSource, Lent, StreamFormat};
use crate::rt::clock::monotonic_ns;
use crate::stage::timing::Timing;

use super::super::record::MAX_SILENCE;

/// Gives the frames of another source, but not too many, and does not wait forever.
pub(super) struct Limited {
    source: Box<dyn FrameSource>,
    seconds: f64,
    frames: u64,
    timing: Timing,
    came_ns: i64,
}

impl Limited {
    /// `source` until a frame comes `seconds` after the first by the camera's own clock, or `frames` have come. Where none comes for
    /// long, that is its end, too.
    pub(super) fn new(source: Box<dyn FrameSource>, seconds: f64, frames: Option<u64>) -> Self {
        let rate = source.format().rate();
        let timing = Timing::new(if rate > 0.0 { 1.0 / rate } else { 1.0 / 30.0 });
        Self { source, seconds, frames: frames.unwrap_or(u64::MAX), timing, came_ns: monotonic_ns() }
    }
}

impl FrameSource for Limited {
    fn format(&self) -> StreamFormat {
        self.source.format()
    }

    fn frames(&self) -> Option<u64> {
        let rate = self.source.format().rate();
        let timed = (rate > 0.0).then(|| (self.seconds * rate).ceil() as u64);
        [self.source.frames(), timed].into_iter().flatten().min().map(|frames| frames.min(self.frames))
    }

    fn lend(&mut self) -> Result<Lent<'_>, DeviceError> {
        if self.frames == 0 {
            return Ok(Lent::End);
        }
        match self.source.lend()? {
            Lent::Frame(frame) => {
                if self.timing.judge(&frame.stamp).time_ns as f64 / 1e9 >= self.seconds {
                    self.frames = 0;
                    return Ok(Lent::End);
                }
                self.frames -= 1;
                self.came_ns = monotonic_ns();
                Ok(Lent::Frame(frame))
            }
            Lent::Idle if monotonic_ns() - self.came_ns > MAX_SILENCE.as_nanos() as i64 => Ok(Lent::End),
            other => Ok(other),
        }
    }
}
