//! What is wrong with somebody's settings, where, and what to do about it.

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

/// Every fault of a reading, in the order in which they were written; never empty.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Faults(pub Vec<Fault>);

impl fmt::Display for Faults {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let count = self.0.len();
        write!(f, "{count} {} in the configuration:", if count == 1 { "fault" } else { "faults" })?;
        self.0.iter().try_for_each(|fault| write!(f, "\n  {fault}"))
    }
}

impl std::error::Error for Faults {}
