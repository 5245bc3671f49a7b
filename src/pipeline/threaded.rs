//! The pipeline on two threads: one captures and decodes, the calling thread does the rest.
//!
//! Frames live in a pool: empty ones go to the capture thread through a free list, full ones come back through a mailbox. Live,
//! the mailbox holds a few frames, so that a machine that was busy for a moment loses none; where it stays too slow, only the newest
//! is taken, so latency never builds up. From a file nothing is given up and the faster side waits. Each loop ends when the channel
//! before it closes.

use std::time::Duration;

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, TryRecvError, bounded};

use super::{Capture, Live, Observer, Params, Stabilizer, Totals};
use crate::device::{DeviceError, FrameSink, FrameSource, Lent};
use crate::frame::Frame;
use crate::kernel::Level;
use crate::rt::stop::Stop;

/// Live, a sink that gets no frame for this long is told so, and again after as long.
const IDLE: Duration = Duration::from_millis(500);

/// Live, frames that may wait.
const MAX_WAITING: usize = 3;

/// Live, this many frames in a row behind which another waits mean that the machine is too slow for all of them.
const TOO_LATE: u32 = 15;

/// What happens when frames come faster than they can be carried.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pace {
    /// Those that wait too long go, the stalest first.
    Live,
    /// The source waits.
    Lossless,
}

/// As [`super::run_inline`], with capture and decoding on a thread of their own.
///
/// # Errors
/// As [`super::run_inline`].
pub fn run_threaded(
    source: &mut dyn FrameSource,
    sink: &mut dyn FrameSink,
    params: &Params,
    stop: &Stop,
    observer: &mut dyn Observer,
    pace: Pace,
) -> Result<Totals, DeviceError> {
    run(source, sink, (params, &Live::new(params)), stop, observer, pace)
}

/// As [`run_threaded`] at a camera's pace, with settings that may change meanwhile: begins with `params` and takes every change of
/// `live` with the next frame.
///
/// # Errors
/// As [`super::run_inline`].
pub fn run_live(
    source: &mut dyn FrameSource,
    sink: &mut dyn FrameSink,
    params: &Params,
    live: &Live,
    stop: &Stop,
    observer: &mut dyn Observer,
) -> Result<Totals, DeviceError> {
    run(source, sink, (params, live), stop, observer, Pace::Live)
}

fn run(
    source: &mut dyn FrameSource,
    sink: &mut dyn FrameSink,
    (params, live): (&Params, &Live),
    stop: &Stop,
    observer: &mut dyn Observer,
    pace: Pace,
) -> Result<Totals, DeviceError> {
    let mut stabilizer = Stabilizer::new(params, &source.format(), &sink.format());
    live.begin();
    let (free, empty) = bounded::<Box<Frame>>(stabilizer.frames());
    for _ in 0..stabilizer.frames() {
        // the channel has room for every frame there is, so neither this nor giving back ever fails
        let _ = free.send(stabilizer.empty_frame());
    }
    let (full, mailbox) = bounded::<Box<Frame>>(match pace {
        Pace::Live => MAX_WAITING,
        Pace::Lossless => 2,
    });
    let stealing = (pace == Pace::Live).then(|| mailbox.clone());
    let over = &Stop::default();
    // while this end lives, a frame given back always has a receiver and is never freed on the frame path
    let _pool = empty.clone();
    std::thread::scope(|scope| {
        let capture = std::thread::Builder::new().name("capture".into()).spawn_scoped(scope, move || {
            let hand_over = HandOver { empty, full, stealing, live };
            hand_over.run(source, || stop.is_set() || over.is_set())
        });
        let capture = capture.map_err(|error| DeviceError::io("capture thread", "start", error))?;
        let mut totals = Totals::default();
        let sent = carry(&mailbox, &free, pace, (&mut stabilizer, live), sink, observer, &mut totals);
        // where nothing can be sent any more, a source that gives nothing must not be asked forever
        over.set();
        drop((mailbox, free));
        let (captured, ended) = capture.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        totals.frames_in = captured.frames_in;
        (totals.damaged, totals.cut) = (captured.damaged, captured.cut);
        totals.unusable = captured.unusable;
        totals.dropped += captured.dropped;
        sent?;
        sink.finish()?;
        ended.map(|()| totals)
    })
}

/// The caller's side: until the mailbox closes.
fn carry(
    mailbox: &Receiver<Box<Frame>>,
    free: &Sender<Box<Frame>>,
    pace: Pace,
    (stabilizer, live): (&mut Stabilizer, &Live),
    sink: &mut dyn FrameSink,
    observer: &mut dyn Observer,
    totals: &mut Totals,
) -> Result<(), DeviceError> {
    let give_back = |frame| {
        let _ = free.send(frame);
    };
    let (mut seen, mut late) = (0, 0u32);
    loop {
        let next = match pace {
            Pace::Live => mailbox.recv_timeout(IDLE),
            Pace::Lossless => mailbox.recv().map_err(RecvTimeoutError::from),
        };
        match next {
            Ok(mut frame) => {
                late = if mailbox.is_empty() { 0 } else { late.saturating_add(1) };
                while pace == Pace::Live
                    && late > TOO_LATE
                    && let Ok(newer) = mailbox.try_recv()
                {
                    give_back(std::mem::replace(&mut frame, newer));
                    totals.dropped += 1;
                    live.count_dropped();
                }
                if let Some(params) = live.changed_since(&mut seen) {
                    stabilizer.set_params(&params);
                }
                stabilizer.push(frame);
                totals.emit_all(stabilizer, sink, observer, give_back)?;
            }
            Err(RecvTimeoutError::Timeout) => sink.idle()?,
            Err(RecvTimeoutError::Disconnected) => break,
        }
    }
    stabilizer.end();
    totals.emit_all(stabilizer, sink, observer, give_back)
}

/// The capture thread's ends of the channels.
struct HandOver<'a> {
    empty: Receiver<Box<Frame>>,
    full: Sender<Box<Frame>>,
    /// Live: where a stale frame is taken back from. From a file there is none, so that the channel closes with the other side.
    stealing: Option<Receiver<Box<Frame>>>,
    live: &'a Live,
}

impl HandOver<'_> {
    /// Until the source ends, it `is_over` or the frames have no receiver any more.
    fn run(self, source: &mut dyn FrameSource, is_over: impl Fn() -> bool) -> (Totals, Result<(), DeviceError>) {
        let (mut capture, mut totals) = (Capture::with_level(Level::detected()), Totals::default());
        let mut spare = None;
        while !is_over() {
            let Some(mut frame) = spare.take().or_else(|| self.next_empty(&mut totals)) else { break };
            let filled = match source.lend() {
                Ok(Lent::Frame(raw)) => capture.fill(&raw, &mut frame),
                Ok(Lent::Idle) => {
                    spare = Some(frame);
                    continue;
                }
                Ok(Lent::End) => break,
                Err(error) => return (totals, Err(error)),
            };
            totals.count_in(&filled, frame.cut);
            self.live.count_in(&filled, frame.cut);
            if !self.send(frame, &mut spare, &mut totals) {
                break;
            }
        }
        (totals, Ok(()))
    }

    /// A frame to fill. Live, where none is free, the one that waits in the mailbox: it is staler than the one to come.
    fn next_empty(&self, totals: &mut Totals) -> Option<Box<Frame>> {
        if let Some(stealing) = &self.stealing {
            match self.empty.try_recv() {
                Ok(frame) => return Some(frame),
                Err(TryRecvError::Disconnected) => return None,
                Err(TryRecvError::Empty) => {}
            }
            if let Ok(stale) = stealing.try_recv() {
                totals.dropped += 1;
                self.live.count_dropped();
                return Some(stale);
            }
        }
        self.empty.recv().ok()
    }

    /// Hands a frame over; false where there is no receiver any more.
    fn send(&self, frame: Box<Frame>, spare: &mut Option<Box<Frame>>, totals: &mut Totals) -> bool {
        let Some(stealing) = &self.stealing else { return self.full.send(frame).is_ok() };
        let Err(error) = self.full.try_send(frame) else { return true };
        if error.is_disconnected() {
            return false;
        }
        if let Ok(stale) = stealing.try_recv() {
            totals.dropped += 1;
            self.live.count_dropped();
            *spare = Some(stale);
        }
        self.full.send(error.into_inner()).is_ok()
    }
}
