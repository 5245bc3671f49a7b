//! Signals of the service: SIGTERM and SIGINT stop it, SIGHUP reloads its configuration.

use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::iterator::{Handle, Signals as Caught};

use super::{Exit, Failure};
use crate::rt::notifier::Notifier;
use crate::rt::stop::Stop;

/// The signals, caught.
pub(super) struct Signals(Caught);

impl Signals {
    /// Catches them from now on.
    ///
    /// # Errors
    /// Where the system refuses.
    pub(super) fn catch() -> Result<Self, Failure> {
        let caught = Caught::new([SIGHUP, SIGINT, SIGTERM]);
        caught.map(Self).map_err(|error| Failure::new(Exit::Io, format!("cannot listen for signals: {error}")))
    }

    /// What ends [`Signals::listen`].
    pub(super) fn handle(&self) -> Handle {
        self.0.handle()
    }

    /// Listens until the handle is closed. The first wish to end sets `stop` and notifies `wake`; the second ends the process.
    pub(super) fn listen(&mut self, stop: &Stop, wake: &Notifier, reload: impl Fn()) {
        for signal in self.0.forever() {
            match signal {
                SIGHUP => reload(),
                _ if stop.is_set() => std::process::exit(Exit::Interrupted.code().into()),
                _ => {
                    stop.set();
                    wake.notify();
                }
            }
        }
    }
}
