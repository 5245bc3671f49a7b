//! Ctrl-C in commands that end by themselves: the first asks the command to stop, the second ends it at once.

use super::{Exit, Failure};
use crate::rt::notifier::Notifier;
use crate::rt::stop::Stop;

/// A [`Stop`] that Ctrl-C (or SIGTERM) sets. A second signal ends the process: the first may not be seen by a read that waits
/// for a pipe. Where a device is waited for, `wake` ends the waiting.
///
/// # Errors
/// Where the system refuses the handler.
pub(super) fn stop_on_signal(wake: Option<Notifier>) -> Result<Stop, Failure> {
    let stop = Stop::default();
    let seen = stop.clone();
    let handler = move || {
        if seen.is_set() {
            std::process::exit(Exit::Interrupted.code().into());
        }
        seen.set();
        wake.iter().for_each(Notifier::notify);
    };
    ctrlc::set_handler(handler).map_err(|error| Failure::new(Exit::Io, format!("cannot listen for Ctrl-C: {error}")))?;
    Ok(stop)
}
