//! The notices of third-party code name all that is linked, and nothing else.

#[expect(dead_code)]
#[path = "../examples/notices.rs"]
mod notices;

use std::collections::{BTreeMap, BTreeSet};
use std::io::Write as _;
use std::process::Command;

use serde_json::Value;

/// What `cargo metadata` says; `None`, aloud, where this machine has no cargo or cannot ask it.
fn metadata(target: &str) -> Option<Value> {
    let arguments = ["metadata", "--locked", "--offline", "--format-version", "1", "--filter-platform", target];
    let output = Command::new(env!("CARGO")).args(arguments).current_dir(env!("CARGO_MANIFEST_DIR")).output();
    match output {
        Ok(output) if output.status.success() => Some(serde_json::from_slice(&output.stdout).unwrap()),
        other => {
            // Past the test harness, which keeps what a test prints to itself.
            let _ = writeln!(std::io::stderr(), "SKIPPED: notices: cargo metadata does not answer: {other:?}");
            None
        }
    }
}

/// Names and versions of what is reached from the root by normal dependencies: build scripts, tests and procedural macros are not linked.
fn reached(metadata: &Value) -> BTreeSet<String> {
    let list = |value: &Value| value.as_array().unwrap().clone();
    let packages: BTreeMap<String, Value> =
        list(&metadata["packages"]).into_iter().map(|package| (package["id"].as_str().unwrap().to_owned(), package)).collect();
    let nodes: BTreeMap<String, Value> =
        list(&metadata["resolve"]["nodes"]).into_iter().map(|node| (node["id"].as_str().unwrap().to_owned(), node)).collect();
    let is_macro =
        |id: &str| list(&packages[id]["targets"]).iter().any(|target| list(&target["kind"]).contains(&"proc-macro".into()));
    let root = metadata["resolve"]["root"].as_str().unwrap().to_owned();
    let (mut seen, mut waiting) = (BTreeSet::new(), vec![root.clone()]);
    while let Some(id) = waiting.pop() {
        if is_macro(&id) || !seen.insert(id.clone()) {
            continue;
        }
        for dependency in list(&nodes[&id]["deps"]) {
            if list(&dependency["dep_kinds"]).iter().any(|kind| kind["kind"].is_null()) {
                waiting.push(dependency["pkg"].as_str().unwrap().to_owned());
            }
        }
    }
    seen.remove(&root);
    let name =
        |id: &String| format!("{} {}", packages[id]["name"].as_str().unwrap(), packages[id]["version"].as_str().unwrap());
    seen.iter().map(name).collect()
}

#[test]
fn all_that_is_linked_is_named_with_its_text() {
    ["x86_64-unknown-linux-gnu", "aarch64-unknown-linux-gnu"].into_iter().for_each(all_is_named);
}

fn all_is_named(target: &str) {
    let Some(metadata) = metadata(target) else { return };
    let linked = notices::linked(Some(target)).unwrap();
    let named: BTreeSet<String> = linked.iter().map(|part| format!("{} {}", part.name, part.version)).collect();
    let reached = reached(&metadata);
    assert!(named.len() > 30, "{named:?}");
    // `cargo metadata` knows of optional dependencies that only tests switch on: what is named may be less by those, and by no other.
    let strangers: Vec<_> = named.difference(&reached).collect();
    assert!(strangers.is_empty(), "named, but not linked: {strangers:?}");
    let text = notices::notices(&linked).unwrap();
    let (head, texts) = text.split_once(&"=".repeat(80)).unwrap();
    for name in &named {
        assert!(head.lines().any(|line| line.starts_with(name)), "{name} is not in the list");
        assert!(texts.lines().any(|line| line.split(", ").any(|owner| owner == name)), "{name} has no text");
    }
    for name in ["libjpeg-turbo", "Independent JPEG Group", "COPYRIGHT-library.html", "recording of gimbald demo"] {
        assert!(head.contains(name), "{name}");
    }
    for name in
        ["Li Haipeng", "The Modified (3-clause) BSD License", "Permission is hereby granted, free of charge", "Apache License"]
    {
        assert!(texts.contains(name), "{name}");
    }
    for name in ["bindgen ", "proptest ", "syn ", "cmake ", "clap_derive ", "gimbald "] {
        assert!(!head.lines().any(|line| line.starts_with(name)), "{name}is not linked");
    }
}

#[test]
fn a_crate_without_a_text_gets_its_licence_s_and_one_without_either_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let part = |licence: &str| notices::Linked {
        name: "nameless".into(),
        version: "1.0.0".into(),
        licence: licence.into(),
        authors: vec!["A. Author <a@example.org>".into()],
        folder: folder.path().to_owned(),
    };
    let texts = notices::own_texts(&part("Unlicense OR MIT")).unwrap();
    assert!(
        texts.len() == 1 && texts[0].starts_with("Copyright (c) A. Author") && texts[0].contains("free of charge"),
        "{texts:?}"
    );
    assert!(!texts[0].contains("gimbald"), "{texts:?}");
    let error = notices::own_texts(&part("LicenseRef-Own")).unwrap_err().to_string();
    assert!(error.contains("nameless 1.0.0") && error.contains("no licence text"), "{error}");
    std::fs::write(folder.path().join("COPYING.txt"), "Do as you like.\r\n").unwrap();
    assert_eq!(notices::own_texts(&part("LicenseRef-Own")).unwrap(), ["Do as you like."]);
}
