//! The journey on two threads: the same pictures as on one, in order, nothing stuck, nothing lost that is not counted.

mod common;

use common::paced::Paced;
use common::{Memory, Script, Shot, film, in_time};
use gimbald::device::digest::DigestSink;
use gimbald::device::null::NullSink;
use gimbald::device::synthetic::{self, Motion};
use gimbald::device::{DeviceError, FrameSink, FrameSource, Lent, RawFrame, StreamFormat};
use gimbald::frame::Stamp;
use gimbald::image::{PictureMut, PixelFormat};
use gimbald::pipeline::{Pace, Params, Totals, run_inline, run_threaded};
use gimbald::rt::clock::monotonic_ns;
use gimbald::rt::stop::Stop;
use gimbald::stage::shutter::{self, Model, Parameters};
use gimbald::stage::smooth;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU32, Ordering::Relaxed};
use std::sync::{Arc, mpsc};
use std::thread;
use std::time::{Duration, Instant};

/// Nothing here takes a tenth of this, even on a slow machine: who is not back by then is stuck.
const TIMEOUT: Duration = Duration::from_secs(60);

/// Both models and both parameter sets, with look-ahead and without.
fn all() -> [Params; 6] {
    let models =
        [(Model::Cho2007, Parameters::TimeT), (Model::Cho2007, Parameters::TimeT1), (Model::Continuous, Parameters::TimeT)];
    std::array::from_fn(|n| {
        let (model, parameters) = models[n % 3];
        let smooth = smooth::Params { lookahead_ms: if n < 3 { 0.0 } else { 200.0 }, ..smooth::Params::default() };
        Params { shutter: shutter::Params { model, parameters }, smooth, ..Params::default() }
    })
}

fn shaken(frames: u64) -> Vec<Shot> {
    film(&synthetic::Params { width: 160, height: 120, frames, motion: Motion::Walk, ..synthetic::Params::default() })
}

/// A stream in which much happens: motion, damage, repeats, a cut.
fn eventful() -> Vec<Shot> {
    let mut shots = shaken(40);
    for n in [0, 7, 8, 20] {
        shots[n] = shots[n].clone().damaged();
    }
    shots[12] = shots[11].clone();
    shots.swap(30, 3);
    in_time(&mut shots, 30.0);
    shots
}

/// Runs `what` on a thread of its own and gives what it gives; ends the test where it does not come back.
fn in_time_or_stuck<T: Send + 'static>(what: &str, run: impl FnOnce() -> T + Send + 'static) -> T {
    let (done, wait) = mpsc::channel();
    thread::spawn(move || done.send(run()));
    wait.recv_timeout(TIMEOUT).unwrap_or_else(|_| panic!("{what}: stuck, or panicked"))
}

#[test]
fn two_threads_give_the_bytes_of_one() {
    let shots = eventful();
    for params in all() {
        let shots = shots.clone();
        in_time_or_stuck("lossless", move || {
            let run = |threaded: bool| {
                let (mut source, stop, mut memory) = (Script::new(shots.clone()), Stop::default(), Memory::default());
                let mut sink = DigestSink::new(&source.format);
                let totals = if threaded {
                    run_threaded(&mut source, &mut sink, &params, &stop, &mut memory, Pace::Lossless).unwrap()
                } else {
                    run_inline(&mut source, &mut sink, &params, &stop, &mut memory).unwrap()
                };
                assert_eq!(memory.seen.len(), 40);
                (sink.text(), totals, memory.seen.iter().map(|seen| seen.digest).collect::<Vec<_>>())
            };
            let (one, two) = (run(false), run(true));
            assert_eq!(one, two, "{:?}", params.shutter);
            let Totals { frames_in, frames_out, damaged, dropped, .. } = one.1;
            assert_eq!((frames_in, frames_out, damaged, dropped), (40, 40, 4, 0));
        });
    }
}

/// Silent until its reader was told so twice.
struct Silent(StreamFormat, Arc<AtomicU32>, Instant);

impl FrameSource for Silent {
    fn format(&self) -> StreamFormat {
        self.0
    }

    fn lend(&mut self) -> Result<Lent<'_>, DeviceError> {
        thread::sleep(Duration::from_millis(20));
        let enough = self.1.load(Relaxed) >= 2 || self.2.elapsed() > TIMEOUT / 2;
        Ok(if enough { Lent::End } else { Lent::Idle })
    }
}

/// Counts how often it is told that there is nothing.
struct IdleCounter(NullSink, Arc<AtomicU32>);

impl FrameSink for IdleCounter {
    fn format(&self) -> StreamFormat {
        self.0.format()
    }

    fn canvas(&mut self) -> Result<PictureMut<'_>, DeviceError> {
        self.0.canvas()
    }

    fn submit(&mut self, stamp: &Stamp) -> Result<(), DeviceError> {
        self.0.submit(stamp)
    }

    fn idle(&mut self) -> Result<(), DeviceError> {
        self.1.fetch_add(1, Relaxed);
        Ok(())
    }
}

#[test]
fn a_sink_is_told_that_nothing_comes() {
    let told = Arc::<AtomicU32>::default();
    let counted = told.clone();
    in_time_or_stuck("silent", move || {
        let format = StreamFormat::tight(160, 120, PixelFormat::I420, (1, 30));
        let mut source = Silent(format, told.clone(), Instant::now());
        let mut sink = IdleCounter(NullSink::new(&format), told);
        run_threaded(&mut source, &mut sink, &Params::default(), &Stop::default(), &mut (), Pace::Live).unwrap()
    });
    assert!(counted.load(Relaxed) >= 2);
}

/// More damaged frames in a row than there are frames in the pool, behind one that waits for its successor.
#[test]
fn a_long_row_of_damaged_frames_blocks_nothing() {
    let mut shots = shaken(40);
    for shot in &mut shots[5..25] {
        *shot = shot.clone().damaged();
    }
    for params in all() {
        for pace in [Pace::Lossless, Pace::Live] {
            let shots = shots.clone();
            let what = format!("{:?}, {pace:?}", params.shutter);
            let totals = in_time_or_stuck(&what, move || {
                let mut source = Script::new(shots);
                let mut sink = NullSink::new(&source.format);
                run_threaded(&mut source, &mut sink, &params, &Stop::default(), &mut (), pace).unwrap()
            });
            assert_eq!((totals.frames_in, totals.frames_out + totals.dropped), (40, 40), "{what}: {totals:?}");
        }
    }
}

/// A sink that takes its time, and knows which frames it got.
struct Slow {
    inner: NullSink,
    takes: Duration,
    sequences: Vec<u64>,
}

impl FrameSink for Slow {
    fn format(&self) -> StreamFormat {
        self.inner.format()
    }

    fn canvas(&mut self) -> Result<PictureMut<'_>, DeviceError> {
        self.inner.canvas()
    }

    fn submit(&mut self, stamp: &Stamp) -> Result<(), DeviceError> {
        thread::sleep(self.takes);
        self.sequences.push(stamp.sequence);
        self.inner.submit(stamp)
    }
}

/// Live, a source that is faster than the rest: the stalest frames go, the newest comes through, in order.
#[test]
fn live_the_stalest_frames_are_dropped() {
    let mut shots: Vec<Shot> = shaken(10).into_iter().cycle().take(300).collect();
    in_time(&mut shots, 1000.0);
    for params in all() {
        let shots = shots.clone();
        in_time_or_stuck("live", move || {
            let mut source = Script::new(shots);
            let mut sink =
                Slow { inner: NullSink::new(&source.format), takes: Duration::from_millis(10), sequences: Vec::new() };
            let totals = run_threaded(&mut source, &mut sink, &params, &Stop::default(), &mut (), Pace::Live).unwrap();
            assert_eq!(totals.frames_in, 300);
            assert_eq!(totals.frames_in, totals.frames_out + totals.dropped, "{totals:?}");
            assert!(totals.dropped > 100, "{totals:?}");
            assert_eq!(totals.frames_out, sink.sequences.len() as u64);
            assert_eq!(totals.frames_out, totals.stabilized + totals.held + totals.passed_through);
            assert!(sink.sequences.is_sorted_by(|a, b| a < b), "out of order: {:?}", sink.sequences);
            assert_eq!(sink.sequences.last(), Some(&299), "the newest frame is the one to keep");
        });
    }
}

/// A camera without end that says nothing between its frames.
struct Endless {
    shots: Vec<Shot>,
    given: u64,
    idle: bool,
}

impl FrameSource for Endless {
    fn format(&self) -> StreamFormat {
        self.shots[0].format
    }

    fn lend(&mut self) -> Result<Lent<'_>, DeviceError> {
        self.idle = !self.idle;
        if self.idle {
            thread::sleep(Duration::from_millis(2));
            return Ok(Lent::Idle);
        }
        let Shot { format, bytes, stamp } = &self.shots[self.given as usize % self.shots.len()];
        let stamp = Stamp { sequence: self.given, time_ns: self.given as i64 * 33_333_333, ..*stamp };
        self.given += 1;
        Ok(Lent::Frame(RawFrame { format: *format, bytes, stamp }))
    }
}

#[test]
fn a_wish_to_stop_ends_it_within_a_moment() {
    let shots = shaken(10);
    for params in all() {
        for pace in [None, Some(Pace::Lossless), Some(Pace::Live)] {
            let (shots, stop) = (shots.clone(), Stop::default());
            let asked = stop.clone();
            let (totals, took) = in_time_or_stuck("stopping", move || {
                let mut source = Endless { shots, given: 0, idle: false };
                let mut sink = NullSink::new(&source.format());
                let stopper = thread::spawn(move || {
                    thread::sleep(Duration::from_millis(150));
                    asked.set();
                    Instant::now()
                });
                let totals = match pace {
                    None => run_inline(&mut source, &mut sink, &params, &stop, &mut ()),
                    Some(pace) => run_threaded(&mut source, &mut sink, &params, &stop, &mut (), pace),
                }
                .unwrap();
                (totals, stopper.join().unwrap().elapsed())
            });
            assert!(took < Duration::from_secs(2), "{pace:?}: took {took:?}");
            assert!(totals.frames_in > 0);
            assert_eq!(totals.frames_in, totals.frames_out + totals.dropped, "what was taken in is sent: {totals:?}");
        }
    }
}

fn gone(name: &str) -> DeviceError {
    DeviceError::Gone { path: PathBuf::from(name) }
}

#[test]
fn an_error_of_the_source_comes_after_the_frames_before_it() {
    let shots = shaken(12);
    for params in all() {
        for pace in [None, Some(Pace::Lossless)] {
            let shots = shots.clone();
            let (error, sent) = in_time_or_stuck("source fails", move || {
                let mut source = Script { error: Some(gone("camera")), ..Script::new(shots) };
                let mut sink = NullSink::new(&source.format);
                let ended = match pace {
                    None => run_inline(&mut source, &mut sink, &params, &Stop::default(), &mut ()),
                    Some(pace) => run_threaded(&mut source, &mut sink, &params, &Stop::default(), &mut (), pace),
                };
                (ended.unwrap_err().to_string(), sink.submitted())
            });
            assert_eq!((error, sent), (gone("camera").to_string(), 12));
        }
    }
}

/// A sink that fails with its `fails_at`th picture.
struct Failing {
    inner: NullSink,
    fails_at: u64,
}

impl FrameSink for Failing {
    fn format(&self) -> StreamFormat {
        self.inner.format()
    }

    fn canvas(&mut self) -> Result<PictureMut<'_>, DeviceError> {
        self.inner.canvas()
    }

    fn submit(&mut self, stamp: &Stamp) -> Result<(), DeviceError> {
        if self.inner.submitted() >= self.fails_at {
            return Err(gone("loopback"));
        }
        self.inner.submit(stamp)
    }
}

#[test]
fn an_error_of_the_sink_ends_it() {
    let shots = shaken(10);
    for params in all() {
        for pace in [None, Some(Pace::Lossless), Some(Pace::Live)] {
            let shots = shots.clone();
            let (error, sent, stopped) = in_time_or_stuck("sink fails", move || {
                let stop = Stop::default();
                let mut source = Endless { shots, given: 0, idle: false };
                let mut sink = Failing { inner: NullSink::new(&source.format()), fails_at: 7 };
                let ended = match pace {
                    None => run_inline(&mut source, &mut sink, &params, &stop, &mut ()),
                    Some(pace) => run_threaded(&mut source, &mut sink, &params, &stop, &mut (), pace),
                };
                (ended.unwrap_err().to_string(), sink.inner.submitted(), stop.is_set())
            });
            // the wish to stop is the caller's own: who tries again after an error must not find it set
            assert_eq!((error, sent, stopped), (gone("loopback").to_string(), 7, false));
        }
    }
}

#[test]
fn a_paced_source_gives_its_frames_when_they_are_due() {
    let params = synthetic::Params { width: 64, height: 48, fps: 50.0, frames: 6, ..synthetic::Params::default() };
    let mut source = Paced::new(Box::new(synthetic::Synthetic::new(&params).unwrap()));
    let mut first = None;
    let mut n = 0;
    while let Lent::Frame(frame) = source.lend().unwrap() {
        let first = *first.get_or_insert(frame.stamp.time_ns);
        assert_eq!(frame.stamp.time_ns - first, n * 20_000_000);
        assert!(monotonic_ns() >= frame.stamp.time_ns, "frame {n} came too early");
        n += 1;
    }
    assert_eq!(n, 6);
}
