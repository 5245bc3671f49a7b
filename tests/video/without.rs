//! A machine without ffmpeg: what gimbald writes itself, and what it says.

use std::fs;
use std::process::Output;

use super::files::{CAR, Clip, Scratch, command, failed, have_ffmpeg, psnr, times};

/// Runs gimbald where no other program is found.
fn alone(arguments: &[&str]) -> Output {
    command(arguments).env("PATH", "/nonexistent").output().unwrap()
}

#[test]
fn it_is_said_what_is_missing() {
    let scratch = Scratch::new("missing");
    let clip = scratch.file("clip.mp4");
    fs::write(&clip, b"\0\0\0\x20ftypisom....").unwrap();
    let words = ["clip.mp4", "ffmpeg", "not installed", "apt install ffmpeg"];
    failed(69, &words, &alone(&["replay", &clip, "-o", "null:"]));
    for name in ["o.mp4", "o.mov", "o.mkv", "o.webm"] {
        let output = scratch.file(name);
        failed(69, &[name, "not installed", "apt install ffmpeg"], &alone(&["replay", CAR, "-o", &output]));
        assert!(!fs::exists(&output).unwrap(), "nothing is left behind");
    }
    let output = scratch.file("o.avi");
    failed(69, &["o.avi", "not installed"], &alone(&["replay", CAR, "-o", &output, "--codec", "mpeg4"]));
}

#[test]
fn an_avi_file_is_written_all_the_same() {
    let scratch = Scratch::new("own");
    let [video, beside, plain] = ["o.avi", "b.avi", "o.y4m"].map(|name| scratch.file(name));
    let ran = alone(&["replay", CAR, "-o", &video, &format!("--compare={beside}")]);
    assert!(ran.status.success() && ran.stderr.is_empty(), "{}", String::from_utf8_lossy(&ran.stderr));
    let bytes = fs::read(&video).unwrap();
    assert_eq!((&bytes[..4], &bytes[8..12]), (&b"RIFF"[..], &b"AVI "[..]));
    // What other programs make of it.
    if !have_ffmpeg("the AVI file as ffmpeg reads it") {
        return;
    }
    assert!(alone(&["replay", CAR, "-o", &plain]).status.success());
    assert_eq!((times(&video).len(), times(&beside).len()), (24, 24));
    let quality = psnr(&video, &plain);
    assert!(quality > 35.0, "{quality} dB");
}

/// AVI has one rate: a frame that is late leaves the one before for as long.
#[test]
fn late_frames_leave_gaps_in_an_avi_file() {
    let Some(scratch) = Scratch::with_ffmpeg("gaps") else { return };
    let late = "setpts=(N+if(gt(N\\,9)\\,15))/30/TB";
    let clip = scratch.clip(&Clip { name: "late.mkv", codec: "ffv1", filter: late, frames: 20, ..Clip::default() });
    let [recording, video] = ["late.gbr", "late.avi"].map(|name| scratch.file(name));
    assert!(command(&["replay", &clip, "-o", &recording]).status().unwrap().success());
    let ran = alone(&["replay", &recording, "-o", &video]);
    assert!(ran.status.success(), "{}", String::from_utf8_lossy(&ran.stderr));
    let [before, after] = [times(&clip), times(&video)];
    assert_eq!(after.len(), before.len());
    assert!(after.iter().zip(&before).all(|(a, b)| (a - after[0] - (b - before[0])).abs() < 0.02), "{after:?}");
}
