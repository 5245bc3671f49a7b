//! The house's rules, read off the source: who may enter whom, where `unsafe` lives, how long a file may be.

use std::fs;
use std::path::{Path, PathBuf};

/// A room, and the rooms that it may enter besides itself. What is not here is not built yet: give it its line first.
const FLOORS: &[(&str, &[&str])] = &[
    ("geometry", &[]),
    ("image", &[]),
    ("random", &[]),
    ("rt", &[]),
    ("kernel", &["geometry", "image"]),
    ("frame", &["geometry", "image"]),
    ("stage", &["kernel", "frame", "geometry", "image", "random"]),
    ("device", &["kernel", "frame", "geometry", "image", "random", "rt"]),
    ("share", &["device", "kernel", "frame", "image", "rt"]),
    ("pipewire", &["rt"]),
    ("companion", &["pipewire", "share", "device", "kernel", "image", "rt"]),
    ("pipeline", &["stage", "device", "kernel", "frame", "geometry", "image", "rt"]),
    ("config", &["pipeline", "stage", "device", "image"]),
    ("systemd", &[]),
    ("log", &["config"]),
    ("control", &["systemd", "log", "config", "pipeline", "frame", "geometry", "rt"]),
    ("report", &["control", "config", "pipeline", "stage", "device", "kernel", "frame", "geometry", "image", "rt"]),
    ("view", &["share", "control", "config", "report", "pipeline", "stage", "device", "frame", "geometry", "image", "rt"]),
    ("daemon", &["share", "control", "systemd", "config", "pipeline", "stage", "device", "frame", "geometry", "image", "rt"]),
    (
        "command",
        &[
            "daemon",
            "control",
            "systemd",
            "log",
            "config",
            "report",
            "pipeline",
            "stage",
            "device",
            "kernel",
            "frame",
            "geometry",
            "image",
            "rt",
            "pipewire",
            "companion",
            "view",
        ],
    ),
];

/// What a room's code must not say: it would be another room's work.
const ABSENT: &[(&str, &[&str])] = &[
    ("geometry", &["std::fs", "std::thread", "Instant", ".hypot("]),
    ("image", &["std::fs", "std::thread", "Instant"]),
    ("random", &["std::fs", "std::thread", "Instant"]),
    ("kernel", &["std::fs", "std::thread", "Instant", "Vec::new", "Box::new"]),
    (
        "stage",
        &["std::fs", "std::thread", "std::env", "Instant", "SystemTime", "monotonic_ns", "std::io", "println", ".hypot("],
    ),
    ("pipeline", &["std::fs", "device::v4l2", "device::y4m", "toml::", "ioctl"]),
    ("config", &["std::fs", "File::", "std::env", "std::thread"]),
    ("device", &["Homography", "nalgebra"]),
];

/// The only places with `unsafe`.
const UNSAFE: [&str; 4] = ["src/device/v4l2/", "src/kernel/", "src/pipewire/", "src/share/memory.rs"];
const LONGEST: usize = 600;
/// Lines of a function.
const LONGEST_FUNCTION: usize = 60;
/// Words that texts for users do not contain: they are private or poetic language where the field has a word of its own.
const NOT_FOR_USERS: &[&str] = &[
    "frames a second",
    "anew",
    "finds out",
    "find out",
    "found out",
    "give or take",
    "given up for",
    "look at it",
    "mends",
    "answers to this",
    "for ever",
    "in vain",
    "nobody",
    "somebody",
    "stands still",
    "takes it ill",
    "taken for a",
    "takes for a",
    "takes out",
    "taken out",
    "whoever",
];
/// Words that no comment in `src` contains: private or poetic ones, and names that code no longer has.
const NOT_IN_COMMENTS: &[&str] = &[
    "anew",
    "as good as",
    "finds out",
    "for ever",
    "forth and back",
    "found out",
    "lets go of",
    "nobody",
    "sees to it",
    "somebody",
    "stands still",
    "suitcase",
    "taken for",
    "taken out",
    "takes it ill",
    "whoever",
];
/// May say `allow` for `expect`: each of the tests that share it uses another part of it.
const ALLOWING: [&str; 1] = ["tests/common/mod.rs"];
const NO_NAMES: [&str; 5] = ["util", "utils", "helpers", "misc", "common"];

/// Every Rust file below `directory`, sorted.
fn files(directory: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in fs::read_dir(directory).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            found.extend(files(&path));
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            found.push(path);
        }
    }
    found.sort();
    found
}

/// The code of a source without its comments and, they being guests everywhere, without its tests (which stand at the end).
fn code(source: &str) -> String {
    let source = source.split("\n#[cfg(test)]\nmod tests {").next().unwrap_or(source);
    source.lines().map(|line| line.split("//").next().unwrap_or("")).collect::<Vec<_>>().join("\n")
}

/// The functions of a source and their lines, as rustfmt lays them out: from the line with `fn` to the brace at its indentation.
fn functions(source: &str) -> Vec<(&str, usize)> {
    let lines: Vec<&str> = source.lines().collect();
    let mut functions = Vec::new();
    for (start, line) in lines.iter().enumerate() {
        let indent = &line[..line.len() - line.trim_start().len()];
        let before = |at: usize| line[..at].split_whitespace().all(|word| !word.starts_with("//") && !word.contains('"'));
        let Some(at) = line.find("fn ").filter(|at| before(*at) && !line.ends_with(';')) else { continue };
        let name = line[at + 3..].split(|c: char| !c.is_alphanumeric() && c != '_').next().unwrap_or_default();
        let is_end = |line: &&&str| line.strip_prefix(indent).is_some_and(|rest| rest.starts_with('}'));
        if name.is_empty() || line.trim_end().ends_with('}') || !line.starts_with(indent) {
            continue;
        }
        functions.extend(lines[start..].iter().position(|line| is_end(&line)).map(|length| (name, length + 1)));
    }
    functions
}

/// The texts in a source: what stands between quotes outside of comments, and the comments that become `--help`.
fn texts(path: &str, source: &str) -> Vec<String> {
    let source = source.split("\n#[cfg(test)]\nmod tests {").next().unwrap_or(source);
    let mut texts = Vec::new();
    let mut open: Option<String> = None;
    let mut comments = Vec::new();
    for line in source.lines() {
        let trimmed = line.trim_start();
        if open.is_none() && trimmed.starts_with("//") {
            comments.extend(trimmed.strip_prefix("///").map(str::to_owned));
            continue;
        }
        let is_help = trimmed.starts_with("#[arg") || path.ends_with("command/arguments.rs");
        texts.extend(comments.drain(..).filter(|_| is_help));
        let mut escaped = false;
        // A character literal of a quote opens nothing.
        for c in line.replace("'\"'", "").chars() {
            match (&mut open, c) {
                (Some(text), _) if escaped => text.push(c),
                (Some(_), '\\') => {}
                (open @ Some(_), '"') => texts.extend(open.take()),
                (Some(text), c) => text.push(c),
                (open, '"') => *open = Some(String::new()),
                (None, _) => {}
            }
            escaped = c == '\\' && !escaped;
        }
        if let Some(text) = &mut open {
            text.push(' ');
        }
    }
    texts
}

/// Whether `text` has `words` as whole words.
fn says(text: &str, words: &str) -> bool {
    let is_letter = |c: Option<char>| c.is_some_and(|c| c.is_alphanumeric() || c == '_');
    let text = text.split_whitespace().collect::<Vec<_>>().join(" ").to_lowercase();
    let mut found = text.match_indices(words);
    found.any(|(at, _)| !is_letter(text[..at].chars().next_back()) && !is_letter(text[at + words.len()..].chars().next()))
}

/// The modules that a file is in, from the crate's root down: `src/device/y4m/mod.rs` is `device`, `y4m`.
fn modules(path: &str) -> Vec<&str> {
    let path = path.trim_start_matches("src/").trim_end_matches(".rs").trim_end_matches("/mod");
    path.split('/').filter(|part| !["lib", "main"].contains(part)).collect()
}

/// The rooms that `code`, standing in `modules`, names by `crate::` or by climbing out with `super::`.
fn entered(code: &str, modules: &[&str]) -> Vec<String> {
    let mut rooms = Vec::new();
    let names = |rest: &str| -> Vec<String> {
        let word = |text: &str| text.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect::<String>();
        let Some(group) = rest.strip_prefix('{') else { return vec![word(rest)] };
        let (mut depth, mut firsts, mut start) = (0, Vec::new(), true);
        for (at, c) in group.char_indices() {
            match c {
                '{' => depth += 1,
                '}' if depth == 0 => break,
                '}' => depth -= 1,
                ',' if depth == 0 => start = true,
                _ if depth == 0 && start && (c.is_alphabetic() || c == '_') => {
                    firsts.push(word(&group[at..]));
                    start = false;
                }
                _ => {}
            }
        }
        firsts
    };
    for (at, _) in code.match_indices("crate::") {
        if !code[..at].ends_with(|c: char| c.is_alphanumeric() || c == '_') {
            rooms.extend(names(&code[at + "crate::".len()..]));
        }
    }
    for (at, _) in code.match_indices("super::") {
        if code[..at].ends_with("super::") {
            continue;
        }
        let mut rest = &code[at..];
        let mut climbed = 0;
        while let Some(after) = rest.strip_prefix("super::") {
            (rest, climbed) = (after, climbed + 1);
        }
        if climbed >= modules.len() {
            rooms.extend(names(rest));
        }
    }
    rooms.retain(|room| room.starts_with(|c: char| c.is_lowercase()) && room != "self");
    rooms
}

/// The rooms that a source of room `room` enters, besides itself.
fn entered_by(path: &str, source: &str) -> Vec<String> {
    let modules = modules(path);
    if modules.contains(&"tests") {
        return Vec::new();
    }
    let mut rooms = entered(&code(source), &modules);
    rooms.retain(|room| Some(&room.as_str()) != modules.first());
    rooms
}

/// What is wrong with one file, `path` as from the crate's root.
fn faults(path: &str, source: &str) -> Vec<String> {
    let mut faults = Vec::new();
    let mut fault = |what: String| faults.push(format!("{path}: {what}"));
    if !source.starts_with("//! ") {
        fault("the first line is no //! sentence".into());
    }
    let lines = source.lines().count();
    if lines > LONGEST {
        fault(format!("{lines} lines; {LONGEST} at most"));
    }
    // `expect` permits the same, and the compiler reports one that nothing needs.
    let permits = |line: &&str| ["#[allow(", "#![allow("].iter().any(|word| line.trim_start().starts_with(word));
    if let Some(line) = source.lines().find(permits).filter(|_| !ALLOWING.contains(&path)) {
        fault(format!("{}: write #[expect(...)]", line.trim()));
    }
    if !path.starts_with("src/") {
        return faults;
    }
    let modules = modules(path);
    if let Some(name) = modules.iter().find(|name| NO_NAMES.contains(name)) {
        fault(format!("a module named {name} is a room without an idea"));
    }
    let is_tests = modules.last() == Some(&"tests") || modules.contains(&"tests");
    let code = code(source);
    if code.split(|c: char| !c.is_alphanumeric() && c != '_').any(|word| word == "unsafe")
        && !UNSAFE.iter().any(|room| path.starts_with(room))
    {
        fault(format!("unsafe outside of {UNSAFE:?}"));
    }
    if !is_tests {
        for (name, lines) in functions(source.split("\n#[cfg(test)]\nmod tests {").next().unwrap_or(source)) {
            if lines > LONGEST_FUNCTION {
                fault(format!("the function {name} has {lines} lines; {LONGEST_FUNCTION} at most"));
            }
        }
        let comments = source.lines().filter_map(|line| Some((line, line.split_once("//")?.1.trim_start_matches(['/', '!']))));
        for (line, comment) in comments {
            for words in NOT_IN_COMMENTS.iter().filter(|words| says(comment, words)) {
                fault(format!("{words:?} in the comment {:?}: say it in plain technical English", line.trim()));
            }
        }
        for text in texts(path, source) {
            for words in NOT_FOR_USERS.iter().filter(|words| says(&text, words)) {
                fault(format!("{words:?} in the text {text:?}: say it in plain technical English"));
            }
        }
    }
    let Some(room) = modules.first().filter(|_| !is_tests) else { return faults };
    match FLOORS.iter().find(|(name, _)| name == room) {
        None => fault(format!("the room {room} has no line in FLOORS of tests/house.rs")),
        Some((_, may)) => {
            for other in entered(&code, &modules) {
                if other != *room && !may.contains(&other.as_str()) {
                    fault(format!("{room} enters {other}; it may enter {may:?}"));
                }
            }
        }
    }
    for word in ABSENT.iter().filter(|(name, _)| name == room).flat_map(|(_, words)| *words) {
        if code.contains(word) {
            fault(format!("{word} does not belong into {room}"));
        }
    }
    faults
}

#[test]
fn the_house_stands() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut all = Vec::new();
    let mut seen = 0;
    for directory in ["src", "tests", "benches", "examples", "fuzz/src"] {
        let directory = root.join(directory);
        if !directory.is_dir() {
            continue;
        }
        for file in files(&directory) {
            let path = file.strip_prefix(root).unwrap().to_string_lossy().replace('\\', "/");
            all.extend(faults(&path, &fs::read_to_string(&file).unwrap()));
            seen += 1;
        }
    }
    assert!(seen > 30, "only {seen} files were looked at");
    assert!(all.is_empty(), "\n{}\n", all.join("\n"));
}

/// A permission that nothing uses is one that a mistake may use.
#[test]
fn every_room_enters_the_rooms_that_it_may_enter() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut used: Vec<(String, String)> = Vec::new();
    for file in files(&root.join("src")) {
        let path = file.strip_prefix(root).unwrap().to_string_lossy().replace('\\', "/");
        let room = modules(&path).first().map_or_else(String::new, |room| (*room).to_owned());
        used.extend(entered_by(&path, &fs::read_to_string(&file).unwrap()).into_iter().map(|other| (room.clone(), other)));
    }
    let mut unused = Vec::new();
    for (room, may) in FLOORS {
        for other in *may {
            if !used.iter().any(|(from, to)| from == room && to == other) {
                unused.push(format!("{room} may enter {other}, and does not"));
            }
        }
    }
    assert!(unused.is_empty(), "remove from FLOORS:\n{}", unused.join("\n"));
}

#[test]
fn every_room_is_described_in_the_order_of_its_floors() {
    for (index, (room, may)) in FLOORS.iter().enumerate() {
        for other in *may {
            let below = FLOORS[..index].iter().any(|(name, _)| name == other);
            assert!(below, "{room} may enter {other}, which is not on a floor below");
        }
    }
}

/// The rules themselves can fail.
#[test]
fn a_crooked_house_is_noticed() {
    let one = |path: &str, source: &str| {
        let faults = faults(path, source);
        assert_eq!(faults.len(), 1, "{path}: {source}: {faults:?}");
        faults[0].clone()
    };
    assert!(one("src/stage/fit.rs", "//! x\nuse crate::device::DeviceError;").contains("stage enters device"));
    assert!(one("src/stage/fit.rs", "//! x\nuse crate::{image::Plane, rt};").contains("stage enters rt"));
    assert!(one("src/kernel/a/b.rs", "//! x\nuse super::super::super::frame::Frame;").contains("kernel enters frame"));
    assert!(one("src/image/mod.rs", "//! x\nfn f() { super::rt::stop(); }").contains("image enters rt"));
    assert!(one("src/stage/fit.rs", "//! x\nunsafe { f() }").contains("unsafe outside"));
    assert!(one("src/stage/fit.rs", "//! x\nuse std::fs;").contains("std::fs"));
    assert!(one("src/stage/fit.rs", "fn f() {}").contains("first line"));
    assert!(one("src/stage/utils.rs", "//! x").contains("utils"));
    assert!(one("src/attic/mod.rs", "//! x").contains("no line in FLOORS"));
    assert!(one("src/stage/fit.rs", "//! x\nfn f() { g(\"read\\\n  anew\"); }").contains("plain technical English"));
    assert!(one("src/stage/fit.rs", "//! x\n/// Nobody asks.\nfn f() {}").contains("in the comment"));
    assert!(
        one("src/command/x.rs", "//! x\nstruct A {\n    /// Frames a second\n    #[arg(long)]\n    a: u8,\n}")
            .contains("plain technical English")
    );
    let long = |lines: usize| {
        format!("//! x\nimpl A {{\n    fn f(\n        a: u8,\n    ) {{\n{}    }}\n}}", "        g();\n".repeat(lines))
    };
    assert!(one("src/stage/fit.rs", &long(57)).contains("the function f has 61 lines"));
    assert_eq!(faults("src/stage/fit.rs", &long(56)), Vec::<String>::new());
    assert!(one("src/stage/fit.rs", "//! x\n#[allow(dead_code)]\nfn f() {}").contains("#[expect(...)]"));
    assert_eq!(faults("tests/common/mod.rs", "//! x\n#![allow(dead_code)]"), Vec::<String>::new());
    assert_eq!(entered_by("src/stage/fit.rs", "//! x\nuse crate::{image::Plane, stage::crop};"), ["image"]);
    assert!(one("tests/x.rs", &format!("//! x\n{}", "//\n".repeat(600))).contains("601 lines"));
    let fine = "//! Unsafe words: unsafe.\n/// A comment.\nconst A: &str = \"a seconds \\\" hand\";\nuse crate::image::{Plane, PlaneRef};\nuse super::detect;\n// crate::device::no\n\
                fn f() {}\n\n#[cfg(test)]\nmod tests {\n    use crate::device::DeviceError;\n}";
    assert_eq!(faults("src/stage/fit.rs", fine), Vec::<String>::new());
}
