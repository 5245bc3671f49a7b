//! One page that shows what a run did: a player of before and after, motion, path, times, settings. It is one file that needs no
//! network, and stays below [`MAX_BYTES`] for ordinary runs: the player gets what the rest leaves.

mod clip;
mod daemon;
mod inside;
mod page;
mod paper;
mod picture;
mod plot;
mod sections;
mod stills;
mod svg;

use super::Stats;
use super::names::MotionNames;
use crate::config::Settings;
use crate::device::StreamFormat;
use crate::frame::{Frame, Outcome, PathParameters};
use crate::geometry::{Calibration, PerChannel};
use crate::image::PictureRef;
use crate::pipeline::{Observer, Totals};

use clip::Clip;
use inside::Inside;
use stills::Stills;

pub use daemon::DaemonReport;
pub use paper::{Both, Paper};

/// Bytes of a page, at most, unless plots and still pictures alone need more.
pub const MAX_BYTES: usize = 3_000_000;

/// Gathers a run for its page. Memory grows by some 300 bytes a frame, pictures excepted, which are bounded.
#[derive(Debug)]
pub struct Report {
    settings: Settings,
    format: StreamFormat,
    input: String,
    journal: Journal,
    stills: Stills,
    clip: Clip,
    inside: Inside,
}

/// The frames of a run, oldest first, and how their parameters are to be read.
#[derive(Debug)]
struct Journal {
    names: &'static MotionNames,
    samples: Vec<Sample>,
}

/// What the page shows of a frame.
#[derive(Clone, Copy, Debug)]
struct Sample {
    time_ns: i64,
    /// Time after the frame before, seconds; 0 for a stream's first.
    interval_s: f64,
    outcome: Outcome,
    /// Motion of the camera since the frame before, and what is left of it in the output; not finite where unknown.
    motion: PathParameters,
    steadied: PathParameters,
    path: PathParameters,
    smoothed: PathParameters,
    /// Motion of the last row against the first, x and y, pixels.
    sheared: [f64; 2],
    calibration: Option<Calibration>,
    tracks: u32,
    inliers: u32,
    confidence: f64,
    trust: f64,
    crop_use: f64,
    crop_shares: PerChannel,
    spent_ms: f64,
}

impl Report {
    /// A report of a run with `settings` on frames of `format` from `input`.
    pub fn new(settings: &Settings, format: &StreamFormat, input: &str) -> Self {
        Self {
            settings: settings.clone(),
            format: *format,
            input: input.to_owned(),
            journal: Journal { names: MotionNames::of(settings.pipeline.shutter.model), samples: Vec::new() },
            stills: Stills::new(),
            clip: Clip::new(),
            inside: Inside::default(),
        }
    }

    /// The page, with the run's totals and times.
    pub fn html(&self, totals: &Totals, stats: &Stats) -> String {
        page::html(self, totals, stats)
    }

    /// What `frame` says, and what the frame before it lets it say.
    fn sample(&self, frame: &Frame) -> Sample {
        let context = &frame.context;
        let unknown = PathParameters([f64::NAN; 4]);
        // A picture shown again moved nothing and measured nothing.
        let held = matches!(context.outcome, Outcome::Held(_));
        let (motion, path, smoothed) =
            if held { (unknown, unknown, unknown) } else { (context.motion, context.path, context.smoothed) };
        let before = self.journal.samples.iter().rev().find(|sample| !matches!(sample.outcome, Outcome::Held(_)));
        let steadied = match before {
            Some(before) if !held => self.journal.names.steadied([before.path, path], [before.smoothed, smoothed]),
            _ => unknown,
        };
        Sample {
            time_ns: frame.stamp.time_ns,
            interval_s: context.interval_s,
            outcome: context.outcome,
            motion: if before.is_some() { motion } else { unknown },
            steadied,
            path,
            smoothed,
            sheared: if held { [f64::NAN; 2] } else { inside::sheared(frame) },
            calibration: context.calibration,
            tracks: context.fit.tracks,
            inliers: context.fit.inliers,
            confidence: context.confidence,
            trust: context.trust,
            crop_use: context.crop_use,
            crop_shares: context.crop_shares,
            spent_ms: 0.0,
        }
    }
}

impl Observer for Report {
    fn drawn(&mut self, frame: &Frame, output: PictureRef<'_>) {
        let sample = self.sample(frame);
        // How much the motion itself changed: what makes a picture shake, whatever the model's units.
        let shake = match self.journal.samples.last() {
            Some(before) => (0..self.journal.names.axes.len()).map(|i| (sample.motion[i] - before.motion[i]).powi(2)).sum(),
            None => 0.0,
        };
        self.stills.add(frame, output, shake);
        self.clip.add(frame, output, shake);
        self.inside.add(frame);
        self.journal.samples.push(sample);
    }

    fn sent(&mut self, frame: &Frame) {
        if let Some(last) = self.journal.samples.last_mut() {
            last.spent_ms = frame.context.spent_ns.iter().sum::<u64>() as f64 / 1e6;
        }
    }
}
