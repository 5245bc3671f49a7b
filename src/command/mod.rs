//! The commands of the program, one file each.

mod arguments;
pub mod bench;
pub mod calibrate;
pub mod check;
pub mod client;
pub mod demo;
mod destination;
pub mod devices;
pub mod doctor;
mod exit;
mod interrupt;
pub mod measure;
pub mod pipewire;
mod print;
mod progress;
pub mod record;
pub mod replay;
pub mod report;
pub mod run;
mod settings;
mod signals;
pub mod view;
mod watch;

pub use arguments::{Arguments, Command};
pub use exit::{Exit, Failure};
pub(crate) use settings::SettingsArgs;
