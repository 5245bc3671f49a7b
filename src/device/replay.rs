//! Anything recorded, told by what it begins with.

use super::recording::{self, RecordingSource};
use super::y4m::{self, Y4mSource};
use super::{DeviceError, FrameSource, Input};
use std::path::Path;

/// Opens a y4m file or a recording; `-` is standard input. The name's ending does not matter.
///
/// # Errors
/// [`DeviceError::Io`] where the file cannot be read; [`DeviceError::Format`] where it is neither, saying what it looks like and
/// how to convert it, or where its head is damaged.
pub fn open(path: &Path) -> Result<Box<dyn FrameSource>, DeviceError> {
    let mut input = Input::open(path)?;
    let begin = input.peek()?;
    // A pipe may have given only the first few bytes yet.
    let is = |magic: &[u8]| !begin.is_empty() && (begin.starts_with(magic) || magic.starts_with(begin));
    if is(y4m::MAGIC) {
        Ok(Box::new(Y4mSource::new(input)?))
    } else if is(recording::MAGIC) {
        // Opened anew by its path, where it has one, so that its frames can be counted.
        Ok(Box::new(if input.len().is_some() { RecordingSource::open(path)? } else { RecordingSource::new(input)? }))
    } else {
        let what = looks_like(begin);
        let name = if input.len().is_some() { path.display().to_string() } else { "IN".into() };
        Err(input.format_error(format!(
            "{what}; gimbald replays y4m and its own recordings (.gbr): \
             ffmpeg -i {name} -pix_fmt yuv420p -f yuv4mpegpipe OUT.y4m converts other video"
        )))
    }
}

/// A few words on what a file is that begins so.
fn looks_like(begin: &[u8]) -> &'static str {
    let at = |offset: usize, word: &[u8]| begin.get(offset..).is_some_and(|rest| rest.starts_with(word));
    if begin.is_empty() {
        "it is empty"
    } else if at(4, b"ftyp") {
        "it is an MP4 or QuickTime file"
    } else if at(0, b"\x1a\x45\xdf\xa3") {
        "it is a Matroska or WebM file"
    } else if at(0, b"RIFF") && at(8, b"AVI") {
        "it is an AVI file"
    } else if at(0, b"\xff\xd8\xff") {
        "it is a bare JPEG picture or MJPEG stream"
    } else if at(0, b"\x89GBR") || at(0, b"YUV4") {
        "its first bytes are those of a damaged recording or y4m file"
    } else {
        "it is neither a y4m file nor a recording"
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
            (b"\x89GBR\n\x1a\n", "damaged"),
            (b"hello", "neither"),
        ] {
            assert!(looks_like(begin).contains(word), "{begin:?}");
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
