//! Video files in and out, by way of the real ffmpeg: pictures, times and sound as ffmpeg itself reads them.

mod files;
mod without;

use std::fs;
use std::os::unix::fs::PermissionsExt;

use files::{CAR, Clip, Scratch, bad, good, have_ffmpeg, psnr, run, said, times};

#[test]
fn pictures_times_and_sound_go_through() {
    let Some(scratch) = Scratch::with_ffmpeg("through") else { return };
    let clip = scratch.clip(&Clip::default());
    let [video, plain] = ["steady.mp4", "steady.y4m"].map(|name| scratch.file(name));
    good(&["replay", &clip, "-o", &video]);
    good(&["replay", &clip, "-o", &plain]);
    let (after, before) = (times(&video), times(&clip));
    assert!(after.len() == 60 && before.len() == 60);
    assert!(after.iter().zip(&before).all(|(a, b)| (a - b).abs() < 1e-4), "each picture at its time: {after:?}");
    let quality = psnr(&video, &plain);
    assert!(quality > 30.0, "the same pictures as without a codec, but for the codec's loss: {quality} dB");
    let sound = |path: &str| said(&["ffmpeg", "-v", "error", "-i", path, "-map", "0:a", "-c", "copy", "-f", "md5", "-"]);
    assert_eq!(sound(&video), sound(&clip), "the sound was copied");
    assert!(said(&["ffprobe", "-v", "error", "-show_streams", &video]).contains("codec_name=h264"));
    assert_eq!(fs::metadata(&video).unwrap().permissions().mode() & 0o777, 0o600);
}

/// A camera that slows down in low light, and a sound that begins before the pictures.
#[test]
fn variable_times_and_the_sounds_lead_are_kept() {
    let Some(scratch) = Scratch::with_ffmpeg("variable") else { return };
    let times_of = "settb=1/1000,setpts=(N/30+if(gt(N\\,20)\\,(N-20)/30)+0.004*mod(N\\,3)+0.5)/TB";
    let clip = scratch.clip(&Clip { name: "variable.mkv", filter: times_of, ..Clip::default() });
    let before = times(&clip);
    assert!(before[0] > 0.4 && before[40] - before[39] > 0.05 && before[1] - before[0] < 0.04, "{before:?}");
    for (name, unit) in [("o.mkv", 0.0011), ("o.mp4", 0.0011), ("o.mov", 0.0011), ("o.webm", 0.0011)] {
        let output = scratch.file(name);
        good(&["replay", &clip, "-o", &output]);
        let after = times(&output);
        assert_eq!(after.len(), before.len(), "{name}");
        let sound = |path: &str| {
            said(&[
                "ffprobe",
                "-v",
                "error",
                "-select_streams",
                "a",
                "-show_entries",
                "stream=start_time",
                "-of",
                "csv=p=0",
                path,
            ])
            .trim()
            .parse::<f64>()
            .unwrap()
        };
        // Against the sound, whose first packet some containers place a little earlier (priming).
        let shift = sound(&output) - sound(&clip);
        assert!(shift.abs() < 0.03, "{name}: {shift}");
        for (index, (a, b)) in after.iter().zip(&before).enumerate() {
            assert!((a - b - (after[0] - before[0])).abs() < unit, "{name}, frame {index}: {a} for {b}");
        }
        assert!((after[0] - before[0] - shift).abs() < 0.03, "{name}: {} for {}", after[0], before[0]);
    }
}

#[test]
fn every_kind_of_file_is_read_and_written() {
    let Some(scratch) = Scratch::with_ffmpeg("kinds") else { return };
    for (name, codec, sound) in [
        ("a.mov", "mjpeg", "pcm_s16le"),
        ("a.webm", "libvpx", "libopus"),
        ("a.avi", "mpeg4", "mp3"),
        ("a.mkv", "ffv1", "flac"),
        ("a.ts", "mpeg2video", "mp2"),
    ] {
        let clip = scratch.clip(&Clip { name, codec, sound, frames: 12, ..Clip::default() });
        let before = times(&clip).len();
        for output in ["o.mp4", "o.mov", "o.mkv", "o.webm", "o.avi"] {
            let output = scratch.file(output);
            good(&["replay", &clip, "-o", &output]);
            assert_eq!(times(&output).len(), before, "{name} to {output}");
            let streams = said(&["ffprobe", "-v", "error", "-show_streams", &output]);
            assert_eq!(streams.matches("codec_type=audio").count(), 1, "{name} to {output}: {streams}");
        }
        let counted = String::from_utf8(good(&["check", &clip])).unwrap();
        assert!(counted.contains(&format!("{before} frames, 320x240")), "{counted}");
    }
}

/// What a camera app's files have beside the usual: more bits, full range, RGB, an odd size, no colour.
#[test]
fn every_layout_of_samples_becomes_the_same_picture() {
    let Some(scratch) = Scratch::with_ffmpeg("layouts") else { return };
    for (name, pixels, size) in [
        ("ten.mkv", "yuv420p10le", "320x240"),
        ("full.mkv", "yuvj420p", "320x240"),
        ("wide.mkv", "yuv422p", "320x240"),
        ("most.mkv", "yuv444p", "320x240"),
        ("rgb.mkv", "bgr0", "320x240"),
        ("grey.mkv", "gray", "320x240"),
        ("odd.mkv", "yuv420p", "321x239"),
    ] {
        let codec = if pixels == "yuvj420p" { "mjpeg" } else { "ffv1" };
        let clip = scratch.clip(&Clip { name, codec, pixels, size, frames: 6, ..Clip::default() });
        let output = scratch.file("o.mp4");
        // Switched off and not enlarged, pictures are what they were.
        good(&["replay", &clip, "-o", &output, "--set", "stabilize.enabled=false", "--set", "crop.zoom=1"]);
        let quality = psnr(&output, &clip);
        assert!(quality > 28.0, "{name}: {quality} dB");
    }
}

#[test]
fn a_picture_that_is_shown_turned_is_turned() {
    let Some(scratch) = Scratch::with_ffmpeg("turned") else { return };
    let upright = scratch.clip(&Clip { frames: 6, ..Clip::default() });
    let turned = scratch.turned(&upright, 90);
    let output = scratch.file("o.mp4");
    good(&["replay", &turned, "-o", &output, "--set", "stabilize.enabled=false", "--set", "crop.zoom=1"]);
    let streams = said(&["ffprobe", "-v", "error", "-show_streams", &output]);
    assert!(streams.contains("width=240") && streams.contains("height=320") && !streams.contains("rotation="), "{streams}");
    // ffmpeg turns the one as it is to be shown; the other stands already.
    let quality = psnr(&output, &turned);
    assert!(quality > 28.0, "{quality} dB");
    let warned = run(&["replay", &turned, "-o", &scratch.file("o.y4m")]);
    assert!(warned.status.success() && String::from_utf8_lossy(&warned.stderr).contains("turned"), "{warned:?}");
}

#[test]
fn codecs_and_side_by_side() {
    let Some(scratch) = Scratch::with_ffmpeg("codecs") else { return };
    let [output, beside] = ["o.mkv", "b.mp4"].map(|name| scratch.file(name));
    good(&["replay", CAR, "-o", &output, "--codec", "mpeg4", &format!("--compare={beside}")]);
    let streams = |path: &str| said(&["ffprobe", "-v", "error", "-show_streams", path]);
    assert!(streams(&output).contains("codec_name=mpeg4"));
    assert!(streams(&beside).contains("width=800") && times(&beside).len() == 24);
    bad(69, &["o.mkv", "--codec dreams", "ffmpeg -encoders"], &["replay", CAR, "-o", &output, "--codec", "dreams"]);
    bad(64, &["--codec", ".mp4"], &["replay", CAR, "-o", "null:", "--codec", "mpeg4"]);
    // Input and output by other names for one file.
    let clip = scratch.clip(&Clip { frames: 6, ..Clip::default() });
    bad(64, &["is also the input"], &["replay", &clip, "-o", &clip]);
    assert_eq!(times(&clip).len(), 6);
}

#[test]
fn what_is_no_video_or_damaged_is_said() {
    let Some(scratch) = Scratch::with_ffmpeg("damaged") else { return };
    let clip = scratch.clip(&Clip::default());
    let whole = fs::read(&clip).unwrap();
    let [cut, holes, list, output] = ["cut.mp4", "holes.mp4", "list.mp4", "o.y4m"].map(|name| scratch.file(name));
    fs::write(&cut, &whole[..whole.len() / 2]).unwrap();
    bad(65, &["cut.mp4", "ffprobe cannot read it", "moov"], &["replay", &cut, "-o", &output]);
    // In the pictures' bytes, which stand before the index.
    let mut broken = whole.clone();
    broken[whole.len() / 3..whole.len() / 3 + 3000].fill(0x55);
    fs::write(&holes, broken).unwrap();
    let ran = run(&["replay", &holes, "-o", &output]);
    let errors = String::from_utf8_lossy(&ran.stderr);
    assert!(matches!(ran.status.code(), Some(0 | 65)) && errors.contains("holes.mp4") && errors.contains("ffmpeg"), "{errors}");
    // A list of other files is not followed, whatever its name.
    fs::write(&list, format!("ffconcat version 1.0\nfile {clip}\n")).unwrap();
    bad(65, &["list.mp4"], &["replay", &list, "-o", &output]);
    let silent = scratch.file("sound.mp4");
    said(&["ffmpeg", "-v", "error", "-i", &clip, "-map", "0:a", "-c", "copy", &silent]);
    bad(65, &["sound.mp4", "no video"], &["replay", &silent, "-o", &output]);
}

#[test]
fn a_disk_that_is_full_is_said() {
    if !have_ffmpeg("a full disk") {
        return;
    }
    let scratch = Scratch::new("full");
    let link = scratch.file("o.avi");
    std::os::unix::fs::symlink("/dev/full", &link).unwrap();
    bad(74, &["o.avi", "No space left"], &["replay", CAR, "-o", &link]);
}
