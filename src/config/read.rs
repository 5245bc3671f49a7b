//! Reads settings from text: a TOML file, or one `KEY=VALUE`.

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::key::{Written, quoted};
use super::{Fault, Faults, Key, Origin, Settings, keys};

/// Longest piece of the user's input that a message repeats, characters.
const SHOWN: usize = 60;

/// Longest reason of the TOML parser that a message repeats, characters.
const LONGEST_REASON: usize = 300;

/// Takes what the file `file` with content `text` says into `settings`, and what is wrong with it into `faults`, by line. Takes a time
/// that grows with the text's length and no faster.
pub(super) fn file(file: &str, text: &str, settings: &mut Settings, faults: &mut Faults) {
    let (table, errors) = DeTable::parse_recoverable(text);
    let mut found: Vec<(usize, Problem<'_>)> = Vec::new();
    for error in &errors {
        found.push((error.span().map_or(0, |span| span.start), Problem::Syntax(error.message())));
    }
    let mut leaves = Vec::new();
    flatten(table.get_ref(), "", text, &mut leaves);
    for leaf in leaves {
        let Leaf { name, written, source, start } = leaf;
        if let Some(key) = keys::retired(&name) {
            let origin = Origin::File { name: file.to_owned(), line: line_of(text, start) };
            retire(key, &written, source, origin, settings);
            continue;
        }
        if let Some(problem) = put(name, written, source, settings) {
            found.push((start, problem));
        }
    }
    found.sort_by_key(|(start, _)| *start);
    for (start, problem) in found {
        faults.add(|| problem.into_fault(Origin::File { name: file.to_owned(), line: line_of(text, start) }));
    }
}

/// Takes one `KEY=VALUE` of the command line into `settings`, or what is wrong with it into `faults`.
pub(super) fn set(argument: &str, settings: &mut Settings, faults: &mut Faults) {
    let Some((name, source)) = argument.split_once('=') else {
        return faults.add(|| Problem::NoAssignment(argument).into_fault(Origin::Set));
    };
    let (name, source) = (name.trim(), source.trim());
    // What is no TOML value is a word, so that a shell's user need not quote quotes.
    let written = match DeValue::parse(source) {
        Ok(value) => written(value.get_ref()),
        Err(_) => Written::Text(source.to_owned()),
    };
    if let Some(key) = keys::retired(name) {
        retire(key, &written, source, Origin::Set, settings);
        return;
    }
    if let Some(problem) = put(name.to_owned(), written, source, settings) {
        faults.add(|| problem.into_fault(Origin::Set));
    }
}

/// A key and its value as the file has them.
struct Leaf<'a> {
    name: String,
    written: Written,
    source: &'a str,
    start: usize,
}

/// Lists the values of `table` and of the tables in it under their full names. (The TOML parser bounds the nesting.)
fn flatten<'a>(table: &DeTable<'_>, prefix: &str, text: &'a str, leaves: &mut Vec<Leaf<'a>>) {
    for (key, value) in table {
        let name = if prefix.is_empty() { key.get_ref().to_string() } else { format!("{prefix}.{}", key.get_ref()) };
        match value.get_ref() {
            DeValue::Table(inner) => flatten(inner, &name, text, leaves),
            other => {
                let source = text.get(Spanned::span(value)).unwrap_or("");
                leaves.push(Leaf { name, written: written(other), source, start: key.span().start });
            }
        }
    }
}

/// What a TOML value is to the keys.
fn written(value: &DeValue<'_>) -> Written {
    match value {
        DeValue::Integer(integer) => Written::Integer(i64::from_str_radix(integer.as_str(), integer.radix()).ok()),
        DeValue::Float(float) => float.as_str().parse().map_or(Written::Other("float"), Written::Float),
        DeValue::String(text) => Written::Text(text.to_string()),
        DeValue::Boolean(truth) => Written::Truth(*truth),
        other => Written::Other(other.type_str()),
    }
}

/// Notes a key that has no effect any more, unless its value never had one.
fn retire(key: &keys::Retired, value: &Written, source: &str, origin: Origin, settings: &mut Settings) {
    if *value != Written::Text(key.harmless.to_owned()) {
        let setting = format!("{} = {}", key.name, shortened(source));
        let what = "this key is obsolete and has no effect".to_owned();
        settings.retired.push(Fault { origin, setting, what, advice: key.advice.to_owned() });
    }
}

/// Takes one value; otherwise what is wrong with it.
fn put<'a>(name: String, value: Written, source: &'a str, settings: &mut Settings) -> Option<Problem<'a>> {
    match keys::find(&name) {
        None => Some(Problem::NoSuchKey { name, source }),
        Some(key) if key.accept(&value, settings) => None,
        Some(key) => Some(Problem::Refused { key, value, source }),
    }
}

/// What is wrong, before it is put into words: most of many faults never are.
enum Problem<'a> {
    /// What the TOML parser says.
    Syntax(&'a str),
    /// An argument without `=`.
    NoAssignment(&'a str),
    /// A name, with the value as written, that is no key's.
    NoSuchKey { name: String, source: &'a str },
    /// A value that the key does not accept.
    Refused { key: &'static Key, value: Written, source: &'a str },
}

impl Problem<'_> {
    fn into_fault(self, origin: Origin) -> Fault {
        let setting = |name: &str, source: &str| format!("{} = {}", shortened(name), shortened(source));
        let (setting, what, advice) = match self {
            Self::Syntax(message) => (
                String::new(),
                format!("not valid TOML: {}", cut(&message.replace('\n', ", "), LONGEST_REASON)),
                "write settings as KEY = VALUE under their [section], text in quotes".to_owned(),
            ),
            Self::NoAssignment(argument) => (
                shortened(argument),
                "no = between key and value".to_owned(),
                "write --set KEY=VALUE, e.g. --set smooth.cutoff_hz=0.5".to_owned(),
            ),
            Self::NoSuchKey { name, source } => (setting(&name, source), "no such key".to_owned(), other_than(&name)),
            Self::Refused { key, value, source } => {
                let default = key.value_text(&Settings::default());
                let advice = format!("fix the value, or remove the key to use the default {default}");
                let what = format!("expected {}, found {}", key.expected(), describe(&value));
                (setting(key.name, source), what, advice)
            }
        };
        Fault { origin, setting, what, advice }
    }
}

/// What to write in place of a name that is no key's.
fn other_than(name: &str) -> String {
    if keys::KEYS.iter().any(|key| key.section() == name) {
        return format!("{name} is a section; write its keys below a [{name}] line, or as {name}.KEY");
    }
    if let Some(near) = keys::nearest(name) {
        return format!("did you mean {}?", near.name);
    }
    let mut sections: Vec<&str> = keys::KEYS.iter().map(|key| key.section()).collect();
    sections.dedup();
    format!("the sections are {}; config/gimbald.toml lists every key", sections.join(", "))
}

/// A value that was refused, by what it is.
fn describe(value: &Written) -> String {
    match value {
        Written::Integer(None) => "a whole number too large to read".into(),
        Written::Integer(Some(number)) => number.to_string(),
        Written::Float(number) => number.to_string(),
        Written::Text(text) => format!("the text {}", quoted(&shortened(text))),
        Written::Truth(truth) => truth.to_string(),
        Written::Other(kind @ "array") => format!("an {kind}"),
        Written::Other(kind) => format!("a {kind}"),
    }
}

/// `text` on one line, cut where it is long.
fn shortened(text: &str) -> String {
    cut(text, SHOWN)
}

/// `text` on one line, `most` characters of it at most.
fn cut(text: &str, most: usize) -> String {
    let mut characters = text.chars().map(|c| if c.is_control() { ' ' } else { c });
    let mut short: String = characters.by_ref().take(most).collect();
    if characters.next().is_some() {
        short.push_str("...");
    }
    short
}

/// Line (from 1) in which byte `start` of `text` lies.
fn line_of(text: &str, start: usize) -> usize {
    1 + text.as_bytes()[..start.min(text.len())].iter().filter(|byte| **byte == b'\n').count()
}

#[cfg(test)]
mod tests;
