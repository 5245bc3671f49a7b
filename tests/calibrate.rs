//! `gimbald calibrate` finds what the synthetic camera was told, says how sure it is, and says so where it cannot know.

mod common;

use common::film as shots_of;
use common::stamps::{ALL, Stamped, stamp};
use gimbald::device::recording::RecordingWriter;
use gimbald::device::synthetic::{Motion, Params, Synthetic};
use gimbald::device::y4m::Y4mSink;
use gimbald::device::{FrameSink, FrameSource, Lent, RawFrame};
use gimbald::image::Picture;
use gimbald::stage::unpack::Unpack;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

/// Cameras in the matrix, for each way of stamping.
const SEEDS: u64 = 8;

/// A file, gone afterwards.
struct Clip(PathBuf);

impl Drop for Clip {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}

fn film(name: &str, params: &Params) -> Clip {
    let path = std::env::temp_dir().join(format!("gimbald-calibrate-{}-{name}.y4m", std::process::id()));
    let clip = Clip(path);
    let mut source = Synthetic::new(params).unwrap();
    let mut sink = Y4mSink::create(&clip.0, &source.format()).unwrap();
    let (mut unpack, mut picture) = (Unpack::default(), Picture::default());
    while let Lent::Frame(frame) = source.lend().unwrap() {
        let format = frame.format;
        unpack
            .unpack(format.pixel, format.colour.range, (format.width, format.height), format.stride, frame.bytes, &mut picture)
            .unwrap();
        sink.canvas().unwrap().planes.iter_mut().zip(picture.as_ref().planes).for_each(|(to, from)| to.copy_from(from));
        sink.submit(&frame.stamp).unwrap();
    }
    sink.finish().unwrap();
    clip
}

/// The same as a recording, its frames stamped as said.
fn record(name: &str, params: &Params, stamped: Stamped, seed: u64) -> Clip {
    let clip = Clip(std::env::temp_dir().join(format!("gimbald-calibrate-{}-{name}.gbr", std::process::id())));
    let mut shots = shots_of(params);
    stamp(&mut shots, stamped, params.fps, seed);
    let mut writer = RecordingWriter::create(&clip.0, &shots[0].format, "test").unwrap();
    for shot in &shots {
        writer.write_raw(&RawFrame { format: shot.format, bytes: &shot.bytes, stamp: shot.stamp }).unwrap();
    }
    writer.finish().unwrap();
    clip
}

fn small(readout_part: f64, hfov_deg: f64) -> Params {
    let fps = 30.0;
    let readout_ms = readout_part * 1e3 / fps;
    Params { width: 320, height: 240, fps, readout_ms, hfov_deg, frames: 150, seed: 7, ..Params::default() }
}

fn calibrate(input: &Path, more: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_gimbald"));
    command.arg("calibrate").arg(input).args(more).stdin(Stdio::null()).output().unwrap()
}

/// The number after `mark`.
#[track_caller]
fn number(text: &str, mark: &str) -> f64 {
    let rest = text.split(mark).nth(1).unwrap_or_else(|| panic!("no {mark:?} in {text}"));
    let end = rest.find(|c: char| !c.is_ascii_digit() && c != '.' && c != '-').unwrap_or(rest.len());
    rest[..end].trim_end_matches('.').parse().unwrap()
}

/// The number after "±" in the line that begins with `what`.
#[track_caller]
fn uncertainty(text: &str, what: &str) -> f64 {
    let line = text.lines().find(|line| line.starts_with(what)).unwrap_or_else(|| panic!("no {what:?} in {text}"));
    number(line, " ± ")
}

#[test]
fn readout_times_of_either_sign_and_fields_of_view_are_found() {
    for (readout_part, hfov_deg) in [(0.3, 75.0), (1.0, 50.0), (-0.6, 60.0)] {
        let clip = film(&format!("{readout_part}"), &small(readout_part, hfov_deg));
        let output = calibrate(&clip.0, &[]);
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        assert_eq!(output.status.code(), Some(0), "{readout_part}: {text} {}", String::from_utf8_lossy(&output.stderr));
        let truth_ms = readout_part * 1e3 / 30.0;
        let (readout_ms, hfov) = (number(&text, "readout_ms = "), number(&text, "hfov_deg = "));
        // within what is said, and what is said is worth something
        let (within_ms, within_deg) = (uncertainty(&text, "readout time: "), uncertainty(&text, "field of view: "));
        assert!((readout_ms - truth_ms).abs() <= within_ms, "{truth_ms}: {text}");
        assert!((hfov - hfov_deg).abs() <= within_deg, "{hfov_deg}: {text}");
        assert!(within_ms < 0.1 * 1e3 / 30.0 && within_deg < 5.0, "{text}");
        assert!(
            (readout_ms - truth_ms).abs() < 0.02 * 1e3 / 30.0 && (hfov - hfov_deg).abs() < 1.0,
            "{truth_ms} {hfov_deg}: {text}"
        );
        assert!(text.contains(if readout_part < 0.0 { "bottom to top" } else { "top to bottom" }), "{text}");
    }
}

/// What was said of a camera of known readout time and field of view.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Said {
    /// Both, and the truth is as near as was said.
    Right,
    /// Nothing to copy, and why.
    Refused,
    /// Something else.
    Wrong,
}

/// Calibrates from the frames of `params`'s camera, stamped as said.
fn said(params: &Params, stamped: Stamped, seed: u64) -> (Said, String) {
    let clip = record(&format!("{stamped:?}-{seed}").replace(|c: char| !c.is_ascii_alphanumeric(), "-"), params, stamped, seed);
    let output = calibrate(&clip.0, &[]);
    let (text, errors) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    let has_lines = ["readout_ms = ", "hfov_deg = ", "[camera]"].iter().any(|line| text.contains(line));
    let said = match output.status.code() {
        Some(0) => {
            let (readout_ms, hfov) = (number(&text, "readout_ms = "), number(&text, "hfov_deg = "));
            let (within_ms, within_deg) = (uncertainty(&text, "readout time: "), uncertainty(&text, "field of view: "));
            let is_right = (readout_ms - params.readout_ms).abs() <= within_ms && (hfov - params.hfov_deg).abs() <= within_deg;
            if is_right { Said::Right } else { Said::Wrong }
        }
        Some(75) if !has_lines => Said::Refused,
        _ => Said::Wrong,
    };
    (said, format!("{text}{errors}"))
}

/// What is said of a camera whose frames are stamped unevenly holds, or nothing is said but why.
#[test]
fn uneven_times_are_counted_in_or_refused() {
    let mut right = 0;
    for (seed, stamped) in (1u64..).zip([
        Stamped::Jitter(3.0),
        Stamped::Jitter(8.0),
        Stamped::Late(20.0),
        Stamped::Late(40.0),
        Stamped::Stalls(166.0),
        Stamped::Bursts(3),
        Stamped::Dropped { counted: true },
    ]) {
        let (said, text) = said(&Params { frames: 150, seed, ..small(0.75, 60.0) }, stamped, seed);
        println!("{stamped:?}: {said:?}\n{text}");
        assert!(said != Said::Wrong, "{stamped:?}: {text}");
        assert!(said == Said::Right || text.contains("uneven time stamps"), "{stamped:?}: {text}");
        right += u32::from(said == Said::Right);
    }
    assert!(right >= 3, "only {right} were told");
}

/// The same for many seeds, readout times and fields of view; takes minutes.
#[test]
#[ignore = "by hand: cargo test --release --test calibrate -- --ignored --nocapture matrix"]
fn matrix() {
    let mut wrong = 0;
    for stamped in ALL {
        let mut counts = [0; 3];
        for seed in 0..SEEDS {
            let (part, hfov_deg) = [(0.75, 60.0), (0.9, 70.0), (0.4, 55.0), (-0.6, 65.0)][(seed % 4) as usize];
            let (said, text) = said(&Params { frames: 180, seed: 100 + seed, ..small(part, hfov_deg) }, stamped, seed);
            counts[said as usize] += 1;
            if said == Said::Wrong {
                println!("{stamped:?}, seed {seed}, readout {part}, {hfov_deg} degrees:\n{text}");
            }
        }
        println!("{stamped:?}: of {SEEDS}, {} right, {} refused, {} wrong", counts[0], counts[1], counts[2]);
        wrong += counts[2];
    }
    let most = SEEDS * ALL.len() as u64 / 20;
    assert!(wrong <= most, "{wrong} wrong, more than the {most} of which two deviations may miss");
}

/// Times that say next to nothing are named as what is to blame.
#[test]
fn a_clock_that_says_nothing_is_named() {
    let clip = record("still-clock", &small(0.75, 60.0), Stamped::Still, 1);
    let output = calibrate(&clip.0, &[]);
    let (text, errors) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert_eq!(output.status.code(), Some(75), "{text} {errors}");
    assert!(errors.contains("uneven time stamps") && !errors.contains("too little"), "{errors}");
    assert!(!text.contains("[camera]"), "{text}");
}

#[test]
fn what_the_configuration_says_of_the_camera_is_left_aside() {
    let clip = film("wrong", &small(0.6, 60.0));
    let wrong = ["--set", "camera.readout_ms=-30", "--set", "camera.hfov_deg=120", "--set", "shutter.model=cho2007"];
    let (plain, with_wrong) = (calibrate(&clip.0, &[]), calibrate(&clip.0, &wrong));
    assert_eq!(plain.status.code(), Some(0));
    assert_eq!(plain.stdout, with_wrong.stdout);
}

#[test]
fn a_still_camera_tells_nothing_and_that_is_said() {
    let clip = film("still", &Params { motion: Motion::Still, ..small(0.6, 60.0) });
    let output = calibrate(&clip.0, &[]);
    let (text, errors) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert_eq!(output.status.code(), Some(75), "{text} {errors}");
    assert!(
        errors.contains("too little or unsuitable motion") && errors.contains("uncertainty of the readout time"),
        "{errors}"
    );
    assert!(!text.contains("readout_ms") && !text.contains("hfov_deg"), "{text}");
}

#[test]
fn few_frames_and_no_frames_are_no_answer_either() {
    let clip = film("few", &small(0.6, 60.0));
    let output = calibrate(&clip.0, &["--frames", "4"]);
    assert_eq!(output.status.code(), Some(75));
    assert!(String::from_utf8_lossy(&output.stderr).contains("only 4 frames"));
    let missing = calibrate(Path::new("no-such-file.y4m"), &[]);
    assert_eq!(missing.status.code(), Some(66));
    let numbered = calibrate(Path::new("no such camera anywhere"), &[]);
    assert_eq!(numbered.status.code(), Some(69), "{}", String::from_utf8_lossy(&numbered.stderr));
}

#[test]
fn seconds_end_it() {
    let clip = film("seconds", &small(0.6, 60.0));
    let output = calibrate(&clip.0, &["--seconds", "2"]);
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(text.contains(": 60 frames, 2.0 s"), "{text} {}", String::from_utf8_lossy(&output.stderr));
}
