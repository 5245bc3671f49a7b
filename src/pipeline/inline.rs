//! The pipeline on one thread, and the totals of a run.

use super::decode::{Decoder, Reasons, Unusable};
use super::{Observer, Params, Stabilizer};
use crate::device::{DeviceError, FrameSink, FrameSource, Lent, RawFrame};
use crate::frame::{Frame, Outcome, Stage};
use crate::kernel::Level;
use crate::rt::{clock, stop::Stop};

/// What came of a whole run.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
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
    /// Frames that could not be used.
    pub damaged: u64,
    /// Frames whose end was missing, shown with the picture's before in its place.
    pub cut: u64,
    /// Frames given up because a newer one was there (live only).
    pub dropped: u64,
    /// Why frames could not be used.
    pub unusable: Reasons,
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
    run_at_level(Level::detected(), source, sink, params, stop, observer)
}

/// [`run_inline`] at a SIMD level; the pictures do not depend on it.
///
/// # Errors
/// As those of [`run_inline`].
pub fn run_at_level(
    level: Level,
    source: &mut dyn FrameSource,
    sink: &mut dyn FrameSink,
    params: &Params,
    stop: &Stop,
    observer: &mut dyn Observer,
) -> Result<Totals, DeviceError> {
    let mut stabilizer = Stabilizer::with_level(level, params, &source.format(), &sink.format());
    let (mut capture, mut totals) = (Capture::with_level(level), Totals::default());
    let mut pool = Vec::with_capacity(stabilizer.frames());
    let ended = loop {
        if stop.is_set() {
            break Ok(());
        }
        let mut frame: Box<Frame> = pool.pop().unwrap_or_else(|| stabilizer.empty_frame());
        let filled = match source.lend() {
            Ok(Lent::Frame(raw)) => capture.fill(&raw, &mut frame),
            Ok(Lent::Idle) => {
                pool.push(frame);
                continue;
            }
            Ok(Lent::End) => break Ok(()),
            Err(error) => break Err(error),
        };
        totals.count_in(&filled, frame.cut);
        stabilizer.push(frame);
        totals.emit_all(&mut stabilizer, sink, observer, |frame| pool.push(frame))?;
    };
    stabilizer.end();
    totals.emit_all(&mut stabilizer, sink, observer, drop)?;
    sink.finish()?;
    ended.map(|()| totals)
}

impl Totals {
    pub(super) fn count_in(&mut self, filled: &Result<(), Unusable>, cut: bool) {
        self.frames_in += 1;
        self.cut += u64::from(cut);
        if let Err(why) = filled {
            self.damaged += 1;
            self.unusable.add(why);
        }
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
#[derive(Debug)]
pub(super) struct Capture(Decoder);

impl Capture {
    pub(super) fn with_level(level: Level) -> Self {
        Self(Decoder::with_level(level))
    }

    /// Fills `frame`. One that cannot be used is not intact, and stays in the stream.
    ///
    /// # Errors
    /// Why it cannot be used.
    pub(super) fn fill(&mut self, raw: &RawFrame<'_>, frame: &mut Frame) -> Result<(), Unusable> {
        let started = clock::monotonic_ns();
        frame.stamp = raw.stamp;
        let filled = self.0.decode(raw, &mut frame.picture);
        frame.intact = filled.is_ok();
        frame.cut = frame.intact && self.0.is_cut();
        frame.context.spent_ns[Stage::Unpack as usize] = clock::monotonic_ns().saturating_sub(started) as u64;
        filled
    }
}
