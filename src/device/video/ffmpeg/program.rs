//! Running the programs: whether they are installed, their options, their messages.

use std::ffi::OsString;
use std::io::{self, BufRead, BufReader, Read};
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::OnceLock;
use std::thread::JoinHandle;

use crate::device::DeviceError;
use crate::device::version::major_minor;

/// Kinds of file that are opened. Not among them are lists of other files (HLS, DASH, concat), which may name anything.
const FORMATS: &str = "mov,mp4,m4a,3gp,3g2,mj2,matroska,webm,avi,mpegts,mpeg,mpegvideo,h264,hevc,av1,obu,ivf,flv,asf,ogg,nut,mjpeg,\
                       gif,apng,dv,mxf,rm,yuv4mpegpipe";

/// Lines that are kept of what a program says.
const MAX_LINES: usize = 4;
/// Characters of a line that are kept.
const LONGEST_LINE: usize = 200;

/// A program that is not to read its standard input, and that Ctrl-C does not reach.
pub(super) fn program(name: &str) -> Command {
    let mut command = Command::new(name);
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped()).process_group(0);
    // FFREPORT would leave a file that the user did not ask for.
    command.env_remove("FFREPORT").env("AV_LOG_FORCE_NOCOLOR", "1");
    command
}

/// Whether both programs can be started.
pub fn is_installed() -> bool {
    version().is_some()
        && program("ffprobe").arg("-version").stderr(Stdio::null()).status().is_ok_and(|status| status.success())
}

/// The error where they cannot: `path` needs them.
pub(super) fn missing(path: &Path, what: &str) -> DeviceError {
    let what = format!("{what} the programs ffmpeg and ffprobe, which are not installed (sudo apt install ffmpeg)");
    DeviceError::Unsupported { path: path.into(), what }
}

/// The version's two first numbers, high where the build has none; `None` where there is no ffmpeg.
fn version() -> Option<(u32, u32)> {
    static VERSION: OnceLock<Option<(u32, u32)>> = OnceLock::new();
    *VERSION.get_or_init(|| {
        let output = program("ffmpeg").arg("-version").stdout(Stdio::piped()).output().ok().filter(|it| it.status.success())?;
        Some(version_in(&String::from_utf8_lossy(&output.stdout)))
    })
}

/// From "ffmpeg version 5.1.6-0+deb12u1 Copyright ..."; builds of a day, as "N-109542-g...", are newer than all numbers.
fn version_in(text: &str) -> (u32, u32) {
    let word = text.split_whitespace().nth(2).unwrap_or("").trim_start_matches('n');
    if word.starts_with(|c: char| c.is_ascii_digit()) { major_minor(word) } else { (u32::MAX, 0) }
}

/// The options that keep every frame at its time, none left out or repeated.
pub(super) fn keep_times() -> [&'static str; 2] {
    if version().is_some_and(|version| version < (5, 1)) { ["-vsync", "passthrough"] } else { ["-fps_mode", "passthrough"] }
}

/// The options that open `path` and nothing else.
pub(super) fn open_file(path: &Path) -> Vec<OsString> {
    let mut options: Vec<OsString> = ["-protocol_whitelist", "file", "-format_whitelist", FORMATS].map(OsString::from).into();
    options.extend([OsString::from("-i"), url(path)]);
    options
}

/// The file `path` as ffmpeg takes it, whatever characters it begins with.
pub(super) fn url(path: &Path) -> OsString {
    let mut url = OsString::from("file:");
    url.push(path);
    url
}

/// What a program says on its standard error, collected on a thread of its own.
#[derive(Debug)]
pub(super) struct Words(Option<JoinHandle<Heard>>);

/// What was said: how many errors, and the first and last of them.
#[derive(Clone, Debug, Default)]
pub(super) struct Heard {
    pub(super) errors: u64,
    lines: Vec<String>,
}

impl Words {
    /// Listens to `from` until it ends. `see` is shown each line first; the ones it takes (true) are no messages. The others count
    /// where they are errors, as `-loglevel level` marks them.
    pub(super) fn listen(
        from: impl Read + Send + 'static,
        mut see: impl FnMut(&str) -> bool + Send + 'static,
    ) -> io::Result<Self> {
        let listen = move || {
            let (mut heard, mut lines, mut bytes) = (Heard::default(), BufReader::new(from), Vec::new());
            while lines.read_until(b'\n', &mut bytes).is_ok_and(|read| read > 0) {
                let line = String::from_utf8_lossy(&bytes);
                if !see(&line) {
                    heard.add(&line);
                }
                bytes.clear();
            }
            heard
        };
        Ok(Self(Some(std::thread::Builder::new().name("ffmpeg's words".into()).spawn(listen)?)))
    }

    /// All that was said, once the program has ended.
    pub(super) fn all(&mut self) -> Heard {
        self.0.take().and_then(|thread| thread.join().ok()).unwrap_or_default()
    }
}

impl Heard {
    fn add(&mut self, line: &str) {
        let Some((_, said)) = ["[error] ", "[fatal] ", "[panic] "].iter().find_map(|mark| line.split_once(mark)) else {
            return;
        };
        self.errors += 1;
        if self.lines.len() == MAX_LINES {
            self.lines.remove(MAX_LINES / 2);
        }
        let plain = said.trim().chars().map(|c| if c.is_control() { ' ' } else { c });
        self.lines.push(plain.take(LONGEST_LINE).collect());
    }

    /// The errors in one line.
    pub(super) fn in_words(&self) -> String {
        if self.lines.is_empty() { "it gives no reason".into() } else { self.lines.join("; ") }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn versions_are_told_apart() {
        for (text, version) in [
            ("ffmpeg version 5.1.9-0+deb12u1 Copyright (c) 2000-2026 the FFmpeg developers", (5, 1)),
            ("ffmpeg version 4.4.2-0ubuntu0.22.04.1 Copyright", (4, 4)),
            ("ffmpeg version n7.1 Copyright", (7, 1)),
            ("ffmpeg version 8.0 Copyright", (8, 0)),
            ("ffmpeg version N-109542-gabc Copyright", (u32::MAX, 0)),
            ("", (u32::MAX, 0)),
        ] {
            assert_eq!(version_in(text), version, "{text}");
        }
    }

    #[test]
    fn of_many_errors_the_first_and_the_last_are_kept() {
        let text: String = (0..50).map(|n| format!("[h264 @ 0x55] [error] error {n}\n[info] nothing\n")).collect();
        let heard = Words::listen(io::Cursor::new(text), |_| false).unwrap().all();
        assert_eq!((heard.errors, heard.in_words().as_str()), (50, "error 0; error 1; error 48; error 49"));
        assert_eq!(Heard::default().in_words(), "it gives no reason");
    }
}
