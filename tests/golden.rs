//! Golden results: the fixtures, stabilized, give the same bytes and the same path as they always gave, at every SIMD level.
//!
//! `tests/golden.txt` has a digest of the output per fixture and model; `tests/golden.csv` has, frame by frame, the camera's path, the
//! virtual camera's and the crop margin in use, so that a difference says where it begins and which channel it is in. When a change of the
//! science is meant to change the pictures, look at the pictures, then write both files again:
//!
//! ```text
//! GIMBALD_GOLDEN=write cargo test --test golden
//! ```
//!
//! The arithmetic is that of IEEE 754 in a fixed order, and so the same on every processor; `sin`, `exp` and the like come from the
//! system's mathematics library, and another one may round another way.

use gimbald::device::digest::DigestSink;
use gimbald::device::replay;
use gimbald::frame::Frame;
use gimbald::image::PictureRef;
use gimbald::kernel::Level;
use gimbald::pipeline::{Observer, Params, run_at_level};
use gimbald::rt::stop::Stop;
use gimbald::stage::paper::homography::{self, Form};
use gimbald::stage::shutter::{self, Model, Parameters};
use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};

/// Set to `write`, it has the golden files written instead of compared.
const VARIABLE: &str = "GIMBALD_GOLDEN";
const FIXTURES: [&str; 2] = ["car-mjpeg-400x300.gbr", "face-yuyv-400x300.gbr"];
/// Differences that are shown.
const SHOWN: usize = 6;

fn in_crate(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}

/// The models, and the names under which the files know them.
fn models() -> [(&'static str, Params); 4] {
    let with = |model, parameters, form| Params {
        shutter: shutter::Params { model, parameters },
        fit: homography::Params { form, ..homography::Params::default() },
        ..Params::default()
    };
    [
        ("cho2007 time-t", with(Model::Cho2007, Parameters::TimeT, Form::Constrained)),
        ("cho2007 time-t+1", with(Model::Cho2007, Parameters::TimeT1, Form::Constrained)),
        ("cho2007 time-t general", with(Model::Cho2007, Parameters::TimeT, Form::General)),
        ("continuous", with(Model::Continuous, Parameters::default(), Form::Constrained)),
    ]
}

/// Writes a line per frame. Seven digits of a path in radians are far below what moves a pixel.
struct Trace<'a> {
    lines: &'a mut String,
    run: String,
    frame: usize,
}

impl Observer for Trace<'_> {
    fn drawn(&mut self, frame: &Frame, _: PictureRef<'_>) {
        let context = &frame.context;
        let _ = write!(self.lines, "{},{}", self.run, self.frame);
        for value in context.path.0.iter().chain(&context.smoothed.0).chain([&context.confidence, &context.crop_use]) {
            // without a sign where it is rounded to 0
            let _ = write!(self.lines, ",{:.7}", (1e7 * value).round() / 1e7 + 0.0);
        }
        self.lines.push('\n');
        self.frame += 1;
    }
}

/// What the two files hold, as this program finds it at a level.
fn results(level: Level) -> [String; 2] {
    let path = |name: &str| (0..4).map(|i| format!(",{name}{i}")).collect::<String>();
    let mut digests = String::new();
    let mut trace = format!("fixture,model,frame{}{},confidence,crop_use\n", path("path"), path("virtual"));
    for fixture in FIXTURES {
        for (model, params) in models() {
            let mut source = replay::open(&in_crate("fixtures").join(fixture)).unwrap();
            let mut sink = DigestSink::new(&source.format());
            let mut observer = Trace { lines: &mut trace, run: format!("{fixture},{model}"), frame: 0 };
            run_at_level(level, source.as_mut(), &mut sink, &params, &Stop::default(), &mut observer).unwrap();
            assert_eq!(Some(sink.submitted()), source.frames());
            digests += &format!("{fixture}: {model}: {}\n", sink.text());
        }
    }
    [digests, trace]
}

/// The first lines that differ, beside each other.
fn differences(golden: &str, found: &str) -> String {
    let counts = [golden, found].map(|text| text.lines().count());
    let pairs = golden.lines().zip(found.lines()).filter(|(a, b)| a != b);
    let mut text: String = pairs.take(SHOWN).map(|(a, b)| format!("- {a}\n+ {b}\n")).collect();
    if counts[0] != counts[1] {
        text += &format!("{} lines in place of {}\n", counts[1], counts[0]);
    }
    text
}

#[test]
fn the_fixtures_give_the_pictures_and_the_path_they_always_gave() {
    let scalar = results(Level::SCALAR);
    assert_eq!(scalar[0].lines().count(), FIXTURES.len() * models().len(), "{}", scalar[0]);
    for level in Level::all() {
        for (found, scalar) in results(level).iter().zip(&scalar) {
            assert!(found == scalar, "{} differs from scalar:\n{}", level.name(), differences(scalar, found));
        }
    }
    let paths = ["tests/golden.txt", "tests/golden.csv"].map(in_crate);
    if std::env::var(VARIABLE).is_ok_and(|word| word == "write") {
        for (path, text) in paths.iter().zip(&scalar) {
            fs::write(path, text).unwrap();
            println!("wrote {}", path.display());
        }
        return;
    }
    let golden = paths.map(|path| fs::read_to_string(path).unwrap());
    let different: String = golden.iter().zip(&scalar).map(|(golden, found)| differences(golden, found)).collect();
    assert!(
        different.is_empty(),
        "the results changed; if that is meant: {VARIABLE}=write cargo test --test golden\n{different}"
    );
}

#[test]
fn a_difference_is_shown_where_it_begins() {
    assert_eq!(differences("a,1\nb,2\nc,3", "a,1\nb,2\nc,3"), "");
    assert_eq!(differences("a,1\nb,2\nc,3", "a,1\nb,4\nc,3\nd"), "- b,2\n+ b,4\n4 lines in place of 3\n");
}
