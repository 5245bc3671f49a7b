//! The journey on one thread, and what came of it.

use super::{Observer, Params, Stabilizer};
use crate::device::{DeviceError, FrameSink, FrameSource, Lent, RawFrame};
use crate::frame::{Frame, FrameFlags, Outcome, Stage};
use crate::rt::{clock, stop::Stop};
use crate::stage::unpack;

/// What came of a whole run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Totals {
    /// Frames the source gave.
    pub frames_in: u64,
    /// Frames the sink took.
    pub frames_out: u64,
    /// Of these, stabilized.
    pub stabilized: u64,
    /// Of these, pictures shown again.
    pub held: u64,
    /// Of these, shown uncorrected.
    pub passed_through: u64,
    /// Frames whose data was damaged.
    pub damaged: u64,
    /// Frames given up because a newer one was there (live only).
    pub dropped: u64,
}

/// Carries every frame of `source` to `sink` on the caller's thread. Ends when the source ends or `stop` is set.
///
/// # Errors
/// What source and sink report; frames sent before stay sent, those that wait are sent where that can be, and the sink is
/// finished.
pub fn run_inline(
    source: &mut dyn FrameSource,
    sink: &mut dyn FrameSink,
    params: &Params,
    stop: &Stop,
    observer: &mut dyn Observer,
) -> Result<Totals, DeviceError> {
    let mut stabilizer = Stabilizer::new(params, &source.format(), &sink.format());
    let (mut capture, mut totals) = (Capture::default(), Totals::default());
    let mut pool = Vec::with_capacity(stabilizer.frames());
    let ended = loop {
        if stop.is_set() {
            break Ok(());
        }
        let mut frame: Box<Frame> = pool.pop().unwrap_or_else(|| stabilizer.empty_frame());
        match source.lend() {
            Ok(Lent::Frame(raw)) => capture.fill(&raw, &mut frame),
            Ok(Lent::Idle) => {
                pool.push(frame);
                continue;
            }
            Ok(Lent::End) => break Ok(()),
            Err(error) => break Err(error),
        }
        totals.count_in(&frame);
        stabilizer.take_in(frame);
        totals.emit_all(&mut stabilizer, sink, observer, |frame| pool.push(frame))?;
    };
    stabilizer.end();
    totals.emit_all(&mut stabilizer, sink, observer, drop)?;
    sink.finish()?;
    ended.map(|()| totals)
}

impl Totals {
    pub(super) fn count_in(&mut self, frame: &Frame) {
        self.frames_in += 1;
        self.damaged += u64::from(!frame.intact);
    }

    /// Sends all that is ready and gives back what is not needed any more.
    pub(super) fn emit_all(
        &mut self,
        stabilizer: &mut Stabilizer,
        sink: &mut dyn FrameSink,
        observer: &mut dyn Observer,
        mut give_back: impl FnMut(Box<Frame>),
    ) -> Result<(), DeviceError> {
        while let Some(outcome) = stabilizer.emit(sink, observer)? {
            self.frames_out += 1;
            match outcome {
                Outcome::Stabilized | Outcome::Pending => self.stabilized += 1,
                Outcome::Held(_) => self.held += 1,
                Outcome::PassedThrough(_) => self.passed_through += 1,
            }
        }
        while let Some(frame) = stabilizer.give_back() {
            give_back(frame);
        }
        Ok(())
    }
}

/// The first step: raw bytes into a frame.
#[derive(Debug, Default)]
pub(super) struct Capture(unpack::Unpack);

impl Capture {
    /// Fills `frame`; a frame whose data is damaged is not intact, and that is all.
    pub(super) fn fill(&mut self, raw: &RawFrame<'_>, frame: &mut Frame) {
        let started = clock::monotonic_ns();
        let RawFrame { format, bytes, stamp } = *raw;
        frame.stamp = stamp;
        frame.intact = !stamp.flags.contains(FrameFlags::ERROR)
            && self.0.unpack(format.pixel, (format.width, format.height), format.stride, bytes, &mut frame.picture).is_ok();
        frame.context.spent_ns[Stage::Unpack as usize] = clock::monotonic_ns().saturating_sub(started) as u64;
    }
}
