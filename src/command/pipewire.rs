//! `gimbald pipewire`: the companion in the user's session.

use super::interrupt;
use super::{Exit, Failure};
use crate::config::Level;
use crate::rt::notifier::Notifier;
use crate::{companion, log};

/// Arguments of `pipewire`.
#[derive(Clone, Debug, clap::Args)]
pub struct Args {
    /// Log debug messages
    #[arg(long)]
    debug: bool,
}

/// Runs the command, until SIGTERM or Ctrl-C.
///
/// # Errors
/// Where PipeWire's library is not installed.
pub fn run(args: &Args) -> Result<(), Failure> {
    log::begin(if args.debug { Level::Debug } else { Level::Info });
    let wake = Notifier::new().map_err(|error| Failure::new(Exit::Io, format!("cannot make an event descriptor: {error}")))?;
    let stop = interrupt::stop_on_signal(Some(wake.clone()))?;
    companion::run(&stop, &wake).map_err(|missing| Failure::new(Exit::Unavailable, missing.to_string()))
}
