//! Live, in a camera's own time: what the two threads of the service take of the processor, beside the sum of the stages.

#[path = "../../tests/common/paced.rs"]
mod source;

use std::time::Duration;

use gimbald::device::rehearsal::{Rehearsal, RehearsalSink};
use gimbald::device::synthetic;
use gimbald::device::{DeviceError, FrameSource, Lent, RawFrame, StreamFormat};
use gimbald::frame::{Frame, Stage};
use gimbald::image::{PictureRef, PixelFormat};
use gimbald::pipeline::{Observer, Pace, Params, run_threaded};
use gimbald::rt::stop::Stop;
use rustix::time::{ClockId, clock_gettime};
use serde_json::json;

use crate::Record;
use source::Paced;

/// Sizes and rates.
const CASES: [([u32; 2], f64); 4] = [([1280, 720], 30.0), ([1280, 720], 60.0), ([1920, 1080], 30.0), ([3840, 2160], 30.0)];
/// Frames made beforehand, as many as this many bytes hold, and at most so many; they are shown to and fro.
const MADE_BYTES: usize = 170_000_000;
const MADE: usize = 40;
/// Time that a case takes, seconds.
const SECONDS: f64 = 5.0;

/// Frames made beforehand, so that making them costs nothing while the clock runs.
struct Reel {
    format: StreamFormat,
    made: Vec<Vec<u8>>,
    next: u64,
    frames: u64,
}

impl Reel {
    fn new(size: [u32; 2], fps: f64, frames: u64) -> Option<Self> {
        let [width, height] = size;
        let made = (MADE_BYTES / (2 * width as usize * height as usize)).clamp(2, MADE);
        let params = synthetic::Params { width, height, fps, frames: made as u64, ..synthetic::Params::default() };
        let mut camera = Rehearsal::new(&params, PixelFormat::Yuyv).ok()?;
        let format = camera.format();
        let mut made = Vec::new();
        while let Ok(Lent::Frame(frame)) = camera.lend() {
            made.push(frame.bytes.to_vec());
        }
        (made.len() > 1).then_some(Self { format, made, next: 0, frames })
    }
}

impl FrameSource for Reel {
    fn format(&self) -> StreamFormat {
        self.format
    }

    fn lend(&mut self) -> Result<Lent<'_>, DeviceError> {
        if self.next == self.frames {
            return Ok(Lent::End);
        }
        let last = self.made.len() - 1;
        let (turn, place) = (self.next as usize / last, self.next as usize % last);
        let bytes = &self.made[if turn % 2 == 0 { place } else { last - place }];
        let stamp = gimbald::frame::Stamp {
            time_ns: self.format.nominal_time_ns(self.next),
            sequence: self.next,
            ..Default::default()
        };
        self.next += 1;
        Ok(Lent::Frame(RawFrame { format: self.format, bytes, stamp }))
    }
}

/// Sums of the stages' times.
#[derive(Default)]
struct Sum {
    spent_ns: u64,
    frames: u64,
}

impl Observer for Sum {
    fn drawn(&mut self, _: &Frame, _: PictureRef<'_>) {}

    fn sent(&mut self, frame: &Frame) {
        self.frames += 1;
        self.spent_ns += Stage::ALL.iter().map(|stage| frame.context.spent_ns[*stage as usize]).sum::<u64>();
    }
}

/// Time of all threads of this process on a processor.
fn process() -> Duration {
    let now = clock_gettime(ClockId::ProcessCPUTime);
    Duration::new(now.tv_sec as u64, now.tv_nsec as u32)
}

/// Measures what is asked for.
pub fn measure(record: &mut Record) {
    for (size, fps) in CASES {
        let name = format!("paced {}x{} at {fps}", size[0], size[1]);
        if !record.measuring || !record.wants(&name) {
            continue;
        }
        let Some(reel) = Reel::new(size, fps, (SECONDS * fps) as u64) else { continue };
        let mut sink = RehearsalSink::new(&reel.format(), PixelFormat::Yuyv);
        let (mut source, mut sum) = (Paced::new(Box::new(reel)), Sum::default());
        let before = process();
        let ran = run_threaded(&mut source, &mut sink, &Params::default(), &Stop::default(), &mut sum, Pace::Live);
        let spent = process() - before;
        let Ok(totals) = ran else { continue };
        let each = |total_ms: f64| total_ms / sum.frames.max(1) as f64;
        let (cpu, stages) = (each(spent.as_secs_f64() * 1e3), each(sum.spent_ns as f64 * 1e-6));
        record.say(&format!(
            "{name}: {cpu:.3} ms of processor time a frame ({:.1} % of a core), the stages {stages:.3} ms; {} sent, {} dropped",
            0.1 * cpu * fps,
            totals.frames_out,
            totals.dropped
        ));
        let values = json!({ "processor_ms": cpu, "stages_ms": stages, "sent": totals.frames_out, "dropped": totals.dropped });
        record.values.insert(name, values);
    }
}
