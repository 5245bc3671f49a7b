//! A V4L2 camera as a source of frames.

use std::collections::VecDeque;
use std::fmt;
use std::path::{Path, PathBuf};
use std::time::Duration;

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;

use super::super::{DeviceError, FrameSource, Lent, RawFrame, StreamFormat};
use super::find::candidates;
use super::mode::Wish;
use super::negotiate::set_mode;
use super::node::{Direction, Node};
use super::queue::{Queue, Returned};
use super::select::{Selected, best};
use super::sighting::{Roots, Sighting};
use super::stall::Stall;
use super::timeline::Timeline;
use super::transfers::{Holds, Transfers};
use crate::frame::{FrameFlags, Stamp};
use crate::image::PixelFormat;
use crate::rt::clock::monotonic_ns;
use crate::rt::log_throttle::LogThrottle;
use crate::rt::notifier::Notifier;

/// How long a lend waits for a frame before it says [`Lent::Idle`].
const POLL_TIMEOUT: Duration = Duration::from_secs(1);

/// Which camera, and what to ask of it; what is `None` is chosen by [`choose`](super::mode::choose).
#[derive(Clone, Debug, PartialEq)]
pub struct CaptureParams {
    /// Number, path or card name, as [`super::find()`] takes it.
    pub device: String,
    /// Where the camera is known to be: one of these nodes, and no other. Empty: it is searched for, by `device`.
    pub nodes: Vec<Sighting>,
    /// Nodes that are not looked at in that search.
    pub except: Vec<PathBuf>,
    /// Layout of the frames.
    pub format: Option<PixelFormat>,
    /// Luma samples in a row.
    pub width: Option<u32>,
    /// Luma rows.
    pub height: Option<u32>,
    /// Frames a second.
    pub fps: Option<f64>,
    /// Formats that are not to be chosen, where `format` is `None` and the camera has another.
    pub avoid: Vec<Avoided>,
    /// Buffers to share with the driver (2 to 32): more ride out longer delays of ours, each holds a frame in memory.
    pub buffers: u32,
}

impl Default for CaptureParams {
    fn default() -> Self {
        Self {
            device: "auto".into(),
            nodes: Vec::new(),
            except: Vec::new(),
            format: None,
            width: None,
            height: None,
            fps: None,
            avoid: Vec::new(),
            buffers: 6,
        }
    }
}

/// A format of one camera that is known not to work.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Avoided {
    /// The camera's name.
    pub card: String,
    /// Where it is plugged in.
    pub bus: String,
    /// The format.
    pub pixel: PixelFormat,
}

impl Avoided {
    /// Whether the camera of this name at this bus is opened.
    pub fn is_of(&self, card: &str, bus: &str) -> bool {
        self.card == card && self.bus == bus
    }
}

/// What became of the camera's frames since it was opened.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Frames lent.
    pub frames: u64,
    /// Frames given back unseen: so many had come that the driver had no buffer left, and newer ones were there.
    pub dropped: u64,
    /// Frames that the driver counted but did not give.
    pub missing: u64,
    /// Of those lent, the ones whose data the driver calls damaged.
    pub damaged: u64,
    /// Of those lent, the ones that are too short.
    pub truncated: u64,
    /// Frames whose time was on no clock of ours, and was replaced by that of their arrival.
    pub foreign_times: u64,
    /// Times the stream was stopped and started.
    pub restarts: u64,
    /// Transfers that failed: the driver gave its buffers back without a frame.
    pub failed_transfers: u64,
}

impl fmt::Display for Counts {
    /// As people say it: what did not happen is left out.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { frames, dropped, missing, damaged, truncated, foreign_times, restarts, failed_transfers } = *self;
        write!(f, "{frames} frames")?;
        for (count, what) in [
            (dropped, "stale"),
            (missing, "missing"),
            (damaged, "damaged"),
            (truncated, "cut short"),
            (foreign_times, "without a valid time stamp"),
            (restarts, if restarts == 1 { "restart" } else { "restarts" }),
            (failed_transfers, if failed_transfers == 1 { "failed transfer" } else { "failed transfers" }),
        ] {
            if count > 0 {
                write!(f, ", {count} {what}")?;
            }
        }
        Ok(())
    }
}

/// An open, streaming camera.
#[derive(Debug)]
pub struct Capture {
    queue: Queue,
    wake: Notifier,
    format: StreamFormat,
    next_best: Option<PixelFormat>,
    /// Bytes of a whole frame; 0 for compressed formats.
    whole: usize,
    /// The buffer that is lent, and those that will be next.
    lent: Option<usize>,
    ready: VecDeque<(Returned, Stamp)>,
    timeline: Timeline,
    counts: Counts,
    /// The stream failed and was restarted, and no frame came since.
    restarted: bool,
    stall: Stall,
    transfers: Transfers,
    failures_logged: LogThrottle,
}

impl Capture {
    /// The format in which the camera would give its frames, and its node; it is not started (no light comes on), but left in
    /// that format.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn probe(params: &CaptureParams) -> Result<(StreamFormat, PathBuf), DeviceError> {
        agree(params).map(|agreed| (agreed.format, agreed.node.path().to_path_buf()))
    }

    /// Opens the camera, sets its format and rate, and starts it. A notification of `wake` ends a waiting [`FrameSource::lend`] at once.
    ///
    /// # Errors
    /// [`DeviceError::Busy`] where another program streams from it, [`DeviceError::Gone`] where it goes away meanwhile,
    /// [`DeviceError::Unsupported`] where it is no camera or cannot do what is asked, else [`DeviceError::Io`].
    pub fn open(params: &CaptureParams, wake: Notifier) -> Result<Self, DeviceError> {
        let Agreed { node, format, next_best } = agree(params)?;
        let path = node.path().to_path_buf();
        let whole = format.frame_bytes().unwrap_or(0);
        let queue = Queue::new(node, Direction::Capture, params.buffers.clamp(2, 32))?;
        if queue.len() < 2 || queue.capacity() < whole {
            let what = format!(
                "the driver allocated {} buffers of {} bytes; at least 2 of {whole} are required for {} {}x{}",
                queue.len(),
                queue.capacity(),
                format.pixel,
                format.width,
                format.height
            );
            return Err(DeviceError::Unsupported { path, what });
        }
        let mut capture = Self {
            ready: VecDeque::with_capacity(queue.len()),
            queue,
            wake,
            format,
            next_best,
            whole,
            lent: None,
            timeline: Timeline::default(),
            counts: Counts::default(),
            restarted: false,
            stall: Stall::new(),
            transfers: Transfers::default(),
            failures_logged: LogThrottle::default(),
        };
        capture.start()?;
        tracing::info!(
            camera = %path.display(), format = %format.pixel, width = format.width, height = format.height,
            fps = format.rate(), buffers = capture.queue.len(), "camera opened"
        );
        Ok(capture)
    }

    /// The camera's node.
    pub fn path(&self) -> &Path {
        self.queue.node().path()
    }

    /// The camera's name and the bus it sits on; empty where it does not say.
    pub fn name_and_bus(&self) -> (String, String) {
        self.queue.node().identity().map_or_else(|_| Default::default(), |identity| (identity.card, identity.bus))
    }

    /// What became of the frames so far.
    pub fn counts(&self) -> Counts {
        let Timeline { missing, foreign_times, .. } = self.timeline;
        Counts { missing, foreign_times, failed_transfers: self.transfers.failed, ..self.counts }
    }

    /// The format that would be chosen for this camera if it did not have the present one; `None` where the format was asked for, or
    /// it has no other.
    pub fn next_best(&self) -> Option<PixelFormat> {
        self.next_best
    }

    /// Gives every buffer to the driver and starts the stream.
    fn start(&mut self) -> Result<(), DeviceError> {
        self.lent = None;
        self.ready.clear();
        while let Some(index) = self.queue.free() {
            self.queue.enqueue(index, 0, 0).map_err(|errno| self.queue.node().error("give a buffer to", errno))?;
        }
        self.queue.start().map_err(|errno| self.queue.node().error("start the stream of", errno))?;
        self.stall.started(monotonic_ns());
        Ok(())
    }

    /// Stops and starts the stream; a frame that is lent goes home.
    ///
    /// # Errors
    /// Where the camera refuses, or is gone.
    pub fn restart(&mut self) -> Result<(), DeviceError> {
        self.counts.restarts += 1;
        self.timeline.restart();
        self.queue.stop().map_err(|errno| self.queue.node().error("stop the stream of", errno))?;
        self.start()
    }

    /// After `errno` while `doing` something: restarts the stream, once until a frame comes. A driver that was told to stop
    /// and start has forgotten most of what can go wrong.
    fn recover(&mut self, doing: &'static str, errno: Errno) -> Result<(), DeviceError> {
        let error = self.queue.node().error(doing, errno);
        if self.restarted || matches!(error, DeviceError::Gone { .. }) {
            return Err(error);
        }
        tracing::warn!(%error, "restarting the stream");
        self.restarted = true;
        self.restart()
    }

    /// Waits for the camera; `None` where timeout ran out or a notification came, else what poll says of the camera.
    fn wait(&mut self) -> Option<PollFlags> {
        let camera = PollFlags::IN;
        let mut fds =
            [PollFd::from_borrowed_fd(self.queue.node().fd(), camera), PollFd::from_borrowed_fd(self.wake.fd(), PollFlags::IN)];
        let timeout = Timespec { tv_sec: POLL_TIMEOUT.as_secs().cast_signed(), tv_nsec: POLL_TIMEOUT.subsec_nanos().into() };
        // A signal (EINTR) ends the wait too: the caller checks its flags.
        poll(&mut fds, Some(&timeout)).ok()?;
        let (camera, notified) = (fds[0].revents(), fds[1].revents());
        if !notified.is_empty() {
            self.wake.clear();
            return None;
        }
        (!camera.is_empty()).then_some(camera)
    }

    /// Takes the frames that are there, in order. Where all buffers are full the driver loses frames, and the picture is late: then
    /// only the newest is kept.
    fn receive(&mut self) -> Result<(), Errno> {
        while self.ready.len() < self.queue.len() {
            let Some(returned) = self.queue.dequeue()? else { break };
            let now_ns = monotonic_ns();
            if let Holds::Nothing { is_new } = self.transfers.look(&returned, now_ns) {
                self.queue.enqueue(returned.index, 0, 0)?;
                self.transfer_failed(is_new, now_ns)?;
                continue;
            }
            let stamp = self.timeline.stamp(returned.sequence, returned.time, now_ns);
            self.ready.push_back((returned, stamp));
        }
        // One more was given back just now, too late to be filled.
        if self.ready.len() + 1 >= self.queue.len() {
            for (stale, _) in self.ready.drain(..self.ready.len().saturating_sub(1)) {
                self.queue.enqueue(stale.index, 0, 0)?;
                self.counts.dropped += 1;
            }
        }
        Ok(())
    }

    fn transfer_failed(&mut self, is_new: bool, now_ns: i64) -> Result<(), Errno> {
        self.stall.transfer_failed();
        if is_new && self.failures_logged.is_due(now_ns) {
            let failed = self.transfers.failed;
            tracing::warn!(camera = %self.path().display(), failed, "a transfer from the camera failed, continuing");
        }
        if self.transfers.are_hopeless() { Err(Errno::IO) } else { Ok(()) }
    }

    /// Restarts the stream of a camera that gives nothing for long.
    fn restart_if_stalled(&mut self) -> Result<(), DeviceError> {
        let Some(stalled) = self.stall.look(monotonic_ns()) else { return Ok(()) };
        if stalled.is_new {
            tracing::warn!(camera = %self.path().display(), "{stalled}");
        }
        self.restart()
    }
}

/// What was agreed with a camera.
struct Agreed {
    node: Node,
    format: StreamFormat,
    next_best: Option<PixelFormat>,
}

/// Opens the camera and sets its format and rate.
fn agree(params: &CaptureParams) -> Result<Agreed, DeviceError> {
    let paths = if params.nodes.is_empty() {
        candidates(&params.device, Direction::Capture, &params.except)?
    } else {
        params.nodes.iter().map(|seen| seen.node.clone()).collect()
    };
    let asked = Wish { format: params.format, width: params.width, height: params.height, fps: params.fps };
    let Selected { node, mode, next_best } = best(&paths, &asked, &params.avoid)?;
    // While it is open, nothing else gets its number: what has it now had it when it was opened.
    if let Some(opened) = params.nodes.iter().find(|seen| seen.node == node.path())
        && !Roots::default().at(node.path()).is_some_and(|seen| seen.is_same(opened))
    {
        return Err(DeviceError::Gone { path: node.path().to_path_buf() });
    }
    let format = set_mode(&node, &mode, &asked)?;
    Ok(Agreed { node, format, next_best })
}

impl FrameSource for Capture {
    fn format(&self) -> StreamFormat {
        self.format
    }

    fn lend(&mut self) -> Result<Lent<'_>, DeviceError> {
        if let Some(index) = self.lent.take()
            && let Err(errno) = self.queue.enqueue(index, 0, 0)
        {
            self.recover("give a buffer back to", errno)?;
        }
        let (returned, mut stamp) = loop {
            if let Some(next) = self.ready.pop_front() {
                break next;
            }
            let Some(events) = self.wait() else {
                self.restart_if_stalled()?;
                return Ok(Lent::Idle);
            };
            if events.contains(PollFlags::HUP) {
                return Err(DeviceError::Gone { path: self.path().to_path_buf() });
            }
            match self.receive() {
                // POLLERR stays until something is done about it.
                Ok(()) if self.ready.is_empty() && events.intersects(PollFlags::ERR | PollFlags::NVAL) => {
                    self.recover("stream from", Errno::IO)?;
                }
                Ok(()) => {}
                Err(errno) => self.recover("take a frame from", errno)?,
            }
        };
        self.lent = Some(returned.index);
        self.restarted = false;
        self.stall.frame(monotonic_ns());
        self.counts.frames += 1;
        if returned.error {
            stamp.flags = stamp.flags.with(FrameFlags::ERROR);
            self.counts.damaged += 1;
        }
        if returned.bytes < self.whole.max(1) {
            stamp.flags = stamp.flags.with(FrameFlags::TRUNCATED);
            self.counts.truncated += 1;
        }
        let bytes = self.queue.bytes(returned.index);
        let bytes = bytes.get(..returned.bytes).unwrap_or(bytes);
        Ok(Lent::Frame(RawFrame { format: self.format, bytes, stamp }))
    }
}

impl Drop for Capture {
    fn drop(&mut self) {
        tracing::info!(camera = %self.path().display(), "camera closed: {}", self.counts());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_are_said_in_words() {
        assert_eq!(Counts { frames: 3, ..Counts::default() }.to_string(), "3 frames");
        let many = Counts { frames: 9, missing: 2, restarts: 1, failed_transfers: 3, ..Counts::default() };
        assert_eq!(many.to_string(), "9 frames, 2 missing, 1 restart, 3 failed transfers");
    }
}
