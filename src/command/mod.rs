//! What the program can be told to do: one file a command.

mod exit;
mod interrupt;
mod place;
mod progress;
pub mod replay;
mod settings;
mod watch;

pub use exit::{Exit, Failure};
pub use settings::SettingsArgs;
