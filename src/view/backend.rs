//! What a page can show: a daemon or a recording.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use serde_json::{Value, json};

use super::preview::{Cursor, Preview};
use crate::config::{Key, Kind, Settings, keys};

/// A source of pictures, with settings.
pub trait Backend: Send + Sync {
    /// Its name for users.
    fn name(&self) -> String;

    /// Whether it is a recording, which can be paused and searched.
    fn is_recording(&self) -> bool;

    /// Whether a new value of `key` takes effect at once.
    fn is_live(&self, key: &Key) -> bool;

    /// The newest picture after `seen`; `None` if none arrives within `timeout`.
    fn preview(&self, seen: Cursor, timeout: Duration) -> Option<Arc<Preview>>;

    /// Its state, without the settings.
    fn state(&self) -> Value;

    /// The settings in effect.
    ///
    /// # Errors
    /// Why they are not known.
    fn settings(&self) -> Result<Settings, String>;

    /// Applies one `KEY=VALUE`.
    ///
    /// # Errors
    /// What is wrong with it, for users.
    fn set(&self, assignment: &str) -> Result<(), String>;

    /// Controls a recording: `play`, `pause`, `seek SECONDS`, `loop` or `once`.
    ///
    /// # Errors
    /// What is wrong with it, for users.
    fn play(&self, command: &str) -> Result<(), String>;

    /// The configuration file that settings are written to, if there is one.
    fn configuration(&self) -> Option<PathBuf>;
}

/// The settings that the page offers, with what it needs to show them.
pub(super) fn offered(backend: &dyn Backend) -> Vec<Value> {
    let defaults = Settings::default();
    keys::KEYS
        .iter()
        .filter(|key| is_offered(key))
        .map(|key| {
            let (kind, low, high, step) = match &key.kind {
                Kind::Number { range: (low, high), .. } | Kind::NamedNumber { range: (low, high), .. } => ("number", *low, *high, 0),
                Kind::NumberOrAuto { range: (low, high), .. } => ("number or auto", *low, *high, 0),
                Kind::Count { range: (low, high), step, .. } => ("count", *low as f64, *high as f64, *step),
                Kind::Choice { .. } => ("choice", 0.0, 0.0, 0),
                Kind::Switch { .. } => ("switch", 0.0, 0.0, 0),
                Kind::SwitchOrAuto { .. } | Kind::Text { .. } | Kind::Form { .. } => ("text", 0.0, 0.0, 0),
            };
            let names: &[(&str, f64)] = if let Kind::NamedNumber { names, .. } = &key.kind { names } else { &[] };
            let names: Value = names.iter().map(|(name, number)| ((*name).to_owned(), json!(number))).collect();
            let words: &[&str] = if let Kind::Choice { words, .. } = &key.kind { words } else { &[] };
            json!({
                "name": key.name, "meaning": key.doc, "unit": key.unit, "range": key.range(), "kind": kind, "low": low, "high": high,
                "step": step, "words": words, "names": names, "default": key.value_text(&defaults), "live": backend.is_live(key),
            })
        })
        .collect()
}

/// Whether the page offers a key: it affects the picture, not where pictures come from or go to.
pub(super) fn is_offered(key: &Key) -> bool {
    !["output", "control", "log"].contains(&key.section())
        && !["camera.device", "camera.format", "camera.width", "camera.height", "camera.fps", "fit.seed"].contains(&key.name)
}
