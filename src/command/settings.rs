//! `--config` and `--set`, for every command that has settings.

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use super::{Exit, Failure};
use crate::config::Settings;

/// Most bytes of a configuration file that are read; the shipped one has about 5000.
const LARGEST: u64 = 1 << 20;

/// Where settings come from.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct SettingsArgs {
    /// Configuration file; without it, all settings have their defaults
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Override a setting of the file, e.g. smooth.cutoff_hz=0.5; may be repeated
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub set: Vec<String>,
}

impl SettingsArgs {
    /// The settings.
    ///
    /// # Errors
    /// A file that cannot be read, or every fault found in file and command line.
    pub fn read(&self) -> Result<Settings, Failure> {
        let Some(path) = &self.config else { return Ok(Settings::read(None, &self.set)?) };
        let text = text_of(path)?;
        Ok(Settings::read(Some((&path.to_string_lossy(), &text)), &self.set)?)
    }

    /// The settings, once more: what came through a pipe is gone.
    ///
    /// # Errors
    /// As [`SettingsArgs::read`].
    pub(super) fn read_again(&self) -> Result<Settings, Failure> {
        let Some(path) = &self.config else { return self.read() };
        let file = std::fs::metadata(path).map_err(|error| {
            Failure::new(Exit::NoInput, format!("{}: cannot read the configuration: {error}", path.display()))
        })?;
        if !file.is_file() {
            let what = format!("{}: not a regular file, so it cannot be reloaded", path.display());
            return Err(Failure::new(Exit::NoInput, what));
        }
        self.read()
    }
}

/// The text of a configuration file.
///
/// # Errors
/// Where it cannot be read, is too large, or is no text.
pub(super) fn text_of(path: &Path) -> Result<String, Failure> {
    let shown = path.display();
    let no_input = |error| Failure::new(Exit::NoInput, format!("{shown}: cannot read the configuration: {error}"));
    let mut bytes = Vec::new();
    File::open(path).and_then(|file| file.take(LARGEST + 1).read_to_end(&mut bytes)).map_err(no_input)?;
    if bytes.len() as u64 > LARGEST {
        let what = format!("{shown}: larger than {LARGEST} bytes; expected a TOML configuration file");
        return Err(Failure::new(Exit::Config, what));
    }
    String::from_utf8(bytes).map_err(|error| {
        let at = error.utf8_error().valid_up_to();
        Failure::new(Exit::Config, format!("{shown}: invalid UTF-8 at byte {at}; expected a TOML file saved as UTF-8"))
    })
}
