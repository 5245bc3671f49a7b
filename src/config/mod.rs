//! Settings: one table of keys, a TOML file, and `--set KEY=VALUE` on top. Opens no files.
//!
//! A new key is one row in [`keys::KEYS`]; the file, the shipped example, `--set`, the table in docs/configuration.md and every message
//! follow from it.

mod fault;
mod key;
pub mod keys;
mod read;
mod settings;
mod shipped;

pub(crate) use fault::Faults;
pub use fault::{Fault, MAX_SHOWN, Origin};
pub use key::{Key, Kind};
pub(crate) use settings::Control;
pub use settings::{Capture, Level, Log, Output, Settings};
pub use shipped::key_table;
pub(crate) use shipped::shipped_file;
