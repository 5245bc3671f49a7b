//! The program as people use it: arguments in, files and exit codes out.

use gimbald::device::recording::RecordingWriter;
use gimbald::device::{Lent, RawFrame, StreamFormat, replay};
use gimbald::frame::Stamp;
use gimbald::image::PixelFormat;
use std::fs;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

/// 24 frames of 400x300 MJPEG.
const CAR: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/fixtures/car-mjpeg-400x300.gbr");
/// Bytes of a 4:2:0 frame of that size.
const FRAME: usize = 400 * 300 * 3 / 2;

/// A directory of its own for a test, gone afterwards.
struct Scratch(PathBuf);

impl Scratch {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("gimbald-cli-{}-{name}", std::process::id()));
        fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    fn file(&self, name: &str) -> String {
        self.0.join(name).to_str().unwrap().to_owned()
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

fn command(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_gimbald"));
    command.args(arguments).stdin(Stdio::null());
    command
}

fn gimbald(arguments: &[&str]) -> Output {
    command(arguments).output().unwrap()
}

/// Runs what must go well, silently, and gives back its standard output.
#[track_caller]
fn good(arguments: &[&str]) -> Vec<u8> {
    let output = gimbald(arguments);
    let errors = String::from_utf8_lossy(&output.stderr);
    assert_eq!((output.status.code(), errors.as_ref()), (Some(0), ""), "{arguments:?}");
    output.stdout
}

/// Runs what must fail with `code`, in one message that says each of `words`.
#[track_caller]
fn bad(code: i32, words: &[&str], arguments: &[&str]) {
    let output = gimbald(arguments);
    let errors = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(code), "{arguments:?}: {errors}");
    assert!(!errors.contains("panicked"), "{errors}");
    assert!(words.iter().all(|word| errors.contains(word)), "{arguments:?}: {words:?} in {errors}");
}

/// Size and number of a 4:2:0 y4m stream's frames; panics where it is not whole.
fn y4m(bytes: &[u8]) -> (usize, usize, usize) {
    let end = bytes.iter().position(|byte| *byte == b'\n').unwrap();
    let head = std::str::from_utf8(&bytes[..end]).unwrap();
    assert!(head.starts_with("YUV4MPEG2 "), "{head}");
    let number = |mark: char| -> usize { head.split(' ').find_map(|word| word.strip_prefix(mark)).unwrap().parse().unwrap() };
    let (width, height) = (number('W'), number('H'));
    let (frames, rest) = bytes[end + 1..].as_chunks_of(6 + width * height + 2 * width.div_ceil(2) * height.div_ceil(2));
    assert!(rest.is_empty() && frames.iter().all(|frame| frame.starts_with(b"FRAME\n")), "{} bytes left", rest.len());
    (width, height, frames.len())
}

/// Slices of a length that is known only here.
trait ChunksOf {
    fn as_chunks_of(&self, length: usize) -> (Vec<&[u8]>, &[u8]);
}

impl ChunksOf for [u8] {
    fn as_chunks_of(&self, length: usize) -> (Vec<&[u8]>, &[u8]) {
        let chunks = self.chunks_exact(length);
        let rest = chunks.remainder();
        (chunks.collect(), rest)
    }
}

/// The stamps of a stream's frames.
fn stamps(path: &str) -> Vec<Stamp> {
    let mut source = replay::open(Path::new(path)).unwrap();
    let mut stamps = Vec::new();
    while let Lent::Frame(frame) = source.lend().unwrap() {
        stamps.push(frame.stamp);
    }
    stamps
}

#[test]
fn as_many_frames_come_out_as_go_in_of_the_same_size_in_order() {
    let scratch = Scratch::new("replay");
    let (video, recording) = (scratch.file("out.y4m"), scratch.file("out.gbr"));
    good(&["replay", CAR, "-o", &video]);
    assert_eq!(y4m(&fs::read(&video).unwrap()), (400, 300, 24));
    for parameters in ["time-t", "time-t+1"] {
        good(&["replay", CAR, "-o", &recording, "--set", &format!("shutter.parameters={parameters}")]);
        assert_eq!(stamps(&recording), stamps(CAR));
    }
}

#[test]
fn the_same_input_gives_the_same_bytes_from_a_file_and_through_pipes() {
    let scratch = Scratch::new("pipes");
    let (input, output) = (scratch.file("in.y4m"), scratch.file("out.y4m"));
    good(&["replay", CAR, "-o", &input]);
    good(&["replay", &input, "-o", &output]);
    let expected = fs::read(&output).unwrap();
    let piped = command(&["replay", "-", "-o", "-"]).stdin(fs::File::open(&input).unwrap()).output().unwrap();
    assert_eq!(piped.status.code(), Some(0), "{}", String::from_utf8_lossy(&piped.stderr));
    assert!(piped.stdout == expected, "{} and {} bytes", piped.stdout.len(), expected.len());
    assert!(expected != fs::read(&input).unwrap(), "something was done");
    let digest = good(&["replay", &input, "-o", "digest:"]);
    assert_eq!(digest, good(&["replay", &input, "-o", "digest:"]));
    assert_eq!(String::from_utf8(digest).unwrap().lines().count(), 25, "a line a frame and the total");
    good(&["replay", &input, "-o", "null:"]);
}

#[test]
fn trace_stats_and_report_can_be_read() {
    let scratch = Scratch::new("reports");
    let [trace, stats, report] = ["t.csv", "s.json", "r.html"].map(|name| scratch.file(name));
    good(&[
        "replay",
        CAR,
        "-o",
        "null:",
        "--trace",
        &trace,
        "--stats",
        &stats,
        "--report",
        &report,
        "--set",
        "crop.zoom=1.25",
        "--set",
        "shutter.model=cho2007",
    ]);

    let trace = fs::read_to_string(trace).unwrap();
    let rows: Vec<Vec<&str>> = trace.lines().map(|line| line.split(',').collect()).collect();
    let column = |name: &str| rows[0].iter().position(|head| *head == name).unwrap_or_else(|| panic!("no column {name}"));
    assert_eq!(rows.len(), 25);
    for row in &rows[1..] {
        assert_eq!(row.len(), rows[0].len());
        for name in ["time_s", "h1", "h9", "a", "c", "d", "U_a", "S_d", "inliers", "tracks", "confidence", "crop_use"] {
            let value: f64 = row[column(name)].parse().unwrap();
            assert!(value.is_finite(), "{name} = {value}");
        }
    }
    let time: f64 = rows[24][column("time_s")].parse().unwrap();
    assert!((time - 0.766_193).abs() < 1e-6, "{time}");
    assert_eq!(rows[1][column("outcome")], "passed through: first");
    assert!(rows[2..].iter().filter(|row| row[column("outcome")] == "stabilized").count() > 15, "{trace}");

    let stats: serde_json::Value = serde_json::from_str(&fs::read_to_string(stats).unwrap()).unwrap();
    assert_eq!((&stats["frames"]["in"], &stats["frames"]["out"]), (&24.into(), &24.into()));
    let named = |stage: &str, name: &str| stats["stages"][stage][name].as_f64().unwrap();
    for stage in ["unpack", "pyramid", "detect", "track", "fit", "warp"] {
        let (median, p99, max) = (named(stage, "median_ms"), named(stage, "p99_ms"), named(stage, "max_ms"));
        assert!(0.0 < median && median <= p99 && p99 <= max * 1.01 && named(stage, "count") >= 23.0, "{stage}: {stats}");
    }
    assert!(stats["total"]["median_ms"].as_f64().unwrap() > named("warp", "median_ms"));

    let page = fs::read_to_string(report).unwrap();
    assert!(page.contains("<figure id=\"player\"") && page.len() < 3_000_000, "{} bytes", page.len());
    // Base64 can spell anything.
    let clip = page.split_once("id=\"clip\">").and_then(|(_, rest)| rest.split_once("</script>")).unwrap().0.to_owned();
    let page = page.replace(&clip, "");
    let page: String = page.split("base64,").map(|part| part.split_once('"').map_or(part, |(_, rest)| rest)).collect();
    assert!(!page.replace("http-equiv", "").contains("http") && !page.contains("NaN"), "self-contained");
    for tag in ["figure", "svg", "table", "dl"] {
        let (opened, closed) = (page.matches(&format!("<{tag}")).count(), page.matches(&format!("</{tag}>")).count());
        assert!(opened > 0 && opened == closed, "{tag}: {opened} opened, {closed} closed");
    }
    assert!(page.matches("<img").count() >= 8 && page.contains("<code>crop.zoom</code></td><td>1.25</td><td>1.1"));
}

#[test]
fn side_by_side_is_twice_as_wide() {
    let scratch = Scratch::new("compare");
    let [output, beside] = ["o.y4m", "b.y4m"].map(|name| scratch.file(name));
    good(&["replay", CAR, "-o", &output, "--compare"]);
    assert_eq!(y4m(&fs::read(&output).unwrap()), (800, 300, 24));
    good(&["replay", CAR, "-o", &output, &format!("--compare={beside}")]);
    let bytes = fs::read(&output).unwrap();
    assert_eq!((y4m(&bytes), y4m(&fs::read(&beside).unwrap())), ((400, 300, 24), (800, 300, 24)));
    // The right half of the last frame's rows is the output's.
    let beside = fs::read(&beside).unwrap();
    let (whole, half) = (&beside[beside.len() - 2 * FRAME..], &bytes[bytes.len() - FRAME..]);
    assert!((0..300).all(|y| whole[y * 800 + 400..(y + 1) * 800] == half[y * 400..(y + 1) * 400]));
}

#[test]
fn what_cannot_be_done_is_said_with_its_exit_code() {
    let scratch = Scratch::new("wrong");
    let out = scratch.file("o.y4m");
    bad(64, &["Usage"], &[]);
    bad(64, &["stabilise"], &["stabilise"]);
    bad(64, &["--output"], &["replay", CAR]);
    bad(64, &["out.xyz", ".mp4", ".y4m", ".gbr"], &["replay", CAR, "-o", "out.xyz"]);
    bad(66, &["missing.y4m", "No such file"], &["replay", "missing.y4m", "-o", &out]);
    bad(66, &["src", "directory"], &["replay", "src", "-o", &out]);
    bad(64, &["two outputs"], &["replay", CAR, "-o", "-", "--compare=-"]);
    bad(73, &["nowhere/o.y4m", "cannot create"], &["replay", CAR, "-o", "nowhere/o.y4m"]);
    bad(73, &["nowhere/t.csv"], &["replay", CAR, "-o", &out, "--trace", "nowhere/t.csv"]);
    bad(74, &["/dev/full", "No space left"], &["replay", CAR, "-o", &out, "--trace", "/dev/full"]);
    let text = scratch.file("text.y4m");
    fs::write(&text, "once upon a time").unwrap();
    bad(65, &["text.y4m", "ffmpeg"], &["replay", &text, "-o", &out]);
    fs::write(&text, "").unwrap();
    bad(65, &["text.y4m", "empty"], &["replay", &text, "-o", &out]);
    bad(65, &["standard input"], &["replay", "-", "-o", &out]);
    bad(66, &["none.toml"], &["replay", CAR, "-o", &out, "--config", "none.toml"]);
    bad(69, &["/dev/video987"], &["record", "--device", "/dev/video987", "-o", &scratch.file("r.gbr")]);
    bad(64, &["unknown motion", "handheld"], &["record", "--device", "synthetic:tango", "-o", &scratch.file("r.gbr")]);
    bad(64, &["r.y4m", ".gbr"], &["record", "--device", "synthetic:", "-o", &scratch.file("r.y4m")]);
}

#[test]
fn every_fault_of_the_settings_is_named_at_once() {
    let scratch = Scratch::new("settings");
    let config = scratch.file("g.toml");
    fs::write(&config, "[smooth]\ncutoff = 1\n[crop]\nzoom = 9\n").unwrap();
    let words = [
        "3 errors",
        "g.toml:2",
        "smooth.cutoff_hz?",
        "g.toml:4",
        "crop.zoom = 9",
        "1 to 2, or \"auto\" (ratio)",
        "--set: fit.form",
    ];
    bad(78, &words, &["replay", CAR, "-o", "null:", "--config", &config, "--set", "fit.form=bent"]);
    bad(78, &words[1..5], &["check", &config]);
    fs::write(&config, "[crop]\nzoom = 1.3\n").unwrap();
    let answer = String::from_utf8(good(&["check", &config])).unwrap();
    assert!(answer.contains("valid; 1 of") && answer.contains("crop.zoom = 1.3  (default 1.1)"), "{answer}");
    let by_file = good(&["replay", CAR, "-o", "digest:", "--config", &config]);
    assert_eq!(by_file, good(&["replay", CAR, "-o", "digest:", "--set", "crop.zoom=1.3"]));
    assert_ne!(by_file, good(&["replay", CAR, "-o", "digest:"]), "the setting does something");
    let defaults = String::from_utf8(good(&["check", "--defaults"])).unwrap();
    assert!(defaults == include_str!("../config/gimbald.toml"), "gimbald check --defaults is not config/gimbald.toml");
}

#[test]
fn the_input_is_never_overwritten() {
    let scratch = Scratch::new("overwrite");
    let (input, link) = (scratch.file("in.gbr"), scratch.file("link.gbr"));
    fs::copy(CAR, &input).unwrap();
    std::os::unix::fs::symlink(&input, &link).unwrap();
    bad(64, &["is also the input"], &["replay", &input, "-o", &input]);
    bad(64, &["is also the input"], &["replay", &input, "-o", &link]);
    bad(64, &["is also the input"], &["replay", &input, "-o", "null:", "--trace", &link]);
    bad(64, &["two outputs"], &["replay", &input, "-o", "null:", "--trace", "x.txt", "--stats", "x.txt"]);
    assert_eq!(fs::read(&input).unwrap(), fs::read(CAR).unwrap());
}

#[test]
fn of_a_cut_recording_the_whole_frames_are_stabilized() {
    let scratch = Scratch::new("cut");
    let [input, output, stats] = ["in.gbr", "o.y4m", "s.json"].map(|name| scratch.file(name));
    let whole = fs::read(CAR).unwrap();
    fs::write(&input, &whole[..whole.len() / 2]).unwrap();
    bad(65, &["in.gbr", "truncated"], &["replay", &input, "-o", &output, "--stats", &stats]);
    let (width, height, frames) = y4m(&fs::read(&output).unwrap());
    assert!((width, height) == (400, 300) && (8..16).contains(&frames), "{frames} frames");
    let stats: serde_json::Value = serde_json::from_str(&fs::read_to_string(stats).unwrap()).unwrap();
    assert_eq!(stats["frames"]["out"], frames);
    bad(65, &["truncated"], &["check", &input]);
    let answer = String::from_utf8(good(&["check", CAR])).unwrap();
    assert!(answer.contains("24 frames, 400x300 MJPG") && answer.contains("29.9"), "{answer}");
}

/// Sequence numbers that jump up and down, by more than 64 bits can add up: no camera lost so many frames, and none is said to be missing.
#[test]
fn wild_sequence_numbers_are_not_missing_frames() {
    let scratch = Scratch::new("wild");
    let recording = scratch.file("wild.gbr");
    let format = StreamFormat::tight(2, 2, PixelFormat::Grey, (1, 30));
    let mut writer = RecordingWriter::create(Path::new(&recording), &format, "").unwrap();
    for (n, sequence) in [0, u64::MAX, 3, u64::MAX - 1].into_iter().enumerate() {
        let stamp = Stamp { time_ns: n as i64 * 33_000_000, sequence, ..Stamp::default() };
        writer.write_raw(&RawFrame { format, bytes: &[7; 4], stamp }).unwrap();
    }
    writer.finish().unwrap();
    let answer = String::from_utf8(good(&["check", &recording])).unwrap();
    assert!(answer.contains("3 frames out of sequence") && !answer.contains("missing"), "{answer}");
}

#[test]
fn a_reader_that_goes_away_ends_the_program_with_a_message() {
    let mut child = command(&["replay", CAR, "-o", "-"]).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut first = [0; 10];
    child.stdout.take().unwrap().read_exact(&mut first).unwrap();
    let output = child.wait_with_output().unwrap();
    let errors = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(74), "{errors}");
    assert!(errors.contains("standard output") && errors.contains("Broken pipe"), "{errors}");
}

#[test]
fn ctrl_c_leaves_whole_frames() {
    let scratch = Scratch::new("interrupt");
    let output = scratch.file("o.y4m");
    let mut child = command(&["replay", "-", "-o", &output]).stdin(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut stdin = child.stdin.take().unwrap();
    let feeder = std::thread::spawn(move || {
        let mut frame = b"FRAME\n".to_vec();
        frame.extend((0..64 * 48 * 3 / 2).map(|i| (i * 7 % 251) as u8));
        let begun = stdin.write_all(b"YUV4MPEG2 W64 H48 F30:1 C420jpeg\n");
        // Until the program is gone.
        while begun.is_ok() && stdin.write_all(&frame).is_ok() {}
    });
    let pid = rustix::process::Pid::from_child(&child);
    while fs::metadata(&output).map_or(0, |about| about.len()) < 100_000 {
        assert!(child.try_wait().unwrap().is_none(), "ended early");
        std::thread::sleep(std::time::Duration::from_millis(10));
    }
    rustix::process::kill_process(pid, rustix::process::Signal::INT).unwrap();
    let ended = child.wait_with_output().unwrap();
    feeder.join().unwrap();
    let errors = String::from_utf8_lossy(&ended.stderr);
    assert_eq!(ended.status.code(), Some(130), "{errors}");
    let (width, height, frames) = y4m(&fs::read(&output).unwrap());
    assert!((width, height) == (64, 48) && errors.contains(&format!("after {frames} frames")), "{errors}: {frames}");
}

#[test]
fn the_demo_leaves_its_files_and_measures_less_shake() {
    let scratch = Scratch::new("demo");
    let said = String::from_utf8(good(&["demo", "--dir", scratch.0.to_str().unwrap(), "--seconds", "1"])).unwrap();
    for name in ["input.y4m", "stabilized.y4m"] {
        assert_eq!(y4m(&fs::read(scratch.file(name)).unwrap()), (640, 480, 30), "{name}");
        assert!(said.contains(name), "{said}");
    }
    let video = fs::read(scratch.file("before-after.avi")).unwrap();
    assert!(said.contains("before-after.avi") && video.starts_with(b"RIFF") && video[8..].starts_with(b"AVI "), "{said}");
    let frames = video.windows(4).filter(|four| four == b"00dc").count();
    assert!(frames >= 30, "{frames} frames");
    let page = fs::read_to_string(scratch.file("report.html")).unwrap();
    assert!(page.contains("30 frames of 640x480") && page.contains("<figure id=\"player\"") && page.len() < 3_000_000);
    let measured: Vec<f64> = said
        .split("shake ")
        .skip(1)
        .flat_map(|rest| rest.split([' ', ',']).filter_map(|word| word.parse::<f64>().ok()).take(2).collect::<Vec<_>>())
        .collect();
    let [before, after, real_before, real_after] = measured[..] else { panic!("{said}") };
    assert!(before > 1.0 && after < 0.5 * before && real_before > 1.0 && real_after < 0.5 * real_before, "{said}");
    // The recording: as in fixtures/, shown six times in a row, with its licence.
    assert_eq!(fs::read(scratch.file("real-input.gbr")).unwrap(), fs::read(CAR).unwrap());
    assert_eq!(y4m(&fs::read(scratch.file("real-stabilized.y4m")).unwrap()), (400, 300, 24));
    let video = fs::read(scratch.file("real-before-after.avi")).unwrap();
    assert_eq!(video.windows(4).filter(|four| four == b"00dc").count(), 2 * 6 * 24, "each frame, and its entry in the index");
    assert!(fs::read_to_string(scratch.file("real-report.html")).unwrap().contains("24 frames of 400x300"));
    assert!(fs::read_to_string(scratch.file("real-LICENSE.txt")).unwrap().contains("Li Haipeng"));
}

#[test]
fn the_demo_takes_settings_and_measure_gives_its_numbers() {
    let scratch = Scratch::new("measure");
    let directory = scratch.0.to_str().unwrap();
    let off = ["demo", "--dir", directory, "--seconds", "1", "--set", "stabilize.enabled=false"];
    let said = String::from_utf8(good(&off)).unwrap();
    let numbers = |text: &str| -> Vec<f64> {
        let words = text.split("shake ").nth(1).unwrap().split([' ', ',']);
        words.filter_map(|word| word.parse().ok()).take(2).collect()
    };
    let demo = numbers(&said);
    assert!(demo[1] > 0.8 * demo[0], "nothing is stabilized: {said}");
    let clips = [scratch.file("input.y4m"), scratch.file("stabilized.y4m")];
    let json = good(&["measure", "--json", &clips[0], &clips[1]]);
    let measured: serde_json::Value = serde_json::from_slice(&json).unwrap();
    for (clip, shake) in measured["clips"].as_array().unwrap().iter().zip(&demo) {
        let measured = clip["shake_px"].as_f64().unwrap();
        assert!((measured - shake).abs() < 0.1 * shake && clip["slant_deg"].as_f64().is_some(), "{clip}, {said}");
        assert!((0.0..5.0).contains(&clip["bend_px"].as_f64().unwrap()), "{clip}");
    }
    assert!(String::from_utf8(good(&["measure", &clips[0]])).unwrap().contains("input.y4m: shake "));
    let one = scratch.file("one.gbr");
    let said = String::from_utf8(good(&["record", "-d", "synthetic:", "-o", &one, "--frames", "1"])).unwrap();
    assert!(said.contains(": 1 frame of 640x480"), "{said}");
    bad(75, &["one.gbr", "no motion"], &["measure", &one]);
}

#[test]
fn a_recording_is_made_checked_and_replayed() {
    let scratch = Scratch::new("record");
    let recording = scratch.file("r.gbr");
    let said = String::from_utf8(good(&["record", "--device", "synthetic:walk", "-o", &recording, "--frames", "7"])).unwrap();
    assert!(said.contains("7 frames of 640x480 YU12"), "{said}");
    assert_eq!(stamps(&recording).len(), 7);
    good(&["record", "-d", "synthetic:", "-o", &recording, "--seconds", "0.5"]);
    let answer = String::from_utf8(good(&["check", &recording])).unwrap();
    assert!(answer.contains("15 frames") && answer.contains("0.500 s"), "{answer}");
}

#[test]
fn help_names_every_command_and_exit_code() {
    let help = String::from_utf8(good(&["--help"])).unwrap();
    for word in ["replay", "record", "demo", "devices", "check", " 64 ", " 65 ", " 66 ", " 69 ", " 73 ", " 74 ", " 78 ", "130 "]
    {
        assert!(help.contains(word), "{word} in {help}");
    }
    assert!(String::from_utf8(good(&["--version"])).unwrap().starts_with("gimbald "));
    assert!(good(&["devices"]).len() > 20);
}

#[test]
fn an_unknown_instruction_set_is_refused_and_a_known_one_taken() {
    let run = |word: &str| command(&["check", "--keys"]).env("GIMBALD_SIMD", word).output().unwrap();
    let refused = run("avx9");
    let errors = String::from_utf8_lossy(&refused.stderr);
    assert_eq!(refused.status.code(), Some(64));
    let known = match std::env::consts::ARCH {
        "x86_64" => "scalar, avx2",
        "aarch64" => "scalar, neon",
        _ => "scalar",
    };
    assert!(errors.contains(&format!("GIMBALD_SIMD=avx9: expected one of {known}; or unset it")), "{errors}");
    // empty is as good as unset
    for word in known.split(", ").chain([""]) {
        let taken = run(word);
        assert!(taken.status.success(), "{word}: {}", String::from_utf8_lossy(&taken.stderr));
    }
}
