//! The shipped configuration file and the table in docs/configuration.md, generated from the table of keys.

use std::fmt::Write as _;

use super::{Settings, keys};

/// The text of `config/gimbald.toml`: every key with meaning, unit, range and default.
pub fn shipped_file() -> String {
    let defaults = Settings::default();
    let mut text = String::from(
        "# Configuration of gimbald: every key with its default. Keys that you leave out keep their defaults.\n\
         # Check a file with `gimbald check FILE`. On the command line, use --set smooth.cutoff_hz=0.5\n\
         # Keys marked \"Live\" take effect on reload or `gimbald set`, the others after a restart.\n\
         #\n\
         # Generated from src/config/keys.rs by `gimbald check --defaults`: change it there.\n",
    );
    let mut section = "";
    for key in keys::KEYS {
        if key.section() != section {
            section = key.section();
            let _ = write!(text, "\n[{section}]\n");
        } else {
            text.push('\n');
        }
        let default = key.value_text(&defaults);
        let unit = if key.unit.is_empty() { String::new() } else { format!("Unit: {}. ", key.unit) };
        let live = if key.live { " Live." } else { "" };
        let _ = writeln!(text, "# {}", key.doc);
        let _ = writeln!(text, "# {unit}Range: {}. Default: {default}.{live}", key.range());
        let _ = writeln!(text, "{} = {default}", key.short_name());
    }
    text
}

/// The table of keys in docs/configuration.md, as Markdown.
pub fn key_table() -> String {
    let defaults = Settings::default();
    let mut text = String::from("| key | default | range | meaning |\n|---|---|---|---|\n");
    for key in keys::KEYS {
        let unit = if key.unit.is_empty() { String::new() } else { format!(" ({})", key.unit) };
        let _ = writeln!(text, "| `{}` | `{}` | {}{unit} | {} |", key.name, key.value_text(&defaults), key.range(), key.doc);
    }
    text
}
