//! Writes gimbald's manual pages and shell completions into a directory: what a package brings beside the program.
//!
//! ```sh
//! cargo run --example manuals -- DIRECTORY
//! ```

use std::fmt::Write as _;
use std::path::PathBuf;

use anyhow::Context as _;
use clap::CommandFactory as _;
use clap_complete::{Shell, generate_to};
use gimbald::command::Arguments;
use gimbald::config::{Settings, keys};

fn main() -> anyhow::Result<()> {
    let directory: PathBuf = std::env::args_os().nth(1).context("name a directory: manuals DIRECTORY")?.into();
    std::fs::create_dir_all(&directory).with_context(|| format!("cannot make {}", directory.display()))?;
    let mut command = Arguments::command();
    for shell in [Shell::Bash, Shell::Zsh, Shell::Fish] {
        generate_to(shell, &mut command, "gimbald", &directory)?;
    }
    clap_mangen::generate_to(Arguments::command().disable_help_subcommand(true), &directory)?;
    let page = directory.join("gimbald.toml.5");
    std::fs::write(&page, configuration()).with_context(|| format!("cannot write {}", page.display()))
}

/// The manual page of the configuration: every key, section by section.
fn configuration() -> String {
    let defaults = Settings::default();
    let mut page = format!(
        ".TH GIMBALD.TOML 5 \"\" \"gimbald {}\" \"File formats\"\n\
         .SH NAME\ngimbald.toml \\- configuration of gimbald\n\
         .SH SYNOPSIS\n/etc/gimbald.toml\n.br\n/etc/gimbald/\\fINAME\\fR.toml\n\
         .SH DESCRIPTION\nA TOML file. Keys that are not set have their defaults. \\fBgimbald check\\fR \\fIFILE\\fR checks a file. Keys marked \
         live take effect with \\fBsystemctl reload gimbald\\fR, the others after a restart.\n",
        env!("CARGO_PKG_VERSION")
    );
    let mut section = "";
    for key in keys::KEYS {
        if key.section() != section {
            section = key.section();
            let _ = writeln!(page, ".SH [{}]", escaped(section));
        }
        let unit = if key.unit.is_empty() { String::new() } else { format!(" Unit: {}.", key.unit) };
        let live = if key.live { " Live." } else { "" };
        let doc = format!("{} Range: {}.{unit} Default: {}.{live}", key.doc, key.range(), key.value_text(&defaults));
        let _ = writeln!(page, ".TP\n.B {}\n{}", escaped(key.short_name()), escaped(&doc));
    }
    page += ".SH SEE ALSO\n.BR gimbald (1),\n.BR gimbald-run (1),\n.BR gimbald-check (1)\n";
    page
}

/// Text with what roff would take for its own made harmless.
fn escaped(text: &str) -> String {
    let text = text.replace('\\', "\\e").replace('-', "\\-");
    if text.starts_with(['.', '\'']) { format!("\\&{text}") } else { text }
}
