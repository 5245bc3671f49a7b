//! `gimbald replay`: stabilizes a recording or a video file.

use std::path::{Path, PathBuf};

use super::destination::{Making, RECORDING, ReportFile, all_differ, open_sink};
use super::interrupt::stop_on_signal;
use super::print::warn;
use super::watch::Watch;
use super::{Exit, Failure, SettingsArgs};
use crate::device::null::NullSink;
use crate::device::video::ffmpeg::Turn;
use crate::device::video::{Container, ENDINGS};
use crate::device::{FrameSink, replay};
use crate::pipeline::{Totals, run_inline};
use crate::report::{Compare, Report, compare_format};

/// Arguments of `replay`.
#[derive(Clone, Debug, clap::Args)]
pub struct Args {
    /// Input: a video file (read with ffmpeg), a y4m file, a recording (.gbr), or - for y4m or a recording on
    /// standard input
    #[arg(value_name = "IN")]
    input: PathBuf,
    /// Output: a video file (.mp4, .mov, .mkv, .webm need ffmpeg, which also copies the sound; .avi does not),
    /// a .y4m file, a recording (.gbr), - for y4m on standard output, digest: for one line per frame on standard
    /// output, null: for none
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    /// ffmpeg encoder for video files, e.g. libx265; default: the usual one of each format
    #[arg(long, value_name = "NAME")]
    codec: Option<String>,
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

    if args.codec.is_some() && !outputs.iter().any(|path| Container::of(path).is_some()) {
        let what = format!("--codec is for video files; end the name of an output in {ENDINGS}");
        return Err(Failure::new(Exit::Usage, what));
    }
    let (mut source, origin) = replay::open_with_origin(&args.input)?;
    let format = source.format();
    let making = Making { codec: args.codec.as_deref(), origin: origin.as_ref() };
    let stop = stop_on_signal(None)?;
    let (mut sink, compare): (Box<dyn FrameSink>, _) = match &args.compare {
        None => (open_sink(&args.output, &format, making)?, None),
        Some(None) => (Box::new(NullSink::new(&format)), Some(open_sink(&args.output, &compare_format(&format), making)?)),
        Some(Some(path)) => {
            (open_sink(&args.output, &format, making)?, Some(open_sink(path, &compare_format(&format), making)?))
        }
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
    if let Some(complaint) = source.complaint() {
        warn(&format!("{}: {complaint}", args.input.display()));
    }
    if let Some(origin) = origin.filter(|origin| origin.turn != Turn::None)
        && outputs.iter().any(|path| is_unturned(path))
    {
        warn(&format!(
            "{}: the video is marked as rotated, which y4m and .gbr cannot store; write to a video file to keep it upright",
            origin.path.display()
        ));
    }
    check_totals(&args.input, &args.output, &totals)
}

/// Whether pictures are written there as the camera's sensor read them, although they are to be shown turned.
fn is_unturned(output: &Path) -> bool {
    output.as_os_str() == "-" || output.extension().is_some_and(|extension| extension == "y4m" || extension == RECORDING)
}

/// Says what could not be shown.
///
/// # Errors
/// Where that is all of it.
fn check_totals(input: &Path, output: &Path, totals: &Totals) -> Result<(), Failure> {
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
