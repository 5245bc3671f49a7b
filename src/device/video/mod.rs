//! Video files of other programs: read and written by way of ffmpeg, and AVI files of MJPEG that gimbald writes itself.

mod avi;
pub mod ffmpeg;
mod jpeg;
mod matroska;
mod mjpeg;

use std::path::Path;

pub(crate) use jpeg::Jpeg;
pub(crate) use mjpeg::MjpegSink;

/// A kind of video file that is written, told by the ending of its name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Container {
    /// `.mp4`, `.m4v`
    Mp4,
    /// `.mov`
    QuickTime,
    /// `.mkv`
    Matroska,
    /// `.webm`
    WebM,
    /// `.avi`
    Avi,
}

impl Container {
    /// The kind that a file of this name has; `None` where it is no video file's.
    pub fn of(path: &Path) -> Option<Self> {
        Some(match path.extension()?.to_str()?.to_ascii_lowercase().as_str() {
            "mp4" | "m4v" => Self::Mp4,
            "mov" => Self::QuickTime,
            "mkv" => Self::Matroska,
            "webm" => Self::WebM,
            "avi" => Self::Avi,
            _ => return None,
        })
    }
}

/// The endings of the files' names, for people.
pub const ENDINGS: &str = ".mp4, .mov, .mkv, .webm or .avi";
