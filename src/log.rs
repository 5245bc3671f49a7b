//! What is told while the program runs: lines on standard error, which systemd carries to the journal.

use std::io::IsTerminal;

use tracing_subscriber::EnvFilter;
use tracing_subscriber::filter::LevelFilter;

use crate::config::Level;

/// The environment variable that says what is told, in place of the configured level: `debug`, or `gimbald::device=trace,warn`.
pub const VARIABLE: &str = "GIMBALD_LOG";

/// Begins to tell what is at least as important as `level`. The first call counts.
pub fn begin(level: Level) {
    let level = match level {
        Level::Error => LevelFilter::ERROR,
        Level::Warn => LevelFilter::WARN,
        Level::Info => LevelFilter::INFO,
        Level::Debug => LevelFilter::DEBUG,
        Level::Trace => LevelFilter::TRACE,
    };
    let filter = EnvFilter::builder().with_default_directive(level.into()).with_env_var(VARIABLE).from_env_lossy();
    let lines = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal())
        .with_target(false);
    // The journal has its own clock.
    let journal = std::env::var_os("JOURNAL_STREAM").is_some();
    let _ = if journal { lines.without_time().try_init() } else { lines.try_init() };
}
