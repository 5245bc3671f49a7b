//! One case of the benchmark: frames of one size and format through the pipeline, on the calling thread.

use std::time::{Duration, Instant};

use serde_json::{Value, json};

use super::copies::{Copies, CopyTimes};
use super::{Exit, Failure};
use crate::device::FrameSource;
use crate::device::rehearsal::{Rehearsal, RehearsalSink};
use crate::device::synthetic;
use crate::frame::{Frame, Stage};
use crate::image::{PictureRef, PixelFormat};
use crate::pipeline::{Observer, Params, Totals, run_inline};
use crate::report::{Histogram, Stats};
use crate::rt::stop::Stop;

/// Frames that are not counted: memory is taken, the model finds the camera out.
const WARM: u64 = 30;

/// What was measured.
#[derive(Debug)]
pub struct Measured {
    /// Width and height.
    pub size: [u32; 2],
    /// What the camera gave.
    pub pixel: PixelFormat,
    /// Times of the stages.
    pub stats: Stats,
    /// Times of the frames; of compressed ones without unpacking, which is decoding.
    pub carried: Histogram,
    /// What became of all frames.
    pub totals: Totals,
    /// Plain copies of the 4:2:0 picture in the same run.
    pub copy: CopyTimes,
}

impl Measured {
    /// A frame without decoding in copies of its picture: in cache, and through memory (medians).
    pub fn copies(&self) -> [f64; 2] {
        self.in_copies(self.carried.quantile(0.5) as f64)
    }

    /// The warp of all planes, likewise.
    pub fn warp_copies(&self) -> [f64; 2] {
        self.in_copies(1e6 * self.stats.stage(Stage::Warp).median_ms)
    }

    fn in_copies(&self, ns: f64) -> [f64; 2] {
        [self.copy.cache_ns, self.copy.memory_ns].map(|copy_ns| ns / copy_ns.max(1) as f64)
    }

    /// Everything as JSON, times in milliseconds.
    pub fn json(&self) -> Value {
        let ms = |ns: u64| ns as f64 * 1e-6;
        let (frame, warp) = (self.copies(), self.warp_copies());
        json!({
            "width": self.size[0],
            "height": self.size[1],
            "input": self.pixel.to_string(),
            "output": OUTPUT.to_string(),
            "copy_in_cache_ms": ms(self.copy.cache_ns),
            "copy_through_memory_ms": ms(self.copy.memory_ns),
            "warp_copies": { "in_cache": warp[0], "through_memory": warp[1] },
            "without_decoding": {
                "median_ms": ms(self.carried.quantile(0.5)),
                "p99_ms": ms(self.carried.quantile(0.99)),
                "max_ms": ms(self.carried.max()),
                "copies": { "in_cache": frame[0], "through_memory": frame[1] },
            },
            "times": self.stats.json(&self.totals),
        })
    }
}

/// What leaves: the format that every call app takes.
const OUTPUT: PixelFormat = PixelFormat::Yuyv;

struct Watching {
    stats: Stats,
    carried: Histogram,
    decodes: bool,
    seen: u64,
    until: Option<Instant>,
    stop: Stop,
}

impl Observer for Watching {
    fn drawn(&mut self, _: &Frame, _: PictureRef<'_>) {}

    fn sent(&mut self, frame: &Frame) {
        self.seen += 1;
        if self.seen > WARM {
            self.stats.sent(frame);
            let spent = &frame.context.spent_ns;
            let decoding = if self.decodes { spent[Stage::Unpack as usize] } else { 0 };
            self.carried.add(spent.iter().sum::<u64>() - decoding);
        }
        if self.seen > WARM + 2 && self.until.is_some_and(|until| Instant::now() >= until) {
            self.stop.set();
        }
    }
}

/// Measures `frames` frames, or as many as there is time for (`most`; it counts what making the frames takes too).
///
/// # Errors
/// Where the synthetic camera cannot be made so.
pub fn measure(
    params: &Params,
    size: [u32; 2],
    pixel: PixelFormat,
    frames: u64,
    most: Option<Duration>,
    stop: &Stop,
) -> Result<Measured, Failure> {
    let until = most.map(|most| Instant::now() + most);
    let camera = synthetic::Params { width: size[0], height: size[1], frames: WARM + frames, ..synthetic::Params::default() };
    let mut source = Rehearsal::new(&camera, pixel).map_err(|what| Failure::new(Exit::Usage, what))?;
    let mut sink = RehearsalSink::new(&source.format(), OUTPUT);
    // its own: what ends this case early does not end the whole
    let over = Stop::default();
    let (stats, carried) = (Stats::default(), Histogram::default());
    let mut watching = Watching { stats, carried, decodes: pixel.is_compressed(), seen: 0, until, stop: over.clone() };
    let (width, height) = (size[0] as usize, size[1] as usize);
    let mut copies = Copies::new(width * height + 2 * width.div_ceil(2) * height.div_ceil(2));
    let mut until = Until { source: &mut source, stop, copies: &mut copies };
    let totals = run_inline(&mut until, &mut sink, params, &over, &mut watching)?;
    let Watching { stats, carried, .. } = watching;
    Ok(Measured { size, pixel, stats, carried, totals, copy: copies.times() })
}

/// A source that ends when the user says so, and takes the times of copies before each frame.
struct Until<'a> {
    source: &'a mut Rehearsal,
    stop: &'a Stop,
    copies: &'a mut Copies,
}

impl FrameSource for Until<'_> {
    fn format(&self) -> crate::device::StreamFormat {
        self.source.format()
    }

    fn lend(&mut self) -> Result<crate::device::Lent<'_>, crate::device::DeviceError> {
        if self.stop.is_set() {
            return Ok(crate::device::Lent::End);
        }
        self.copies.measure();
        self.source.lend()
    }
}
