//! `gimbald calibrate` finds what the synthetic camera was told, says how sure it is, and says so where it cannot know.

use gimbald::device::synthetic::{Motion, Params, Synthetic};
use gimbald::device::y4m::Y4mSink;
use gimbald::device::{FrameSink, FrameSource, Lent};
use gimbald::image::Picture;
use gimbald::stage::unpack::Unpack;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

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

fn small(readout_part: f64, hfov_deg: f64) -> Params {
    let fps = 30.0;
    let readout_ms = readout_part * 1e3 / fps;
    Params { width: 320, height: 240, fps, readout_ms, hfov_deg, frames: 100, seed: 7, ..Params::default() }
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
        let (within_ms, within_deg) = (number(&text, " ms, give or take "), number(&text, "right, give or take "));
        assert!((readout_ms - truth_ms).abs() <= within_ms, "{truth_ms}: {text}");
        assert!((hfov - hfov_deg).abs() <= within_deg, "{hfov_deg}: {text}");
        assert!(within_ms < 0.1 * 1e3 / 30.0 && within_deg < 3.0, "{text}");
        assert!(
            (readout_ms - truth_ms).abs() < 0.02 * 1e3 / 30.0 && (hfov - hfov_deg).abs() < 1.0,
            "{truth_ms} {hfov_deg}: {text}"
        );
        assert!(text.contains(if readout_part < 0.0 { "bottom to top" } else { "top to bottom" }), "{text}");
    }
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
    assert!(errors.contains("too little motion") && errors.contains("readout time stays uncertain"), "{errors}");
    assert!(!text.contains("readout_ms") && !text.contains("hfov_deg"), "{text}");
}

#[test]
fn few_frames_and_no_frames_are_no_answer_either() {
    let clip = film("few", &small(0.6, 60.0));
    let output = calibrate(&clip.0, &["--frames", "4"]);
    assert_eq!(output.status.code(), Some(75));
    assert!(String::from_utf8_lossy(&output.stderr).contains("4 frames are too few"));
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
