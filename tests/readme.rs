//! What the README says is so: keys, exit codes, examples, files.

use gimbald::command::Exit;
use gimbald::config::{Settings, key_table};
use std::path::Path;

const README: &str = include_str!("../README.md");

#[test]
fn it_has_every_key_as_the_program_knows_it() {
    assert!(README.contains(&key_table()), "replace the table of keys by what `gimbald check --keys` prints");
}

#[test]
fn it_has_every_exit_code() {
    for (exit, meaning) in Exit::ALL {
        let row = format!("| {} | {meaning} |\n", exit.code());
        assert!(README.contains(&row), "no row {row}");
    }
}

#[test]
fn its_configurations_are_right() {
    let blocks: Vec<&str> = README.split("```toml\n").skip(1).filter_map(|rest| rest.split("```").next()).collect();
    assert!(!blocks.is_empty());
    for block in blocks {
        let settings = Settings::read(Some(("README.md", block)), &[]).unwrap_or_else(|faults| panic!("{faults}"));
        assert_ne!(settings, Settings::default(), "an example that changes nothing");
    }
}

#[test]
fn files_that_it_names_are_there() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut named = 0;
    for word in README.split(|c: char| c.is_whitespace() || "`()".contains(c)) {
        let word = word.trim_end_matches([',', '.', ';', ':']);
        let ours = ["src/", "tests/", "config/", "systemd/", "fixtures/", ".ci/"];
        if ours.iter().any(|directory| word.starts_with(directory)) {
            assert!(root.join(word).exists(), "{word} is not there");
            named += 1;
        }
    }
    assert!(named >= 6, "only {named} were found");
}
