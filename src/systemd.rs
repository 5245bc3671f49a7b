//! Notifications to systemd. Without systemd (no NOTIFY_SOCKET) they go nowhere, and nothing fails.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::time::Duration;

use sd_notify::NotifyState;

/// The connection to the service manager.
#[derive(Clone, Copy, Debug)]
pub struct Systemd {
    connected: bool,
    watchdog: Option<Duration>,
}

impl Systemd {
    /// What the environment says: NOTIFY_SOCKET, WATCHDOG_USEC, WATCHDOG_PID.
    pub fn from_env() -> Self {
        let connected = std::env::var_os("NOTIFY_SOCKET").is_some();
        Self { connected, watchdog: sd_notify::watchdog_enabled().filter(|_| connected) }
    }

    /// No service manager.
    pub fn disconnected() -> Self {
        Self { connected: false, watchdog: None }
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

    /// Whether there is a service manager.
    pub fn is_connected(&self) -> bool {
        self.connected
    }

    /// After how long without [`Systemd::alive`] the service is killed; `None` without a watchdog.
    pub fn watchdog(&self) -> Option<Duration> {
        self.watchdog
    }

    /// The service is ready.
    pub fn ready(&self) {
        self.notify(&[NotifyState::Ready]);
    }

    /// The service reloads its configuration, until [`Systemd::ready`].
    pub fn reloading(&self) {
        match NotifyState::monotonic_usec_now() {
            Ok(now) => self.notify(&[NotifyState::Reloading, now]),
            Err(error) => tracing::warn!(%error, "cannot announce the reload to the service manager: no clock"),
        }
    }

    /// The service is stopping.
    pub fn stopping(&self) {
        self.notify(&[NotifyState::Stopping, NotifyState::Status("stopping")]);
    }

    /// One line for `systemctl status`.
    pub fn status(&self, text: &str) {
        // A line end would begin another message.
        self.notify(&[NotifyState::Status(&text.replace(['\n', '\r'], " "))]);
    }

    /// Feeds the watchdog.
    pub fn alive(&self) {
        self.notify(&[NotifyState::Watchdog]);
    }

    fn notify(&self, messages: &[NotifyState<'_>]) {
        // The environment names the one socket of the process, so one warning is for all.
        static WARNED: AtomicBool = AtomicBool::new(false);
        if self.connected
            && let Err(error) = sd_notify::notify(messages)
            && !WARNED.swap(true, Relaxed)
        {
            tracing::warn!(%error, "cannot notify the service manager");
        }
    }
}
