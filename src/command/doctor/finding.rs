//! A finding of `gimbald doctor`: what was found, its severity, and the suggested fix.

use std::fmt;

use serde::Serialize;

/// How bad.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Severity {
    /// As it should be.
    Good,
    /// Good to know.
    Note,
    /// It works, and could be better.
    Advice,
    /// It keeps gimbald from working.
    Fault,
    /// The configuration is wrong.
    Config,
}

/// One thing that was looked at.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// How bad.
    pub severity: Severity,
    /// What was looked at, in one word.
    pub about: &'static str,
    /// What was found.
    pub what: String,
    /// The suggested fix: a command, or where there is none a sentence. Empty where nothing needs to be fixed.
    pub mend: String,
}

impl Finding {
    /// As it should be.
    pub fn good(about: &'static str, what: impl Into<String>) -> Self {
        Self { severity: Severity::Good, about, what: what.into(), mend: String::new() }
    }

    /// Good to know.
    pub fn note(about: &'static str, what: impl Into<String>) -> Self {
        Self { severity: Severity::Note, ..Self::good(about, what) }
    }

    /// It works, and could be better.
    pub fn advice(about: &'static str, what: impl Into<String>, mend: impl Into<String>) -> Self {
        Self { severity: Severity::Advice, mend: mend.into(), ..Self::good(about, what) }
    }

    /// It keeps gimbald from working.
    pub fn fault(about: &'static str, what: impl Into<String>, mend: impl Into<String>) -> Self {
        Self { severity: Severity::Fault, mend: mend.into(), ..Self::good(about, what) }
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let word = match self.severity {
            Severity::Good => "ok",
            Severity::Note => "note",
            Severity::Advice => "advice",
            Severity::Fault | Severity::Config => "FAULT",
        };
        let plain =
            |text: &str| text.replace(|c: char| c.is_control() && c != '\n', " ").replace('\n', "\n                   ");
        writeln!(f, "{word:<7} {:<10} {}", self.about, plain(&self.what))?;
        if !self.mend.is_empty() {
            writeln!(f, "        {:<10} -> {}", "", plain(&self.mend))?;
        }
        Ok(())
    }
}
