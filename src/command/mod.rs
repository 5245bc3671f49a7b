//! What the program can be told to do: one file a command.

pub mod bench;
pub mod calibrate;
pub mod check;
pub mod demo;
pub mod devices;
mod exit;
mod interrupt;
mod place;
mod progress;
pub mod record;
pub mod replay;
pub mod run;
mod settings;
mod watch;

pub use exit::{Exit, Failure};
pub use settings::SettingsArgs;
