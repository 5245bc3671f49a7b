//! `gimbald report`: the last minute of a running daemon as one page, for a bug report.

use std::path::{Path, PathBuf};

use super::client::Target;
use super::destination::ReportFile;
use super::interrupt::stop_on_signal;
use super::print::{print, warn};
use super::progress::Progress;
use super::view::daemon_backend;
use super::{Exit, Failure};
use crate::report::{DaemonReport, EncodedPair};
use crate::rt::stop::Stop;
use crate::view::take_pictures;

/// Pictures in the page.
const PICTURES: usize = 4;
/// Their maximum width (pixels).
const WIDEST: usize = 480;

/// Arguments of `report`.
#[derive(Clone, Debug, clap::Args)]
pub struct Args {
    /// File to write; readable only by you
    #[arg(short, long, value_name = "FILE", default_value = "gimbald-report.html")]
    output: PathBuf,
    /// Also take four small pictures of input and output, one second apart; the camera is on meanwhile
    #[arg(long)]
    pictures: bool,
    /// Also include names and paths: of camera and output, and in settings
    #[arg(long)]
    names: bool,
    #[command(flatten)]
    target: Target,
}

/// Runs the command.
///
/// # Errors
/// Where no daemon answers, and where the file cannot be written.
pub fn run(args: &Args) -> Result<(), Failure> {
    let stop = stop_on_signal(None)?;
    let mut connection = args.target.connect()?;
    let file = ReportFile::create(&args.output)?;
    let pictures = match args.pictures {
        true => pictures(args, connection.path(), &stop)?,
        false => Vec::new(),
    };
    // After the pictures, so that the time in which they were taken is part of the last minute.
    let frames = connection.history()?;
    let status = connection.status()?;
    let report = DaemonReport { status: &status, frames: &frames, pictures: &pictures, with_names: args.names };
    file.fill(&report.html())?;
    let names = if args.names { "with names of devices" } else { "no names, serial numbers or paths" };
    let taken = match pictures.len() {
        0 => "no pictures".to_owned(),
        count => format!("{count} pictures"),
    };
    print(&format!("{}: {names}, {taken}\n", args.output.display()))
}

/// Takes pictures; none, with a warning, where there are none.
fn pictures(args: &Args, control: &Path, stop: &Stop) -> Result<Vec<EncodedPair>, Failure> {
    let backend = daemon_backend(&args.target, control).with_widest(WIDEST);
    let progress = Progress::new("taking pictures", Some(PICTURES as u64));
    let taken = take_pictures(&backend, PICTURES, stop, || progress.step());
    progress.finish();
    if stop.is_set() {
        return Err(Failure::new(Exit::Interrupted, format!("interrupted; {} is empty", args.output.display())));
    }
    taken.or_else(|problem| {
        warn(&format!("{problem}; the report has no pictures"));
        Ok(Vec::new())
    })
}
