//! What the program can be told to do: one file a command.

mod arguments;
pub mod bench;
pub mod calibrate;
pub mod check;
pub mod demo;
pub mod devices;
pub mod doctor;
mod exit;
mod interrupt;
pub mod pipewire;
mod place;
mod progress;
pub mod record;
pub mod replay;
pub mod run;
mod say;
mod settings;
mod signals;
pub mod talk;
mod watch;

pub use arguments::{Arguments, Command};
pub use exit::{Exit, Failure};
pub use settings::SettingsArgs;
