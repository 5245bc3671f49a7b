//! Where output goes: opened early, never over the input.

use std::fs::{self, File};
use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use super::{Exit, Failure};
use crate::device::digest::DigestSink;
use crate::device::null::NullSink;
use crate::device::recording::RecordingSink;
use crate::device::video::ffmpeg::{self, FfmpegSink, Origin};
use crate::device::video::{Container, ENDINGS, MjpegSink};
use crate::device::y4m::Y4mSink;
use crate::device::{FrameSink, Output, StreamFormat, private};

/// Refuses a command line in which one file would be written that is also read, or written twice.
///
/// # Errors
/// The first such file, by name.
pub(super) fn all_differ(input: &Path, outputs: &[&Path]) -> Result<(), Failure> {
    for (index, output) in outputs.iter().enumerate() {
        if same(input, output) {
            let what = format!(
                "{}: is also the input and would be overwritten while it is read; choose another name",
                output.display()
            );
            return Err(Failure::new(Exit::Usage, what));
        }
        if outputs[..index].iter().any(|other| other == output || same(other, output)) {
            let what = format!("{}: is given for two outputs; choose another name for one of them", output.display());
            return Err(Failure::new(Exit::Usage, what));
        }
    }
    Ok(())
}

/// Whether both paths are one regular file, by whatever names, or one that is not yet there.
fn same(a: &Path, b: &Path) -> bool {
    match (fs::metadata(a), fs::metadata(b)) {
        (Ok(a), Ok(b)) => a.is_file() && (a.dev(), a.ino()) == (b.dev(), b.ino()),
        // "-" is standard input here and standard output there.
        (Err(_), Err(_)) => a == b && a.as_os_str() != "-",
        _ => false,
    }
}

/// The ending of a recording's name.
pub(super) const RECORDING: &str = "gbr";

/// How a video file is to be made.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Making<'a> {
    /// An encoder of ffmpeg's; `None`: the file's usual one.
    pub(super) codec: Option<&'a str>,
    /// The video file that the pictures are made from.
    pub(super) origin: Option<&'a Origin>,
}

/// Opens a place for pictures of frames of `format`, by its name.
///
/// # Errors
/// A name that does not say what to write, or a file that cannot be created.
pub(super) fn open_sink(path: &Path, format: &StreamFormat, making: Making<'_>) -> Result<Box<dyn FrameSink>, Failure> {
    if let Some(container) = Container::of(path) {
        let own = container == Container::Avi && making.codec.is_none() && !ffmpeg::is_installed();
        return Ok(match own {
            true => Box::new(MjpegSink::create(path, format)?),
            false => Box::new(FfmpegSink::create(path, container, format, making.codec, making.origin)?),
        });
    }
    let extension = path.extension().and_then(|extension| extension.to_str()).unwrap_or("").to_ascii_lowercase();
    Ok(match (path.to_str(), extension.as_str()) {
        (Some("-"), _) | (_, "y4m") => Box::new(Y4mSink::create(path, format)?),
        (Some("null:"), _) => Box::new(NullSink::new(format)),
        (Some("digest:"), _) => Box::new(DigestSink::new(format).with_lines(Output::create(Path::new("-"))?)),
        (_, RECORDING) => Box::new(RecordingSink::create(path, format)?),
        _ => {
            let what = format!(
                "{}: unknown output format; use a name that ends in {ENDINGS}, .y4m or .{RECORDING}, or - (y4m on standard output), \
                 digest: or null:",
                path.display()
            );
            return Err(Failure::new(Exit::Usage, what));
        }
    })
}

/// A file for a report, made before the work begins: a name that cannot be written is told at once, not after an hour.
#[derive(Debug)]
pub(super) struct ReportFile {
    /// Its name.
    pub(super) path: PathBuf,
    file: File,
}

impl ReportFile {
    /// Makes the file, empty, for its owner's eyes alone.
    ///
    /// # Errors
    /// Where the system refuses.
    pub(super) fn create(path: &Path) -> Result<Self, Failure> {
        let file = private::create(path).map_err(|error| Failure::creating(path, &error))?;
        Ok(Self { path: path.into(), file })
    }

    /// Writes the whole content.
    ///
    /// # Errors
    /// Where the system refuses.
    pub(super) fn fill(mut self, content: &str) -> Result<(), Failure> {
        io::Write::write_all(&mut self.file, content.as_bytes()).map_err(|error| Failure::writing(&self.path, &error))
    }
}
