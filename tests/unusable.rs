//! Recordings with frames that cannot be used: every command says how many and why, and blames nothing else.

use gimbald::device::recording::RecordingWriter;
use gimbald::device::{Lent, RawFrame, replay};
use gimbald::frame::FrameFlags;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// 24 frames of 400x300 MJPEG.
const CAR: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/fixtures/car-mjpeg-400x300.gbr");

/// A directory of its own for a test, gone afterwards.
struct Scratch(PathBuf);

impl Scratch {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("gimbald-unusable-{}-{name}", std::process::id()));
        fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    fn file(&self, name: &str) -> String {
        self.0.join(name).to_str().unwrap().to_owned()
    }

    /// The recording with the frames that `spoil` answers otherwise spoilt.
    fn spoilt(&self, name: &str, spoil: impl Fn(usize) -> Spoilt) -> String {
        let path = self.file(name);
        let mut source = replay::open(Path::new(CAR)).unwrap();
        let mut writer = RecordingWriter::create(Path::new(&path), &source.format(), "test").unwrap();
        let mut n = 0;
        while let Lent::Frame(frame) = source.lend().unwrap() {
            let (zeros, mut stamp) = (vec![0; frame.bytes.len()], frame.stamp);
            let bytes = match spoil(n) {
                Spoilt::Not => frame.bytes,
                Spoilt::Zeros => &zeros,
                Spoilt::Empty => &[],
                Spoilt::Marked => {
                    stamp.flags = FrameFlags::ERROR;
                    frame.bytes
                }
            };
            writer.write_raw(&RawFrame { bytes, stamp, ..frame }).unwrap();
            n += 1;
        }
        assert_eq!(n, 24);
        writer.finish().unwrap();
        path
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

#[derive(Clone, Copy)]
enum Spoilt {
    Not,
    Zeros,
    Empty,
    Marked,
}

/// Exit code, standard output and standard error.
fn gimbald(arguments: &[&str]) -> (i32, String, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_gimbald")).args(arguments).stdin(Stdio::null()).output().unwrap();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (output.status.code().unwrap(), text(&output.stdout), text(&output.stderr))
}

#[track_caller]
fn says(words: &str, text: &str) {
    assert!(text.contains(words), "{words:?} in {text:?}");
}

#[test]
fn where_no_frame_can_be_used_all_say_why_and_end_with_65() {
    let scratch = Scratch::new("none");
    for (name, spoilt, words) in [
        ("zeros.gbr", Spoilt::Zeros, "24 of 24 frames cannot be decoded: the JPEG picture is damaged: "),
        ("empty.gbr", Spoilt::Empty, "24 of 24 frames cannot be used: the frame has no bytes"),
        ("marked.gbr", Spoilt::Marked, "24 of 24 frames cannot be used: the frame is marked as damaged"),
    ] {
        let input = scratch.spoilt(name, |_| spoilt);
        let (code, _, errors) = gimbald(&["replay", &input, "-o", "null:"]);
        assert_eq!(code, 65, "{errors}");
        says(words, &errors);
        says("contains only black pictures", &errors);
        let (code, answer, errors) = gimbald(&["check", &input]);
        assert_eq!(code, 65, "{errors}");
        says(words, &answer);
        says("no usable frames", &errors);
        let (code, answer, errors) = gimbald(&["calibrate", &input]);
        assert_eq!(code, 65, "{errors}");
        says(words, &errors);
        assert!(!errors.contains("motion") && answer.is_empty(), "{answer} {errors}");
    }
}

#[test]
fn where_some_frames_cannot_be_used_the_rest_is_shown_and_it_is_said() {
    let scratch = Scratch::new("some");
    let input = scratch.spoilt("some.gbr", |n| match n {
        3 | 9 => Spoilt::Zeros,
        12 => Spoilt::Empty,
        _ => Spoilt::Not,
    });
    let (output, stats) = (scratch.file("out.gbr"), scratch.file("stats.json"));
    let (code, _, errors) = gimbald(&["replay", &input, "-o", &output, "--stats", &stats]);
    assert_eq!(code, 0, "{errors}");
    says("warning: ", &errors);
    says("3 of 24 frames cannot be decoded, 2 of them for this reason: the JPEG picture is damaged: ", &errors);
    let mut source = replay::open(Path::new(&output)).unwrap();
    let frames = std::iter::from_fn(|| matches!(source.lend().unwrap(), Lent::Frame(_)).then_some(())).count();
    assert_eq!(frames, 24, "as many out as in");
    let stats: serde_json::Value = serde_json::from_str(&fs::read_to_string(stats).unwrap()).unwrap();
    assert_eq!(stats["frames"]["unusable"], serde_json::json!({ "damaged": 2, "empty": 1 }));
    let (code, answer, errors) = gimbald(&["check", &input]);
    assert_eq!(code, 65, "{errors}");
    says("24 frames, 400x300 MJPG", &answer);
    says("3 of 24 frames cannot be decoded", &answer);
    says("replay repeats the previous picture for each", &errors);
}

#[test]
fn where_most_frames_cannot_be_used_calibrate_blames_them() {
    let scratch = Scratch::new("most");
    let input = scratch.spoilt("most.gbr", |n| if n % 3 == 0 { Spoilt::Not } else { Spoilt::Zeros });
    let (code, _, errors) = gimbald(&["calibrate", &input]);
    assert_eq!(code, 65, "{errors}");
    says("16 of 24 frames cannot be decoded: the JPEG picture is damaged", &errors);
    assert!(!errors.contains("motion"), "{errors}");
}

/// A recording that is whole says nothing of the kind.
#[test]
fn where_every_frame_can_be_used_nothing_is_said() {
    let (code, answer, errors) = gimbald(&["check", CAR]);
    assert_eq!((code, errors.as_str()), (0, ""), "{answer}");
    assert!(!answer.contains("cannot"), "{answer}");
    assert_eq!(gimbald(&["replay", CAR, "-o", "null:"]), (0, String::new(), String::new()));
}
