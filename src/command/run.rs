//! `gimbald run`: the service.

use std::sync::Arc;

use signal_hook::iterator::Handle;

use super::signals::Signals;
use super::{Exit, Failure, SettingsArgs};
use crate::control::DaemonState;
use crate::rt::notifier::Notifier;
use crate::rt::stop::Stop;
use crate::systemd::Systemd;
use crate::{daemon, log};

/// Arguments of `run`.
#[derive(Clone, Debug, clap::Args)]
pub struct Args {
    /// Settings
    #[command(flatten)]
    settings: SettingsArgs,
}

/// Runs the command, until SIGTERM or Ctrl-C. SIGHUP reloads the configuration.
///
/// # Errors
/// Faults of the configuration, and what [`daemon::run`] reports.
pub fn run(args: &Args) -> Result<(), Failure> {
    let settings = args.settings.read()?;
    log::begin(settings.log.level);
    let wake = Notifier::new().map_err(|error| Failure::new(Exit::Io, format!("cannot make an event descriptor: {error}")))?;
    let again = args.settings.clone();
    let reread = Box::new(move || again.read_again().map_err(|failure| failure.message));
    let state = DaemonState::new(settings, Systemd::from_env(), reread);
    let file = args.settings.config.as_deref().and_then(|path| std::path::absolute(path).ok());
    let state = Arc::new(state.with_configuration(file.as_deref()));
    state.warn_of_retired(&state.settings());
    let stop = Stop::default();
    let mut signals = Signals::catch()?;
    let report = std::thread::scope(|scope| {
        // also where a panic ends it: the scope waits for its thread
        let _closing = CloseAtEnd(signals.handle());
        let listen = || signals.listen(&stop, &wake, || _ = state.reload_soon(true));
        let listening = std::thread::Builder::new().name("signals".into()).spawn_scoped(scope, listen);
        match listening {
            Ok(_) => daemon::run(&state, &stop, &wake).map_err(Failure::from),
            Err(error) => Err(Failure::new(Exit::Io, format!("cannot start a thread for signals: {error}"))),
        }
    })?;
    let daemon::ExitReport { frames, stabilized, cameras } = report;
    tracing::info!(frames, stabilized, cameras, "stopped");
    Ok(())
}

struct CloseAtEnd(Handle);

impl Drop for CloseAtEnd {
    fn drop(&mut self) {
        self.0.close();
    }
}
