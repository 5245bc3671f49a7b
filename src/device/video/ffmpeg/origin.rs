//! The streams of a video file, as `ffprobe` reports them.

use std::path::{Path, PathBuf};
use std::process::Stdio;

use serde_json::Value;

use super::program::{Words, is_installed, missing, open_file, program};
use crate::device::DeviceError;

/// How a picture is to be turned before it is shown, clockwise.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Turn {
    /// Not at all.
    #[default]
    None,
    /// By 90 degrees.
    Right,
    /// By 180 degrees.
    Over,
    /// By 270 degrees.
    Left,
}

/// A video file, and what of it the output takes over.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Origin {
    /// The file.
    pub path: PathBuf,
    /// Number of the stream with the pictures.
    pub(super) stream: u64,
    /// How its pixels are laid out, in ffmpeg's words.
    pub(super) pixels: String,
    /// Whether it holds two fields a frame.
    pub(super) interlaced: bool,
    /// Mean time between frames (seconds, numerator and denominator); (0, 0) where it is not said.
    pub(super) interval: (u32, u32),
    /// How many frames there are, about.
    pub(super) frames: Option<u64>,
    /// How its pictures are to be turned.
    pub turn: Turn,
    /// Matrix, primaries and transfer in ffmpeg's words; empty where they are not said.
    pub(super) colours: [String; 3],
    /// The codecs of its audio streams.
    pub(super) sound: Vec<String>,
}

impl Origin {
    /// Asks `ffprobe` about the file at `path`.
    ///
    /// # Errors
    /// [`DeviceError::Unsupported`] where the programs are not installed, [`DeviceError::Format`] where the file is no video.
    pub fn of(path: &Path) -> Result<Self, DeviceError> {
        if !is_installed() {
            return Err(missing(path, "reading it takes"));
        }
        let mut command = program("ffprobe");
        command.args(["-hide_banner", "-loglevel", "level+error", "-print_format", "json", "-show_streams", "-show_format"]);
        let output = command.args(open_file(path)).stdout(Stdio::piped()).output();
        let output = output.map_err(|error| DeviceError::io(path, "read with ffprobe", error))?;
        if !output.status.success() {
            let heard = Words::listen(std::io::Cursor::new(output.stderr), |_| false).map(|mut words| words.all());
            let why = heard.map_or_else(|error| error.to_string(), |heard| heard.in_words());
            return Err(DeviceError::format(path, format!("ffprobe cannot read it: {why}")));
        }
        let found: Option<Value> = serde_json::from_slice(&output.stdout).ok();
        found.and_then(|found| Self::read(path, &found)).ok_or_else(|| {
            DeviceError::format(path, "it contains no video; gimbald stabilizes the first video stream of a file")
        })
    }

    /// From what `ffprobe` prints; `None` where there is no stream of pictures.
    fn read(path: &Path, found: &Value) -> Option<Self> {
        let streams = found["streams"].as_array()?;
        let is = |stream: &Value, kind: &str| stream["codec_type"] == kind;
        // A song's cover is a stream of one picture.
        let video = streams.iter().find(|stream| is(stream, "video") && stream["disposition"]["attached_pic"] != 1)?;
        let word = |value: &Value| value.as_str().filter(|word| *word != "unknown").unwrap_or("").to_owned();
        let interval = ["avg_frame_rate", "r_frame_rate"].iter().find_map(|name| interval(video[name].as_str()?));
        let seconds = [&video["duration"], &found["format"]["duration"]]
            .into_iter()
            .find_map(|value| value.as_str()?.parse::<f64>().ok());
        let counted = video["nb_frames"].as_str().and_then(|count| count.parse().ok());
        let estimated = seconds.zip(interval).map(|(seconds, (numerator, denominator))| {
            (seconds * f64::from(denominator) / f64::from(numerator)).round().max(0.0) as u64
        });
        let pixels = word(&video["pix_fmt"]);
        Some(Self {
            path: path.into(),
            stream: video["index"].as_u64()?,
            interlaced: matches!(video["field_order"].as_str(), Some("tt" | "bb" | "tb" | "bt")),
            interval: interval.unwrap_or((0, 0)),
            frames: counted.or(estimated),
            turn: turn(video),
            colours: ["color_space", "color_primaries", "color_transfer"].map(|name| word(&video[name])),
            sound: streams.iter().filter(|stream| is(stream, "audio")).map(|stream| word(&stream["codec_name"])).collect(),
            pixels,
        })
    }

    /// Whether its samples are R, G and B.
    pub(super) fn is_rgb(&self) -> bool {
        ["rgb", "bgr", "gbr", "pal8", "argb", "abgr", "0rgb", "0bgr", "rgba", "bgra", "x2"]
            .iter()
            .any(|name| self.pixels.starts_with(name))
    }
}

/// The time between frames of a rate as "30000/1001".
fn interval(rate: &str) -> Option<(u32, u32)> {
    let (frames, seconds) = rate.split_once('/')?;
    let (frames, seconds) = (frames.parse().ok()?, seconds.parse().ok()?);
    // Some files name the clock of their times as their rate.
    (frames > 0 && seconds > 0 && frames / seconds <= 1000).then_some((seconds, frames))
}

/// How a stream is to be turned: its display matrix, which newer programs print as an angle against the clock.
fn turn(video: &Value) -> Turn {
    let matrices = video["side_data_list"].as_array().into_iter().flatten();
    let angle = matrices.filter_map(|data| data["rotation"].as_f64()).next();
    match angle.unwrap_or(0.0).round().rem_euclid(360.0) as u32 {
        270 => Turn::Right,
        180 => Turn::Over,
        90 => Turn::Left,
        _ => Turn::None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_ffprobe_prints_is_understood() {
        let found = serde_json::json!({
            "streams": [
                {"index": 0, "codec_type": "video", "disposition": {"attached_pic": 1}},
                {"index": 1, "codec_type": "audio", "codec_name": "aac"},
                {"index": 2, "codec_type": "video", "pix_fmt": "yuv420p10le", "avg_frame_rate": "30000/1001", "r_frame_rate": "90000/1",
                 "color_space": "bt709", "color_primaries": "unknown", "field_order": "tt", "duration": "10.01",
                 "side_data_list": [{"side_data_type": "Display Matrix", "rotation": -90}]},
            ],
            "format": {"duration": "12"},
        });
        let origin = Origin::read(Path::new("a.mp4"), &found).unwrap();
        assert_eq!((origin.stream, origin.interval, origin.frames), (2, (1001, 30000), Some(300)));
        assert_eq!((origin.turn, origin.interlaced, origin.is_rgb()), (Turn::Right, true, false));
        assert_eq!((origin.colours[0].as_str(), origin.colours[1].as_str(), origin.sound), ("bt709", "", vec!["aac".into()]));
        assert_eq!(Origin::read(Path::new("a.mp3"), &serde_json::json!({"streams": [{"codec_type": "audio"}]})), None);
        assert_eq!((interval("0/0"), interval("90000/1"), interval("x")), (None, None, None));
    }
}
