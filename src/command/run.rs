//! `gimbald run`: the service.

use super::interrupt::stop_on_signal;
use super::{Exit, Failure, SettingsArgs};
use crate::rt::wake::Wake;
use crate::{daemon, log};

/// Arguments of `run`.
#[derive(Clone, Debug, clap::Args)]
pub struct Args {
    /// What to do, with which devices
    #[command(flatten)]
    settings: SettingsArgs,
}

/// Runs the command, until SIGTERM or Ctrl-C.
///
/// # Errors
/// Faults of the configuration, and what [`daemon::run`] reports.
pub fn run(args: &Args) -> Result<(), Failure> {
    let settings = args.settings.read()?;
    log::begin(settings.log.level);
    let wake = Wake::new().map_err(|error| Failure::new(Exit::Io, format!("cannot make an event descriptor: {error}")))?;
    let stop = stop_on_signal(Some(wake.clone()))?;
    let report = daemon::run(&settings, &stop, &wake)?;
    let daemon::ExitReport { frames, stabilized, cameras } = report;
    tracing::info!(frames, stabilized, cameras, "ended as asked");
    Ok(())
}
