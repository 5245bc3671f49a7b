//! Writes the notices of all third-party code that is linked into gimbald: what a package has to bring beside the program.
//!
//! ```sh
//! cargo run --example notices -- FILE [TARGET]
//! ```
//!
//! What is linked is what Cargo says: the normal dependencies for TARGET (a triple; by default this machine's), without build scripts,
//! procedural macros and tests. Texts are those that the crates bring, each once, with the names of those that bring it. Beside the crates there are
//! libjpeg-turbo, which turbojpeg-sys contains, the recording that `gimbald demo` shows, and Rust's standard library, whose notices Rust's
//! own documentation has.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context as _, bail, ensure};
use serde::Deserialize;

/// Beginnings of the names of files with licences and notices, in lower case.
const NAMES: [&str; 6] = ["license", "licence", "copying", "copyright", "notice", "unlicense"];
/// Code in another language inside a crate: the crate, what it is, its licence, the folder with its texts, and which those are.
const BUNDLED: [(&str, &str, &str, &str, &[&str]); 1] =
    [("turbojpeg-sys", "libjpeg-turbo", "IJG AND BSD-3-Clause AND Zlib", "libjpeg-turbo", &["LICENSE.md", "README.ijg"])];
/// The recording that `gimbald demo` shows: its name, its licence, and the file with its text.
const RECORDING: (&str, &str, &str) = ("recording of gimbald demo", "MIT", "fixtures/LICENSE-car");
const HEAD: &str = "Third-party software in gimbald\n\n\
    This software is based in part on the work of the Independent JPEG Group.\n\n\
    The program gimbald contains the following, under these licences. The texts follow, each with the names of those it belongs to.\n\
    Rust's standard library, under \"MIT OR Apache-2.0\", is in it too: its notices, and those of what it contains, are in\n\
    COPYRIGHT-library.html, which Rust's distribution has in share/doc/rust and gimbald's package beside this file.\n\n";

/// A crate that is linked.
pub struct Linked {
    /// As Cargo.toml has it.
    pub name: String,
    /// Likewise.
    pub version: String,
    /// An SPDX expression, or an older crate's "MIT/Apache-2.0".
    pub licence: String,
    /// Names and addresses; newer crates have none.
    pub authors: Vec<String>,
    /// Where its source is.
    pub folder: PathBuf,
}

#[derive(Deserialize)]
struct Metadata {
    packages: Vec<Package>,
}

#[derive(Deserialize)]
struct Package {
    name: String,
    version: String,
    license: Option<String>,
    authors: Vec<String>,
    manifest_path: PathBuf,
}

fn main() -> anyhow::Result<()> {
    let file: PathBuf = std::env::args_os().nth(1).context("name a file: notices FILE [TARGET]")?.into();
    let text = notices(&linked(std::env::args().nth(2).as_deref())?)?;
    std::fs::write(&file, text).with_context(|| format!("cannot write {}", file.display()))
}

/// The tree that Cargo runs this for. Not the one that it was built in: packages are built from copies of a tree, with one target folder, and
/// Cargo takes what it built for one of them for the next.
fn root() -> PathBuf {
    std::env::var_os("CARGO_MANIFEST_DIR").unwrap_or_else(|| env!("CARGO_MANIFEST_DIR").into()).into()
}

/// What `cargo` says to `arguments`.
fn cargo(arguments: &[&str]) -> anyhow::Result<String> {
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let output = Command::new(cargo).args(arguments).current_dir(root()).output().context("cannot run cargo")?;
    ensure!(output.status.success(), "cargo {}: {}", arguments.join(" "), String::from_utf8_lossy(&output.stderr));
    Ok(String::from_utf8(output.stdout)?)
}

/// The crates that are linked into the program for `target`, by name and version.
pub fn linked(target: Option<&str>) -> anyhow::Result<Vec<Linked>> {
    let mut arguments =
        vec!["tree", "--locked", "--edges", "no-dev,no-build,no-proc-macro", "--prefix", "none", "--format", "{p}"];
    arguments.extend(target.into_iter().flat_map(|target| ["--target", target]));
    let tree = cargo(&arguments)?;
    let metadata: Metadata = serde_json::from_str(&cargo(&["metadata", "--locked", "--format-version", "1"])?)?;
    let mut names = BTreeSet::new();
    for line in tree.lines() {
        let mut words = line.split(' ');
        let (Some(name), Some(version)) = (words.next(), words.next().and_then(|word| word.strip_prefix('v'))) else {
            bail!("cargo tree says {line:?}");
        };
        names.insert((name, version));
    }
    names.remove(&(env!("CARGO_PKG_NAME"), env!("CARGO_PKG_VERSION")));
    ensure!(!names.is_empty(), "cargo tree names no crates");
    names.into_iter().map(|(name, version)| find(&metadata, name, version)).collect()
}

fn find(metadata: &Metadata, name: &str, version: &str) -> anyhow::Result<Linked> {
    let package = metadata.packages.iter().find(|package| package.name == name && package.version == version);
    let package = package.with_context(|| format!("cargo metadata has no {name} {version}"))?;
    let licence = package.license.clone().with_context(|| format!("{name} {version} names no licence"))?;
    let folder = package.manifest_path.parent().context("a manifest has a folder")?.to_owned();
    Ok(Linked { name: name.into(), version: version.into(), licence, authors: package.authors.clone(), folder })
}

/// The whole file.
pub fn notices(crates: &[Linked]) -> anyhow::Result<String> {
    let mut list = String::new();
    let mut texts: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for part in crates {
        let name = format!("{} {}", part.name, part.version);
        writeln!(list, "{name:40} {}", part.licence)?;
        for text in own_texts(part)? {
            texts.entry(text).or_default().push(name.clone());
        }
        for (_, what, licence, folder, files) in BUNDLED.iter().filter(|bundled| bundled.0 == part.name) {
            writeln!(list, "{:40} {licence}", format!("{what} (in {name})"))?;
            for file in *files {
                texts.entry(read(&part.folder.join(folder).join(file))?).or_default().push((*what).into());
            }
        }
    }
    for (crate_name, what, ..) in BUNDLED {
        ensure!(list.contains(what), "{crate_name}, which contains {what}, is not among what is linked");
    }
    let (what, licence, file) = RECORDING;
    writeln!(list, "{what:40} {licence}")?;
    texts.entry(read(&root().join(file))?).or_default().push(what.into());
    // In the order of the first that each belongs to.
    let mut texts: Vec<_> = texts.into_iter().map(|(text, owners)| (owners, text)).collect();
    texts.sort();
    let mut all = HEAD.to_owned() + &list;
    for (owners, text) in texts {
        write!(all, "\n\n{}\n{}\n{0}\n\n{text}\n", "=".repeat(80), owners.join(", "))?;
    }
    Ok(all)
}

/// The texts that a crate brings; where it brings none, the text of the first licence that it names and we have.
pub fn own_texts(part: &Linked) -> anyhow::Result<Vec<String>> {
    let mut texts = Vec::new();
    for entry in std::fs::read_dir(&part.folder).with_context(|| format!("cannot read {}", part.folder.display()))? {
        let entry = entry?;
        let name = entry.file_name().to_string_lossy().to_ascii_lowercase();
        if NAMES.iter().any(|beginning| name.starts_with(beginning)) && entry.file_type()?.is_file() {
            texts.push(read(&entry.path())?);
        }
    }
    if texts.is_empty() {
        let ours = [("MIT", "LICENSE-MIT"), ("Apache-2.0", "LICENSE-APACHE")];
        let mut named = part.licence.split([' ', '/', '(', ')']);
        let Some((licence, file)) = named.find_map(|word| ours.into_iter().find(|(licence, _)| *licence == word)) else {
            bail!("{} {} ({}) brings no licence text", part.name, part.version, part.licence);
        };
        let text = read(&root().join(file))?;
        // The licence without our own copyright line.
        let text = text.lines().filter(|line| !line.starts_with("Copyright")).collect::<Vec<_>>().join("\n");
        let authors = if part.authors.is_empty() { "its authors".into() } else { part.authors.join(", ") };
        texts.push(format!("Copyright (c) {authors}\nThe crate brings no text; this is that of {licence}.\n\n{}", text.trim()));
    }
    Ok(texts)
}

/// A text, with the same ends of lines and nothing around it, so that equal ones are seen to be equal.
fn read(path: &Path) -> anyhow::Result<String> {
    let text = std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    Ok(text.replace("\r\n", "\n").trim().to_owned())
}
