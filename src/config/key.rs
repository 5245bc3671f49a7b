//! A key: its name, its meaning, what it accepts, and the field behind it.

use std::fmt::Write as _;

use super::Settings;

/// One configuration key.
#[derive(Clone, Copy, Debug)]
pub struct Key {
    /// Section and name, as `smooth.cutoff_hz`.
    pub name: &'static str,
    /// Unit of the value; empty where it has none.
    pub unit: &'static str,
    /// One sentence for the user.
    pub doc: &'static str,
    /// Whether a running daemon can take a new value without reopening a device.
    pub live: bool,
    /// What it accepts and where it is kept.
    pub kind: Kind,
}

/// What a key accepts, and the functions that read and write its field.
#[derive(Clone, Copy, Debug)]
#[expect(missing_docs, reason = "get and set read and write the key's field; the variants say the rest")]
pub enum Kind {
    /// A real number within `range`, ends included.
    Number { range: (f64, f64), get: fn(&Settings) -> f64, set: fn(&mut Settings, f64) },
    /// A real number within `range`, ends included, or "auto": `None`.
    NumberOrAuto { range: (f64, f64), get: fn(&Settings) -> Option<f64>, set: fn(&mut Settings, Option<f64>) },
    /// A real number within `range`, ends included; some have names.
    NamedNumber {
        range: (f64, f64),
        names: &'static [(&'static str, f64)],
        get: fn(&Settings) -> f64,
        set: fn(&mut Settings, f64),
    },
    /// A whole number within `range`, ends included: the least, and every `step`th above.
    Count { range: (u64, u64), step: u64, get: fn(&Settings) -> u64, set: fn(&mut Settings, u64) },
    /// One of a few words.
    Choice { words: &'static [&'static str], get: fn(&Settings) -> &'static str, set: fn(&mut Settings, &str) },
    /// `true` or `false`.
    Switch { get: fn(&Settings) -> bool, set: fn(&mut Settings, bool) },
    /// `true`, `false`, or "auto": `None`.
    SwitchOrAuto { get: fn(&Settings) -> Option<bool>, set: fn(&mut Settings, Option<bool>) },
    /// Any text that is not empty; numbers are taken as their digits.
    Text { get: fn(&Settings) -> &str, set: fn(&mut Settings, String) },
    /// Text of a form that `fits` knows, and `expected` says in words.
    Form { expected: &'static str, fits: fn(&str) -> bool, get: fn(&Settings) -> &str, set: fn(&mut Settings, String) },
}

/// A value as it was written, before it is known to fit its key.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Written {
    /// A whole number; `None` where it does not fit.
    Integer(Option<i64>),
    /// A number with a point or exponent, `nan` or `inf`.
    Float(f64),
    /// A word or quoted text.
    Text(String),
    /// `true` or `false`.
    Truth(bool),
    /// Something no key accepts, by its TOML name.
    Other(&'static str),
}

impl Key {
    /// The part before the point.
    pub fn section(&self) -> &'static str {
        self.name.split_once('.').map_or("", |(section, _)| section)
    }

    /// The part after the point.
    pub fn short_name(&self) -> &'static str {
        self.name.split_once('.').map_or(self.name, |(_, name)| name)
    }

    /// The value that `settings` has, as TOML writes it.
    pub fn value_text(&self, settings: &Settings) -> String {
        match &self.kind {
            Kind::Number { get, .. } => format!("{:?}", get(settings)),
            Kind::NumberOrAuto { get, .. } => get(settings).map_or_else(|| quoted(AUTO), |number| format!("{number:?}")),
            Kind::NamedNumber { names, get, .. } => {
                let number = get(settings);
                let name = names.iter().find(|(_, named)| *named == number);
                name.map_or_else(|| format!("{number:?}"), |(name, _)| quoted(name))
            }
            Kind::Count { get, .. } => get(settings).to_string(),
            Kind::Choice { get, .. } => quoted(get(settings)),
            Kind::Switch { get, .. } => get(settings).to_string(),
            Kind::SwitchOrAuto { get, .. } => get(settings).map_or_else(|| quoted(AUTO), |truth| truth.to_string()),
            Kind::Text { get, .. } | Kind::Form { get, .. } => quoted(get(settings)),
        }
    }

    /// The values that the key accepts, as `0.05 to 10`, without the unit.
    pub fn range(&self) -> String {
        match &self.kind {
            Kind::Number { range: (low, high), .. } => format!("{low} to {high}"),
            Kind::NumberOrAuto { range: (low, high), .. } => format!("{low} to {high}, or {}", quoted(AUTO)),
            Kind::NamedNumber { range: (low, high), names, .. } => {
                let names: Vec<String> = names.iter().map(|(name, number)| format!("{} ({number})", quoted(name))).collect();
                format!("{low} to {high}, or {}", names.join(", "))
            }
            Kind::Count { range: (low, high), step: 1, .. } => format!("{low} to {high}"),
            Kind::Count { range: (low, high), step, .. } => format!("{low} to {high} in steps of {step}"),
            Kind::Choice { words, .. } => {
                let words: Vec<String> = words.iter().map(|word| quoted(word)).collect();
                words.join(", ")
            }
            Kind::Switch { .. } => "true, false".into(),
            Kind::SwitchOrAuto { .. } => format!("true, false, or {}", quoted(AUTO)),
            Kind::Text { .. } => "any text".into(),
            Kind::Form { expected, .. } => (*expected).into(),
        }
    }

    /// What the key expects, as a phrase with range and unit.
    pub fn expected(&self) -> String {
        let mut phrase = match &self.kind {
            Kind::Number { .. } | Kind::NumberOrAuto { .. } | Kind::NamedNumber { .. } => {
                format!("a number from {}", self.range())
            }
            Kind::Count { .. } => format!("a whole number from {}", self.range()),
            Kind::Choice { words: [word], .. } => quoted(word),
            Kind::Choice { .. } => format!("one of {}", self.range()),
            Kind::Switch { .. } => "true or false, without quotes".into(),
            Kind::SwitchOrAuto { .. } => format!("true or false, without quotes, or {}", quoted(AUTO)),
            Kind::Text { .. } => "text that is not empty".into(),
            Kind::Form { expected, .. } => (*expected).into(),
        };
        if !self.unit.is_empty() {
            let _ = write!(phrase, " ({})", self.unit);
        }
        phrase
    }

    /// Takes the value that `from` has into `settings`.
    pub fn copy(&self, from: &Settings, settings: &mut Settings) {
        match &self.kind {
            Kind::Number { get, set, .. } => set(settings, get(from)),
            Kind::NumberOrAuto { get, set, .. } => set(settings, get(from)),
            Kind::NamedNumber { get, set, .. } => set(settings, get(from)),
            Kind::Count { get, set, .. } => set(settings, get(from)),
            Kind::Switch { get, set } => set(settings, get(from)),
            Kind::SwitchOrAuto { get, set } => set(settings, get(from)),
            Kind::Choice { get, set, .. } => set(settings, get(from)),
            Kind::Text { get, set } | Kind::Form { get, set, .. } => set(settings, get(from).to_owned()),
        }
    }

    /// Takes `value` into `settings`; `false`, and nothing is changed, where the key does not accept it.
    pub(super) fn accept(&self, value: &Written, settings: &mut Settings) -> bool {
        let number = match value {
            Written::Integer(Some(whole)) => Some(*whole as f64),
            Written::Float(number) => Some(*number),
            _ => None,
        };
        let within = |range: &(f64, f64)| number.filter(|number| (range.0..=range.1).contains(number));
        match (&self.kind, value) {
            (Kind::Number { range, set, .. }, _) => within(range).map(|number| set(settings, number)).is_some(),
            (Kind::NamedNumber { range, names, set, .. }, _) => {
                let named = names.iter().find(|(name, _)| matches!(value, Written::Text(word) if word == name));
                named.map(|(_, number)| *number).or_else(|| within(range)).map(|number| set(settings, number)).is_some()
            }
            (Kind::NumberOrAuto { set, .. }, Written::Text(word)) if word == AUTO => {
                set(settings, None);
                true
            }
            (Kind::NumberOrAuto { range, set, .. }, _) => within(range).map(|number| set(settings, Some(number))).is_some(),
            (Kind::Count { range, step, set, .. }, Written::Integer(Some(whole))) => {
                let Ok(count) = u64::try_from(*whole) else { return false };
                let fits = (range.0..=range.1).contains(&count) && (count - range.0).is_multiple_of(*step);
                if fits {
                    set(settings, count);
                }
                fits
            }
            (Kind::Form { fits, set, .. }, Written::Text(text)) if fits(text) => {
                set(settings, text.clone());
                true
            }
            (Kind::Choice { words, set, .. }, Written::Text(word)) => {
                let fits = words.contains(&word.as_str());
                if fits {
                    set(settings, word);
                }
                fits
            }
            (Kind::Switch { set, .. }, Written::Truth(truth)) => {
                set(settings, *truth);
                true
            }
            (Kind::SwitchOrAuto { set, .. }, Written::Truth(truth)) => {
                set(settings, Some(*truth));
                true
            }
            (Kind::SwitchOrAuto { set, .. }, Written::Text(word)) if word == AUTO => {
                set(settings, None);
                true
            }
            (Kind::Text { set, .. }, Written::Text(text)) if !text.trim().is_empty() && !text.contains('\0') => {
                set(settings, text.clone());
                true
            }
            (Kind::Text { set, .. }, Written::Integer(Some(number))) => {
                set(settings, number.to_string());
                true
            }
            _ => false,
        }
    }
}

/// The word for a value that gimbald estimates.
const AUTO: &str = "auto";

/// `text` as a basic TOML string.
pub(super) fn quoted(text: &str) -> String {
    toml::Value::from(text).to_string()
}
