//! What the README and docs/ say is true: keys, exit codes, examples, files.

use gimbald::command::Exit;
use gimbald::config::{Settings, key_table};
use std::path::{Path, PathBuf};

const CONFIGURATION: &str = include_str!("../docs/configuration.md");

/// The README and everything that documents gimbald beside it: path and text.
fn documents() -> Vec<(PathBuf, String)> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let docs = std::fs::read_dir(root.join("docs")).unwrap().map(|entry| entry.unwrap().path());
    let docs = docs.filter(|path| path.extension().is_some_and(|extension| extension == "md"));
    let tops = ["README.md", "CONTRIBUTING.md", "ARCHITECTURE.md", "CHANGELOG.md", "SECURITY.md"].map(|name| root.join(name));
    docs.chain(tops).map(|path| (path.clone(), std::fs::read_to_string(&path).unwrap())).collect()
}

#[test]
fn every_key_is_documented_as_the_program_knows_it() {
    assert!(CONFIGURATION.contains(&key_table()), "replace the table of keys by the output of `gimbald check --keys`");
}

#[test]
fn every_exit_code_is_documented() {
    for (exit, meaning) in Exit::ALL {
        let row = format!("| {} | {meaning} |\n", exit.code());
        assert!(CONFIGURATION.contains(&row), "no row {row}");
    }
}

#[test]
fn the_configurations_are_valid() {
    let mut seen = 0;
    for (path, text) in documents() {
        for block in text.split("```toml\n").skip(1).filter_map(|rest| rest.split("```").next()) {
            let name = path.to_string_lossy();
            let settings = Settings::read(Some((&name, block)), &[]).unwrap_or_else(|faults| panic!("{faults}"));
            assert_ne!(settings, Settings::default(), "{name}: an example that changes nothing");
            seen += 1;
        }
    }
    assert!(seen > 0);
}

#[test]
fn files_that_are_named_exist() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut named = 0;
    for (path, text) in documents() {
        for word in text.split(|c: char| c.is_whitespace() || "`()[]\"".contains(c)) {
            let word = word.trim_end_matches([',', '.', ';', ':']).split('#').next().unwrap_or_default();
            let ours =
                ["src/", "tests/", "config/", "systemd/", "fixtures/", "docs/", "examples/", "benches/", "fuzz/", ".ci/"];
            if ours.iter().any(|directory| word.starts_with(directory)) && !word.contains(['*', '<', '{']) {
                assert!(root.join(word).exists(), "{}: {word} does not exist", path.display());
                named += 1;
            }
        }
        // Relative links between the documents.
        for link in text.split("](").skip(1).filter_map(|rest| rest.split(')').next()) {
            if !link.contains("://") && !link.starts_with('#') {
                let target = link.split('#').next().unwrap_or(link);
                assert!(path.with_file_name(target).exists(), "{}: the link {link} leads nowhere", path.display());
            }
        }
    }
    assert!(named >= 20, "only {named} were found");
}

/// Continuous integration installs what the README's first command installs, and runs its test command.
#[test]
fn continuous_integration_finds_the_commands_of_the_readme() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let readme = std::fs::read_to_string(root.join("README.md")).unwrap();
    let install = "$(command -v sudo) apt-get install -y build-essential ";
    assert_eq!(readme.lines().filter(|line| line.starts_with(install) && line.contains(" && cargo run ")).count(), 1);
    assert_eq!(readme.lines().filter(|line| line.starts_with("cargo test")).count(), 1);
}
