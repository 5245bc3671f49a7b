//! Clips that ffmpeg makes, and what ffmpeg says of those that gimbald made.

use std::fs;
use std::io::Write;
use std::path::PathBuf;
use std::process::{Command, Output, Stdio};

/// 24 frames of 400x300 MJPEG.
pub const CAR: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/fixtures/car-mjpeg-400x300.gbr");

/// Whether ffmpeg and ffprobe are there; `what` is skipped where not.
pub fn have_ffmpeg(what: &str) -> bool {
    let is = |name: &str| Command::new(name).arg("-version").stdout(Stdio::null()).stderr(Stdio::null()).status().is_ok();
    let both = is("ffmpeg") && is("ffprobe");
    if !both {
        // Past the test harness, which keeps what a test prints to itself unless it fails.
        let _ = writeln!(std::io::stderr(), "SKIPPED: {what}: ffmpeg and ffprobe are not installed");
    }
    both
}

/// A directory of its own for a test, gone afterwards.
pub struct Scratch(PathBuf);

impl Scratch {
    pub fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("gimbald-video-{}-{name}", std::process::id()));
        fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    /// `None`, aloud, where there is no ffmpeg.
    pub fn with_ffmpeg(name: &str) -> Option<Self> {
        have_ffmpeg(name).then(|| Self::new(name))
    }

    pub fn file(&self, name: &str) -> String {
        self.0.join(name).to_str().unwrap().to_owned()
    }

    /// Makes a clip.
    pub fn clip(&self, clip: &Clip) -> String {
        let path = self.file(clip.name);
        let pictures = format!("testsrc2=size={}:rate=30,format={}", clip.size, clip.pixels);
        let chain = if clip.filter.is_empty() { "null" } else { clip.filter };
        let frames = clip.frames.to_string();
        let seconds = format!("{:.3}", f64::from(clip.frames) / 30.0 + 0.2);
        said(&[
            "ffmpeg",
            "-v",
            "error",
            "-y",
            "-f",
            "lavfi",
            "-i",
            &pictures,
            "-f",
            "lavfi",
            "-t",
            &seconds,
            "-i",
            "sine=frequency=440",
            "-vf",
            chain,
            "-vsync",
            "passthrough",
            "-enc_time_base",
            "1/1000",
            "-frames:v",
            &frames,
            "-c:v",
            clip.codec,
            "-q:v",
            "2",
            "-c:a",
            clip.sound,
            "-strict",
            "-2",
            &path,
        ]);
        path
    }

    /// The same clip with the sign that it is to be shown turned.
    pub fn turned(&self, clip: &str, degrees: u32) -> String {
        let path = self.file("turned.mp4");
        let angle = degrees.to_string();
        // Before version 6 as metadata, since then as an option of the input.
        let new = Command::new("ffmpeg")
            .args(["-v", "error", "-y", "-display_rotation:v:0", &angle, "-i", clip, "-c", "copy", &path])
            .stderr(Stdio::null())
            .status()
            .unwrap();
        if !new.success() {
            said(&[
                "ffmpeg",
                "-v",
                "error",
                "-y",
                "-i",
                clip,
                "-c",
                "copy",
                "-metadata:s:v:0",
                &format!("rotate={angle}"),
                &path,
            ]);
        }
        path
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

/// What a clip is made of.
pub struct Clip {
    pub name: &'static str,
    pub codec: &'static str,
    pub sound: &'static str,
    pub pixels: &'static str,
    pub size: &'static str,
    pub frames: u32,
    /// Of the pictures, as `setpts=...`.
    pub filter: &'static str,
}

impl Default for Clip {
    fn default() -> Self {
        Self { name: "clip.mp4", codec: "libx264", sound: "aac", pixels: "yuv420p", size: "320x240", frames: 60, filter: "" }
    }
}

/// Runs another program, which must succeed, and gives back what it prints.
#[track_caller]
pub fn said(words: &[&str]) -> String {
    let output = Command::new(words[0]).args(&words[1..]).stdin(Stdio::null()).output().unwrap();
    assert!(output.status.success(), "{words:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8_lossy(&output.stdout).into_owned()
}

/// When each picture of a file is to be shown, seconds.
#[track_caller]
pub fn times(path: &str) -> Vec<f64> {
    let text =
        said(&["ffprobe", "-v", "error", "-select_streams", "v:0", "-show_entries", "frame=pts_time", "-of", "csv=p=0", path]);
    let times = text.lines().map(|line| line.trim_end_matches(',')).filter(|line| !line.is_empty());
    times.map(|time| time.parse().unwrap()).collect()
}

/// How alike the pictures of two files are, frame by frame (dB).
#[track_caller]
pub fn psnr(one: &str, other: &str) -> f64 {
    let chain = "[0:v]settb=1/30,setpts=N,format=yuv420p[a];[1:v]settb=1/30,setpts=N,format=yuv420p[c];[c][a]scale2ref[b][d];[d][b]psnr";
    let output = Command::new("ffmpeg")
        .args(["-hide_banner", "-nostdin", "-i", one, "-i", other, "-filter_complex", chain, "-f", "null", "-"])
        .output()
        .unwrap();
    let text = String::from_utf8_lossy(&output.stderr);
    let found = text.rsplit("average:").next().and_then(|rest| rest.split_whitespace().next()?.parse().ok());
    found.unwrap_or_else(|| if text.contains("average:inf") { 100.0 } else { panic!("{text}") })
}

pub fn command(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_gimbald"));
    command.args(arguments).stdin(Stdio::null());
    command
}

pub fn run(arguments: &[&str]) -> Output {
    command(arguments).output().unwrap()
}

/// Runs what must go well, silently, and gives back its standard output.
#[track_caller]
pub fn good(arguments: &[&str]) -> Vec<u8> {
    let output = run(arguments);
    let errors = String::from_utf8_lossy(&output.stderr);
    assert_eq!((output.status.code(), errors.as_ref()), (Some(0), ""), "{arguments:?}");
    output.stdout
}

/// Judges what must have failed with `code`, in one message that says each of `words`.
#[track_caller]
pub fn failed(code: i32, words: &[&str], output: &Output) {
    let errors = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(code), "{errors}");
    assert!(!errors.contains("panicked"), "{errors}");
    assert!(words.iter().all(|word| errors.contains(word)), "{words:?} in {errors}");
}

/// Runs what must fail so.
#[track_caller]
pub fn bad(code: i32, words: &[&str], arguments: &[&str]) {
    failed(code, words, &run(arguments));
}
