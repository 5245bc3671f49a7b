//! Reads a video file: ffmpeg decodes it into a pipe, and reports the time of each picture.

use std::path::Path;
use std::process::{Child, Stdio};

use crossbeam_channel::{Receiver, unbounded};

use super::Origin;
use super::program::{Words, keep_times, open_file, program};
use crate::device::y4m::Y4mSource;
use crate::device::{DeviceError, FrameSource, Input, Lent, RawFrame, StreamFormat};
use crate::frame::Stamp;

/// The mark of the lines with frames' times.
const MARK: &str = "gimbald";

/// Pictures of a video file, stamped with their times on the file's clock. Damage that ffmpeg decodes past is told by
/// [`FrameSource::complaint`].
#[derive(Debug)]
pub struct FfmpegSource {
    origin: Origin,
    decoder: Child,
    words: Words,
    times: Receiver<Option<i64>>,
    pictures: Y4mSource,
    format: StreamFormat,
    last_ns: Option<i64>,
    next: u64,
    ended: bool,
    complaint: Option<String>,
}

impl FfmpegSource {
    /// Opens the file at `path`.
    ///
    /// # Errors
    /// As [`Origin::of`]; [`DeviceError::Format`] where no picture can be decoded.
    pub fn open(path: &Path) -> Result<Self, DeviceError> {
        let origin = Origin::of(path)?;
        let cannot = |error| DeviceError::io(path, "start ffmpeg for", error);
        let mut command = program("ffmpeg");
        command.args([
            "-hide_banner",
            "-nostdin",
            "-nostats",
            "-loglevel",
            "repeat+level+info",
            "-copyts",
            "-start_at_zero",
            "-noautorotate",
        ]);
        command.args(open_file(path)).args(["-map", &format!("0:{}", origin.stream), "-vf", &filters(&origin)]);
        command.args(keep_times()).args(["-f", "yuv4mpegpipe", "-strict", "-1", "pipe:1"]).stdout(Stdio::piped());
        let mut decoder = command.spawn().map_err(cannot)?;
        let (Some(pictures), Some(said)) = (decoder.stdout.take(), decoder.stderr.take()) else {
            return Err(cannot(std::io::ErrorKind::BrokenPipe.into()));
        };
        let (tell, times) = unbounded();
        // A send fails only once the source is dropped, which ends the program.
        let see = move |line: &str| line.contains("[info]") && time_in(line).is_none_or(|time| tell.send(time).is_ok());
        let mut words = Words::listen(said, see).map_err(cannot)?;
        let opened = Y4mSource::new(Input::from_reader(path.into(), Box::new(pictures), None));
        let pictures = match opened {
            Ok(pictures) => pictures,
            Err(error) => {
                end(&mut decoder);
                let heard = words.all();
                let why = if heard.errors > 0 { heard.in_words() } else { error.to_string() };
                return Err(DeviceError::format(path, format!("ffmpeg cannot decode it: {why}")));
            }
        };
        let mut format = pictures.format();
        if origin.interval.0 > 0 {
            format.interval = origin.interval;
        }
        Ok(Self { origin, decoder, words, times, pictures, format, last_ns: None, next: 0, ended: false, complaint: None })
    }

    /// What the file holds beside the pictures.
    pub fn origin(&self) -> &Origin {
        &self.origin
    }

    /// The time of the next frame; where the file says none, an interval after the one before.
    fn next_time(&mut self) -> i64 {
        let told = self.times.recv().ok().flatten();
        let interval_ns = self.format.nominal_time_ns(1);
        let time_ns = told.unwrap_or_else(|| self.last_ns.map_or(0, |last| last.saturating_add(interval_ns)));
        self.last_ns = Some(time_ns);
        time_ns
    }

    /// The decoder has given its last picture.
    fn finish(&mut self, read: Result<(), DeviceError>) -> Result<(), DeviceError> {
        self.ended = true;
        if read.is_err() {
            end(&mut self.decoder);
        }
        let status = self.decoder.wait();
        let heard = self.words.all();
        let name = self.origin.path.clone();
        match status {
            Ok(status) if status.success() && read.is_ok() => {
                if heard.errors > 0 {
                    self.complaint = Some(format!("ffmpeg reports {} errors in it: {}", heard.errors, heard.in_words()));
                }
                Ok(())
            }
            Ok(_) if heard.errors > 0 => {
                let frames = self.next;
                Err(DeviceError::format(name, format!("ffmpeg ended after {frames} frames: {}", heard.in_words())))
            }
            Ok(status) => read.and_then(|()| Err(DeviceError::format(name, format!("ffmpeg ended with {status}")))),
            Err(error) => Err(DeviceError::io(name, "wait for ffmpeg's end at", error)),
        }
    }
}

/// From the file's pictures to planar ones of 8 bits and limited range, each told with its time.
fn filters(origin: &Origin) -> String {
    // The pixel formats of y4m; others become 4:2:0, as everything does in the end.
    let pixels = &origin.pixels;
    let planar = ["yuv422p", "yuv444p", "gray"].into_iter().find(|name| !origin.is_rgb() && pixels.starts_with(name));
    let planar = match planar {
        Some("yuv422p") | None if pixels.starts_with("yuvj422p") => "yuv422p",
        None if pixels.starts_with("yuvj444p") => "yuv444p",
        Some(planar) => planar,
        None => "yuv420p",
    };
    let fields = if origin.interlaced { "bwdif=mode=send_frame:deint=interlaced," } else { "" };
    // Behind the last filter frames are counted through, not timed: y4m has no times.
    format!(
        "{fields}settb=1/1000000000,metadata=mode=add:key={MARK}:value=1,metadata=mode=print:key={MARK},settb=1,setpts=N,\
         scale=out_range=tv,format={planar}"
    )
}

/// The time (nanoseconds) in a line as `[Parsed_metadata_2 @ 0x55] [info] frame:1 pts:33333333 pts_time:0.0333333`, where it is one.
/// `Some(None)`: the frame has no time.
fn time_in(line: &str) -> Option<Option<i64>> {
    let rest = line.strip_prefix("[Parsed_metadata_")?;
    let (_, rest) = rest.split_once("] [info] frame:")?;
    let pts = rest.split_whitespace().find_map(|word| word.strip_prefix("pts:"))?;
    Some(pts.parse().ok())
}

/// Ends a program that is no longer needed.
fn end(child: &mut Child) {
    let _ = child.kill();
    let _ = child.wait();
}

impl FrameSource for FfmpegSource {
    fn format(&self) -> StreamFormat {
        self.format
    }

    fn frames(&self) -> Option<u64> {
        self.origin.frames
    }

    fn lend(&mut self) -> Result<Lent<'_>, DeviceError> {
        if self.ended {
            return Ok(Lent::End);
        }
        // The first line of a frame comes before its bytes.
        let read = match self.pictures.read_frame() {
            Ok(true) => {
                let stamp = Stamp { time_ns: self.next_time(), sequence: self.next, ..Stamp::default() };
                self.next += 1;
                return Ok(Lent::Frame(RawFrame { format: self.format, bytes: self.pictures.bytes(), stamp }));
            }
            Ok(false) => Ok(()),
            Err(error) => Err(error),
        };
        self.finish(read).map(|()| Lent::End)
    }

    fn complaint(&self) -> Option<&str> {
        self.complaint.as_deref()
    }
}

impl Drop for FfmpegSource {
    fn drop(&mut self) {
        if !self.ended {
            end(&mut self.decoder);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_found_in_their_lines_alone() {
        let line = "[Parsed_metadata_2 @ 0x55902498cc80] [info] frame:1    pts:33333333 pts_time:0.0333333\n";
        assert_eq!(time_in(line), Some(Some(33_333_333)));
        assert_eq!(time_in(&line.replace("33333333", "NOPTS")), Some(None));
        assert_eq!(time_in("[info]   title : frame:1 pts:5"), None);
        assert_eq!(time_in("[Parsed_metadata_2 @ 0x55902498cc80] [info] gimbald=1"), None);
    }

    #[test]
    fn each_layout_becomes_one_that_is_read() {
        for (pixels, planar) in [
            ("yuv420p", "yuv420p"),
            ("yuvj420p", "yuv420p"),
            ("yuv420p10le", "yuv420p"),
            ("nv12", "yuv420p"),
            ("yuvj422p", "yuv422p"),
            ("yuv422p10le", "yuv422p"),
            ("yuvj444p", "yuv444p"),
            ("yuv444p", "yuv444p"),
            ("gray10le", "gray"),
            ("bgr24", "yuv420p"),
            ("gbrp", "yuv420p"),
        ] {
            let chain = filters(&Origin { pixels: pixels.into(), ..Origin::default() });
            assert!(chain.ends_with(&format!("format={planar}")), "{pixels}: {chain}");
        }
        assert!(filters(&Origin { interlaced: true, ..Origin::default() }).starts_with("bwdif"));
    }
}
