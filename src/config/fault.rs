//! Errors in the user's settings: what is wrong, where, and how to fix it.

use std::fmt;

/// Where a setting was written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Origin {
    /// A configuration file, by name and line (from 1).
    File {
        /// Name as the user gave it.
        name: String,
        /// Line, counted from 1.
        line: usize,
    },
    /// The command line.
    Set,
}

impl fmt::Display for Origin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::File { name, line } => write!(f, "{name}:{line}"),
            Self::Set => f.write_str("--set"),
        }
    }
}

/// One fault.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Fault {
    /// Where.
    pub origin: Origin,
    /// The setting as it was written, `key = value`; empty where there is none.
    pub setting: String,
    /// What is wrong and what was expected.
    pub what: String,
    /// What to do.
    pub advice: String,
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.origin, self.bare())
    }
}

impl Fault {
    /// The fault without its place.
    pub fn bare(&self) -> String {
        let Self { setting, what, advice, .. } = self;
        if setting.is_empty() { format!("{what}; {advice}") } else { format!("{setting}: {what}; {advice}") }
    }
}

/// Faults that are described; of all beyond them there is only a count.
pub const MAX_SHOWN: usize = 50;

/// What is wrong with settings, in the order in which they were written; never empty once it is an error.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Faults {
    /// The first [`MAX_SHOWN`].
    pub shown: Vec<Fault>,
    /// How many there are besides.
    pub more: usize,
}

impl Faults {
    /// Adds a fault. Describing one takes time, so `describe` is asked only where it will be shown.
    pub(super) fn add(&mut self, describe: impl FnOnce() -> Fault) {
        if self.shown.len() < MAX_SHOWN {
            self.shown.push(describe());
        } else {
            self.more += 1;
        }
    }

    /// `settings`, or what is wrong with them.
    pub(super) fn or<T>(self, settings: T) -> Result<T, Self> {
        if self.shown.is_empty() { Ok(settings) } else { Err(self) }
    }
}

impl fmt::Display for Faults {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let count = self.shown.len() + self.more;
        write!(f, "{count} {} in the configuration", if count == 1 { "error" } else { "errors" })?;
        if self.more > 0 {
            write!(f, ", showing the first {}", self.shown.len())?;
        }
        f.write_str(":")?;
        self.shown.iter().try_for_each(|fault| write!(f, "\n  {fault}"))?;
        if self.more > 0 {
            write!(f, "\n  and {} more", self.more)?;
        }
        Ok(())
    }
}

impl std::error::Error for Faults {}
