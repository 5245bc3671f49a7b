//! What the daemon tells systemd. Without systemd (no NOTIFY_SOCKET) every word goes nowhere, and nothing fails.

use std::path::PathBuf;
use std::time::Duration;

use sd_notify::NotifyState;

/// The way to the service manager.
#[derive(Clone, Copy, Debug)]
pub struct Systemd {
    listens: bool,
    watchdog: Option<Duration>,
}

impl Systemd {
    /// What the environment says: NOTIFY_SOCKET, WATCHDOG_USEC, WATCHDOG_PID.
    pub fn from_env() -> Self {
        let listens = std::env::var_os("NOTIFY_SOCKET").is_some();
        Self { listens, watchdog: sd_notify::watchdog_enabled().filter(|_| listens) }
    }

    /// A service manager that is not there.
    pub fn nobody() -> Self {
        Self { listens: false, watchdog: None }
    }

    /// Where the service may have its sockets: RUNTIME_DIRECTORY, the first where there are several; `None` where the unit has no
    /// RuntimeDirectory=.
    pub fn runtime_directory() -> Option<PathBuf> {
        let paths = std::env::var_os("RUNTIME_DIRECTORY")?;
        std::env::split_paths(&paths).find(|path| path.is_absolute())
    }

    /// Where the service may keep what it should know after a restart: STATE_DIRECTORY, the first where there are several; `None`
    /// where the unit has no StateDirectory=.
    pub fn state_directory() -> Option<PathBuf> {
        let paths = std::env::var_os("STATE_DIRECTORY")?;
        std::env::split_paths(&paths).find(|path| path.is_absolute())
    }

    /// Whether anybody listens.
    pub fn listens(&self) -> bool {
        self.listens
    }

    /// After how long without [`Systemd::alive`] the service is killed; `None` where nobody watches.
    pub fn watchdog(&self) -> Option<Duration> {
        self.watchdog
    }

    /// The service does its work.
    pub fn ready(&self) {
        self.tell(&[NotifyState::Ready]);
    }

    /// The service reads its configuration anew; [`Systemd::ready`] says that it has.
    pub fn reloading(&self) {
        match NotifyState::monotonic_usec_now() {
            Ok(now) => self.tell(&[NotifyState::Reloading, now]),
            Err(error) => tracing::warn!(%error, "cannot tell the service manager of the reload: no clock"),
        }
    }

    /// The service ends.
    pub fn stopping(&self) {
        self.tell(&[NotifyState::Stopping, NotifyState::Status("stopping")]);
    }

    /// One line for `systemctl status`.
    pub fn status(&self, text: &str) {
        // A line end would begin another message.
        self.tell(&[NotifyState::Status(&text.replace(['\n', '\r'], " "))]);
    }

    /// The watchdog is fed.
    pub fn alive(&self) {
        self.tell(&[NotifyState::Watchdog]);
    }

    fn tell(&self, words: &[NotifyState<'_>]) {
        if self.listens
            && let Err(error) = sd_notify::notify(words)
        {
            tracing::warn!(%error, "the service manager does not listen");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_systemd_nothing_happens() {
        let nobody = Systemd::nobody();
        nobody.ready();
        nobody.status("a\nb");
        nobody.alive();
        nobody.reloading();
        nobody.stopping();
    }
}
