//! The configuration file that ships, and the README's table, written from the table of keys.

use std::fmt::Write as _;

use super::{Settings, keys};

/// The text of `config/gimbald.toml`: every key with meaning, unit, range and default.
pub fn shipped_file() -> String {
    let defaults = Settings::default();
    let mut text = String::from(
        "# Configuration of gimbald. Every key is here with its default; leave out what you do not change.\n\
         # `gimbald check FILE` says whether a file is right. On the command line: --set smooth.cutoff_hz=0.5\n\
         # Keys marked \"live\" can change while gimbald runs without reopening a device.\n",
    );
    let mut section = "";
    for key in keys::KEYS {
        if key.section() != section {
            section = key.section();
            let _ = write!(text, "\n[{section}]\n");
        } else {
            text.push('\n');
        }
        let default = key.shown(&defaults);
        let unit = if key.unit.is_empty() { String::new() } else { format!("Unit: {}. ", key.unit) };
        let live = if key.live { " Live." } else { "" };
        let _ = writeln!(text, "# {}", key.doc);
        let _ = writeln!(text, "# {unit}Range: {}. Default: {default}.{live}", key.range());
        let _ = writeln!(text, "{} = {default}", key.short_name());
    }
    text
}

/// The README's table of keys, as Markdown.
pub fn key_table() -> String {
    let defaults = Settings::default();
    let mut text = String::from("| key | default | range | meaning |\n|---|---|---|---|\n");
    for key in keys::KEYS {
        let unit = if key.unit.is_empty() { String::new() } else { format!(" ({})", key.unit) };
        let _ = writeln!(text, "| `{}` | `{}` | {}{unit} | {} |", key.name, key.shown(&defaults), key.range(), key.doc);
    }
    text
}
