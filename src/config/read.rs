//! From text to settings: a TOML file, or one `KEY=VALUE`.

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::key::{Written, quoted};
use super::{Fault, Origin, Settings, keys};

/// Longest piece of somebody's input that a message repeats, characters.
const SHOWN: usize = 60;

/// Takes what the file `name` with content `text` says into `settings`, and what is wrong with it into `faults`, by line.
pub(super) fn file(name: &str, text: &str, settings: &mut Settings, faults: &mut Vec<Fault>) {
    let at = |start: usize| Origin::File { name: name.to_owned(), line: line_of(text, start) };
    let (table, errors) = DeTable::parse_recoverable(text);
    let mut found: Vec<(usize, Fault)> = Vec::new();
    for error in errors {
        let start = error.span().map_or(0, |span| span.start);
        let what = format!("not valid TOML: {}", error.message().replace('\n', ", "));
        let advice = "write settings as KEY = VALUE under their [section], text in quotes".to_owned();
        found.push((start, Fault { origin: at(start), setting: String::new(), what, advice }));
    }
    let mut leaves = Vec::new();
    flatten(table.get_ref(), "", text, &mut leaves);
    for leaf in leaves {
        let Leaf { name, written, source, start } = leaf;
        if let Some((setting, what, advice)) = put(&name, &written, source, settings) {
            found.push((start, Fault { origin: at(start), setting, what, advice }));
        }
    }
    found.sort_by_key(|(start, _)| *start);
    faults.extend(found.into_iter().map(|(_, fault)| fault));
}

/// Takes one `KEY=VALUE` of the command line into `settings`, or what is wrong with it into `faults`.
pub(super) fn set(argument: &str, settings: &mut Settings, faults: &mut Vec<Fault>) {
    let Some((name, source)) = argument.split_once('=') else {
        let what = "no = between key and value".to_owned();
        let advice = "write --set KEY=VALUE, as --set smooth.cutoff_hz=0.5".to_owned();
        faults.push(Fault { origin: Origin::Set, setting: shortened(argument), what, advice });
        return;
    };
    let (name, source) = (name.trim(), source.trim());
    // What is no TOML value is a word: nobody wants to quote quotes in a shell.
    let written = match DeValue::parse(source) {
        Ok(value) => written(value.get_ref()),
        Err(_) => Written::Text(source.to_owned()),
    };
    if let Some((setting, what, advice)) = put(name, &written, source, settings) {
        faults.push(Fault { origin: Origin::Set, setting, what, advice });
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

/// Takes one value; otherwise the setting as written, what is wrong, and what to do.
fn put(name: &str, value: &Written, source: &str, settings: &mut Settings) -> Option<(String, String, String)> {
    let setting = format!("{} = {}", shortened(name), shortened(source));
    let Some(key) = keys::find(name) else {
        let advice = if keys::KEYS.iter().any(|key| key.section() == name) {
            format!("{name} is a section: write its keys below a line [{name}], or as {name}.KEY")
        } else if let Some(near) = keys::nearest(name) {
            format!("did you mean {}?", near.name)
        } else {
            let mut sections: Vec<&str> = keys::KEYS.iter().map(|key| key.section()).collect();
            sections.dedup();
            format!("the sections are {}; config/gimbald.toml lists every key", sections.join(", "))
        };
        return Some((setting, "no such key".to_owned(), advice));
    };
    if key.accept(value, settings) {
        return None;
    }
    let what = format!("expected {}, found {}", key.expected(), described(value));
    let advice = format!("choose such a value, or leave the key out for the default {}", key.shown(&Settings::default()));
    Some((setting, what, advice))
}

/// A value that was refused, by what it is.
fn described(value: &Written) -> String {
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
    let mut short: String = text.chars().take(SHOWN).map(|c| if c.is_control() { ' ' } else { c }).collect();
    if short.len() < text.len() && text.chars().nth(SHOWN).is_some() {
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
