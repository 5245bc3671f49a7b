//! `gimbald bench`: processing time per frame on this machine, stage by stage, and the frame rates that it can sustain.

mod copies;
mod measure;

use std::io::{self, Write};
use std::path::Path;
use std::time::{Duration, Instant};

use serde_json::{Value, json};

use super::interrupt::stop_on_signal;
use super::{Exit, Failure, SettingsArgs};
use crate::frame::Stage;
use crate::image::PixelFormat;
use crate::kernel::Level;

pub use copies::{Copies, CopyTimes};
pub use measure::{Measured, measure};

/// Arguments of `bench`.
#[derive(Clone, Debug, clap::Args)]
pub struct Args {
    /// Settings of the stabilization
    #[command(flatten)]
    settings: SettingsArgs,
    /// Maximum duration in seconds (1 to 600)
    #[arg(long, value_name = "S", default_value_t = 10.0, value_parser = seconds)]
    seconds: f64,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

fn seconds(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| "expected a number of seconds".to_string())?;
    if (1.0..=600.0).contains(&value) { Ok(value) } else { Err("expected 1 to 600 seconds".into()) }
}

/// What webcams give, the most usual first.
const CASES: [([u32; 2], PixelFormat); 6] = [
    ([1280, 720], PixelFormat::Mjpeg),
    ([1920, 1080], PixelFormat::Mjpeg),
    ([640, 480], PixelFormat::Yuyv),
    ([1280, 720], PixelFormat::Yuyv),
    ([1920, 1080], PixelFormat::Yuyv),
    ([1920, 1080], PixelFormat::Nv12),
];
/// Frames that a case is measured over, at most.
const FRAMES: u64 = 300;

/// Runs the command.
///
/// # Errors
/// Faults of the configuration, and standard output that cannot be written.
pub fn run(args: &Args) -> Result<(), Failure> {
    let settings = args.settings.read()?;
    let stop = stop_on_signal(None)?;
    let started = Instant::now();
    let mut done = Vec::new();
    for (index, (size, pixel)) in CASES.into_iter().enumerate() {
        let left = Duration::from_secs_f64(args.seconds).saturating_sub(started.elapsed());
        let share = left / (CASES.len() - index) as u32;
        let measured = measure(&settings.pipeline, size, pixel, FRAMES, Some(share), &stop)?;
        if stop.is_set() {
            return Err(Failure::new(Exit::Interrupted, "interrupted before everything was measured".to_string()));
        }
        done.push(measured);
    }
    let mut out = io::stdout().lock();
    let written = if args.json { writeln!(out, "{:#}", json(&done)) } else { table(&mut out, &done) };
    written.map_err(|error| Failure::writing(Path::new("standard output"), &error))
}

/// Frame rates that are asked of cameras.
const RATES: [f64; 3] = [30.0, 60.0, 120.0];

/// Writes the results as a table for the eye: milliseconds of one core a frame, medians.
///
/// # Errors
/// What `out` says.
pub fn table(out: &mut dyn Write, done: &[Measured]) -> io::Result<()> {
    write!(out, "{:<15}", "input")?;
    for stage in Stage::ALL {
        write!(out, "{:>8}", stage.name())?;
    }
    writeln!(out, "{:>9}{:>8}{:>9}{:>9}  share of one core", "frame ms", "p99", "x memory", "x cache")?;
    for measured in done {
        let Measured { size: [width, height], pixel, stats, .. } = measured;
        write!(out, "{:<15}", format!("{width}x{height} {pixel}"))?;
        for stage in Stage::ALL {
            write!(out, "{:>8.3}", stats.stage(stage).median_ms)?;
        }
        let total = stats.total();
        let [cache, memory] = measured.copies();
        write!(out, "{:>9.3}{:>8.3}{memory:>9.1}{cache:>9.1} ", total.median_ms, total.p99_ms)?;
        for rate in RATES {
            let share = 1e-3 * rate * total.median_ms;
            if share <= 1.0 {
                write!(out, " {:.0} % at {rate}", 100.0 * share)?;
            } else {
                write!(out, " no {rate}")?;
            }
        }
        writeln!(out, ", holds {:.0}", (1e3 / total.p99_ms.max(1e-3)).floor())?;
    }
    for measured in done {
        let [frame_cache, frame_memory] = measured.copies();
        let [warp_cache, warp_memory] = measured.warp_copies();
        let Measured { size: [width, height], pixel, copy, .. } = measured;
        writeln!(
            out,
            "{:<15}copy through memory {:.3} ms: frame {frame_memory:.1} x, warp {warp_memory:.1} x; in cache {:.3} ms: frame \
             {frame_cache:.1} x, warp {warp_cache:.1} x",
            format!("{width}x{height} {pixel}"),
            1e-6 * copy.memory_ns as f64,
            1e-6 * copy.cache_ns as f64
        )?;
    }
    writeln!(out, "SIMD level: {}", Level::detected().name())?;
    writeln!(
        out,
        "x memory: time of the frame, without decoding, relative to a plain copy of its 4:2:0 picture from memory to memory (ring buffers \
         larger than the cache, like the frames of a camera); x cache: relative to a copy between the same two buffers. holds: \
         sustainable frame rate (from p99)."
    )
}

/// The results of several cases as JSON.
pub fn json(done: &[Measured]) -> Value {
    let cases = done.iter().map(Measured::json).collect::<Vec<_>>();
    json!({ "version": env!("CARGO_PKG_VERSION"), "simd": Level::detected().name(), "cases": cases })
}
