//! Opens a recording or video file, whose kind is detected from its first bytes.

use super::recording::{self, RecordingSource};
use super::video::ffmpeg::{FfmpegSource, Origin};
use super::y4m::{self, Y4mSource};
use super::{DeviceError, FrameSource, Input};
use std::path::Path;

/// Opens a y4m file, a recording, or where `ffmpeg` is installed any video file; `-` is standard input (y4m or a recording). The
/// name's ending does not matter.
///
/// # Errors
/// [`DeviceError::Io`] where the file cannot be read; [`DeviceError::Unsupported`] where it takes ffmpeg, which is not installed;
/// [`DeviceError::Format`] where it is none of them, or its head is damaged.
pub fn open(path: &Path) -> Result<Box<dyn FrameSource>, DeviceError> {
    open_with_origin(path).map(|(source, _)| source)
}

/// As [`open`], with what a video file holds beside the pictures.
///
/// # Errors
/// As [`open`].
pub fn open_with_origin(path: &Path) -> Result<(Box<dyn FrameSource>, Option<Origin>), DeviceError> {
    let mut input = Input::open(path)?;
    let begin = input.peek()?;
    // A pipe may have given only the first few bytes yet.
    let is = |magic: &[u8]| !begin.is_empty() && (begin.starts_with(magic) || magic.starts_with(begin));
    if is(y4m::MAGIC) {
        return Ok((Box::new(Y4mSource::new(input)?), None));
    }
    if is(recording::MAGIC) {
        // Opened again by its path, where it has one, so that its frames can be counted.
        let source = if input.len().is_some() { RecordingSource::open(path)? } else { RecordingSource::new(input)? };
        return Ok((Box::new(source), None));
    }
    let (what, is_video) = looks_like(begin);
    if is_video && input.len().is_some() {
        let source = FfmpegSource::open(path)?;
        let origin = source.origin().clone();
        return Ok((Box::new(source), Some(origin)));
    }
    let name = if input.len().is_some() { path.display().to_string() } else { "IN".into() };
    Err(input.format_error(format!(
        "{what}; gimbald replays y4m, its own recordings (.gbr) and, from files and through ffmpeg, other video: \
         ffmpeg -i {name} -pix_fmt yuv420p -f yuv4mpegpipe OUT.y4m converts what it can read"
    )))
}

/// A few words on what a file is that begins so, and whether ffmpeg may read it.
fn looks_like(begin: &[u8]) -> (&'static str, bool) {
    let at = |offset: usize, word: &[u8]| begin.get(offset..).is_some_and(|rest| rest.starts_with(word));
    let boxes: [&[u8]; 5] = [b"ftyp", b"moov", b"mdat", b"wide", b"free"];
    match () {
        () if begin.is_empty() => ("it is empty", false),
        () if boxes.iter().any(|name| at(4, name)) => ("it is an MP4 or QuickTime file", true),
        () if at(0, b"\x1a\x45\xdf\xa3") => ("it is a Matroska or WebM file", true),
        () if at(0, b"RIFF") && at(8, b"AVI") => ("it is an AVI file", true),
        () if at(0, b"\x47") && at(188, b"\x47") => ("it is an MPEG transport stream", true),
        () if at(0, b"\0\0\x01\xba") || at(0, b"\0\0\x01\xb3") => ("it is an MPEG file", true),
        () if at(0, b"OggS") => ("it is an Ogg file", true),
        () if at(0, b"FLV") => ("it is a Flash video", true),
        () if at(0, b"\x30\x26\xb2\x75") => ("it is a Windows Media file", true),
        () if at(0, b"GIF8") => ("it is a GIF picture", true),
        () if at(0, b"\xff\xd8\xff") => ("it is a bare JPEG picture or MJPEG stream", true),
        () if at(0, b"\0\0\0\x01") || at(0, b"\0\0\x01") => ("it is a bare H.264 or H.265 stream", true),
        () if at(0, b"\x89GBR") || at(0, b"YUV4") => ("its first bytes are those of a damaged recording or y4m file", false),
        () => ("it is neither a y4m file nor a recording, nor another video file of a known kind", false),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn other_files_are_told_apart() {
        for (begin, word) in [
            (&b""[..], "empty"),
            (b"\0\0\0\x20ftypisom", "MP4"),
            (b"\x1a\x45\xdf\xa3\x01", "Matroska"),
            (b"RIFF\x10\0\0\0AVI LIST", "AVI"),
            (b"\xff\xd8\xff\xe0", "JPEG"),
            (b"\0\0\0\x01\x67", "H.264"),
            (b"\x89GBR\n\x1a\n", "damaged"),
            (b"hello", "neither"),
        ] {
            assert!(looks_like(begin).0.contains(word), "{begin:?}");
        }
    }

    #[test]
    fn what_cannot_be_opened_is_named() {
        let said = open(Path::new("no-such-file.y4m")).err().map(|error| error.to_string()).unwrap_or_default();
        assert!(said.starts_with("no-such-file.y4m: cannot open: "), "{said}");
        let said = open(Path::new("src")).err().map(|error| error.to_string()).unwrap_or_default();
        assert!(said.starts_with("src: cannot read: "), "{said}");
        let said = open(Path::new("Cargo.toml")).err().map(|error| error.to_string()).unwrap_or_default();
        assert!(said.contains("neither a y4m file nor a recording") && said.contains("ffmpeg -i Cargo.toml"), "{said}");
    }
}
