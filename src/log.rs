//! The log: lines on standard error, which systemd forwards to the journal.

use std::io::IsTerminal;
use std::sync::OnceLock;

use tracing_subscriber::filter::LevelFilter;
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;
use tracing_subscriber::{EnvFilter, Registry, fmt, reload};

use crate::config::Level;

/// The environment variable that says what is told, in place of the configured level: `debug`, or `gimbald::device=trace,warn`.
pub const VARIABLE: &str = "GIMBALD_LOG";

/// The filter that counts, once there is one.
static FILTER: OnceLock<reload::Handle<EnvFilter, Registry>> = OnceLock::new();

fn filter(level: Level) -> EnvFilter {
    let level = match level {
        Level::Error => LevelFilter::ERROR,
        Level::Warn => LevelFilter::WARN,
        Level::Info => LevelFilter::INFO,
        Level::Debug => LevelFilter::DEBUG,
        Level::Trace => LevelFilter::TRACE,
    };
    EnvFilter::builder().with_default_directive(level.into()).with_env_var(VARIABLE).from_env_lossy()
}

/// Begins to tell what is at least as important as `level`. The first call counts.
pub fn begin(level: Level) {
    let (filter, handle) = reload::Layer::new(filter(level));
    let lines = fmt::layer().with_writer(std::io::stderr).with_ansi(std::io::stderr().is_terminal()).with_target(false);
    let subscriber = tracing_subscriber::registry().with(filter);
    // The journal has its own clock.
    let journal = std::env::var_os("JOURNAL_STREAM").is_some();
    let begun = if journal { subscriber.with(lines.without_time()).try_init() } else { subscriber.with(lines).try_init() };
    if begun.is_ok() {
        let _ = FILTER.set(handle);
    }
}

/// Tells from now on what is at least as important as `level`; nothing where logging was not begun.
pub fn set(level: Level) {
    if let Some(handle) = FILTER.get() {
        // Refused only where the subscriber is gone, and then nothing is logged any more.
        let _ = handle.reload(filter(level));
    }
}
