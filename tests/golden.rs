//! Golden digests: the fixtures, stabilized, give the same bytes as they always gave, at every SIMD level.
//!
//! `tests/golden.txt` holds them, a line per stream and model. When a change of the science is meant to change the pictures, look at
//! the pictures, then write the file anew:
//!
//! ```text
//! GIMBALD_GOLDEN=write cargo test --test golden
//! ```
//!
//! The arithmetic is that of IEEE 754 in a fixed order, and so the same on every x86-64; `sin`, `exp` and the like come from the
//! system's mathematics library, and another one may round another way.

use gimbald::device::digest::DigestSink;
use gimbald::device::replay;
use gimbald::kernel::{LEVEL_VARIABLE, Level};
use gimbald::pipeline::{Params, run_inline};
use gimbald::rt::stop::Stop;
use gimbald::stage::fit::{self, Form};
use gimbald::stage::shutter::{self, Model, Parameters};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Set to `write`, it has the golden digests written anew instead of compared.
const VARIABLE: &str = "GIMBALD_GOLDEN";
/// Before each line of the digests that a child process prints.
const MARK: &str = "golden: ";

fn in_crate(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}

/// The models, and the names under which the file knows them.
fn models() -> [(&'static str, Params); 4] {
    let with = |model, parameters, form| Params {
        shutter: shutter::Params { model, parameters },
        fit: fit::Params { form, ..fit::Params::default() },
        ..Params::default()
    };
    [
        ("cho2007 time-t", with(Model::Cho2007, Parameters::TimeT, Form::Constrained)),
        ("cho2007 time-t+1", with(Model::Cho2007, Parameters::TimeT1, Form::Constrained)),
        ("cho2007 time-t general", with(Model::Cho2007, Parameters::TimeT, Form::General)),
        ("continuous", with(Model::Continuous, Parameters::default(), Form::Constrained)),
    ]
}

/// Every digest, as the file has them.
fn digests() -> String {
    let mut lines = String::new();
    for fixture in ["car-mjpeg-400x300.gbr", "face-yuyv-400x300.gbr"] {
        for (model, params) in models() {
            let mut source = replay::open(&in_crate("fixtures").join(fixture)).unwrap();
            let mut sink = DigestSink::new(&source.format());
            run_inline(source.as_mut(), &mut sink, &params, &Stop::default(), &mut ()).unwrap();
            assert_eq!(Some(sink.submitted()), source.frames());
            lines += &format!("{fixture}: {model}: {}\n", sink.text());
        }
    }
    lines
}

/// The digests at a level, found by this program once more in a process of its own: a process has one level.
fn digests_at(level: Level) -> String {
    let run = Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "print", "--ignored", "--nocapture"])
        .env(LEVEL_VARIABLE, level.name())
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&run.stdout);
    assert!(run.status.success(), "{said}{}", String::from_utf8_lossy(&run.stderr));
    let lines = said.lines().filter_map(|line| line.split_once(MARK));
    lines.map(|(_, line)| format!("{line}\n")).collect()
}

#[test]
#[ignore = "is run by the_fixtures_give_the_pictures_they_always_gave"]
fn print() {
    println!("level {}", Level::detected().name());
    digests().lines().for_each(|line| println!("{MARK}{line}"));
}

#[test]
fn the_fixtures_give_the_pictures_they_always_gave() {
    let path = in_crate("tests/golden.txt");
    let levels: Vec<(&str, String)> = Level::all().map(|level| (level.name(), digests_at(level))).collect();
    let (_, scalar) = &levels[0];
    assert_eq!(scalar.lines().count(), 8, "{scalar}");
    for (level, found) in &levels {
        assert_eq!(found, scalar, "{level} does not give the bytes of scalar");
    }
    if std::env::var(VARIABLE).is_ok_and(|word| word == "write") {
        fs::write(&path, scalar).unwrap();
        println!("wrote {}:\n{scalar}", path.display());
        return;
    }
    let golden = fs::read_to_string(&path).unwrap();
    assert_eq!(*scalar, golden, "the pictures changed; if that is meant: {VARIABLE}=write cargo test --test golden");
}
