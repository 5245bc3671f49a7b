//! `gimbald replay`: stabilizes a recorded stream into a file.

use std::path::{Path, PathBuf};

use super::interrupt::stop_on_signal;
use super::place::{ReportFile, all_differ, open_sink};
use super::print::warn;
use super::watch::Watch;
use super::{Exit, Failure, SettingsArgs};
use crate::device::null::NullSink;
use crate::device::{FrameSink, replay};
use crate::pipeline::{Totals, run_inline};
use crate::report::{Compare, Report, compare_format};

/// Arguments of `replay`.
#[derive(Clone, Debug, clap::Args)]
pub struct Args {
    /// Input: a y4m file, a recording (.gbr), or - for standard input
    #[arg(value_name = "IN")]
    input: PathBuf,
    /// Output: a .y4m file, a recording (.gbr), - for y4m on standard output,
    /// digest: for one line per frame on standard output, null: for none
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    /// Settings of the camera and the stabilization
    #[command(flatten)]
    settings: SettingsArgs,
    /// Write one line per frame as CSV: time, homography, motion, path, inliers, confidence, outcome
    #[arg(long, value_name = "F.csv")]
    trace: Option<PathBuf>,
    /// Write statistics as JSON: processing times per stage (count, median, p99, maximum in ms) and frame counts
    #[arg(long, value_name = "F.json")]
    stats: Option<PathBuf>,
    /// Write an HTML report with plots and pictures, before and after
    #[arg(long, value_name = "F.html")]
    report: Option<PathBuf>,
    /// Write input and output side by side, to OUT, or with --compare=FILE to another file
    #[arg(long, value_name = "FILE", num_args = 0..=1, require_equals = true)]
    compare: Option<Option<PathBuf>>,
}

/// Runs the command.
///
/// # Errors
/// Whatever keeps the whole stream from being stabilized and written.
pub fn run(args: &Args) -> Result<(), Failure> {
    let settings = args.settings.read()?;
    let compare = args.compare.as_ref().and_then(Option::as_ref);
    let reports = [&args.trace, &args.stats, &args.report].into_iter().flatten().chain(compare);
    let outputs: Vec<&Path> = reports.chain([&args.output]).map(PathBuf::as_path).collect();
    all_differ(&args.input, &outputs)?;

    let mut source = replay::open(&args.input)?;
    let format = source.format();
    let stop = stop_on_signal(None)?;
    let (mut sink, compare): (Box<dyn FrameSink>, _) = match &args.compare {
        None => (open_sink(&args.output, &format)?, None),
        Some(None) => (Box::new(NullSink::new(&format)), Some(open_sink(&args.output, &compare_format(&format))?)),
        Some(Some(path)) => (open_sink(&args.output, &format)?, Some(open_sink(path, &compare_format(&format))?)),
    };
    let mut watch = Watch::new("stabilizing", source.frames(), stop.clone());
    watch.compare = compare.map(|sink| Compare::new(sink, stop.clone()));
    if let Some(path) = &args.trace {
        watch.trace_to(path, settings.pipeline.shutter.model)?;
    }
    if let Some(path) = &args.stats {
        watch.stats_file = Some(ReportFile::create(path)?);
    }
    if let Some(path) = &args.report {
        let report = Report::new(&settings, &format, &args.input.to_string_lossy());
        watch.report = Some((report, ReportFile::create(path)?));
    }
    let ran = run_inline(source.as_mut(), sink.as_mut(), &settings.pipeline, &stop, &mut watch);
    let totals = watch.end(ran)?;
    if stop.is_set() {
        let what = format!("interrupted after {} frames; the output contains these", totals.frames_out);
        return Err(Failure::new(Exit::Interrupted, what));
    }
    judged(&args.input, &args.output, &totals)
}

/// Says what could not be shown.
///
/// # Errors
/// Where that is all of it.
fn judged(input: &Path, output: &Path, totals: &Totals) -> Result<(), Failure> {
    let input = input.display();
    if totals.cut > 0 {
        let (cut, all) = (totals.cut, totals.frames_in);
        warn(&format!("{input}: {cut} of {all} frames are cut off; the missing parts show the previous picture"));
    }
    let Some(why) = totals.unusable.in_words(totals.frames_in) else { return Ok(()) };
    if totals.damaged < totals.frames_in {
        warn(&format!("{input}: {why}; the previous picture was repeated for each"));
        return Ok(());
    }
    let what = format!("{input}: {why}; {} contains only black pictures", output.display());
    Err(Failure::new(Exit::BadData, what))
}
