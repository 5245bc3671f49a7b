//! Writes a video file: ffmpeg encodes pictures from a pipe, and copies the sound of the input file.

use std::ffi::OsString;
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, Command, Stdio};

use super::program::{Words, is_installed, keep_times, missing, open_file, program, url};
use super::{Origin, Turn};
use crate::device::video::Container;
use crate::device::video::matroska::Matroska;
use crate::device::{DeviceError, FrameSink, StreamFormat, private};
use crate::frame::Stamp;
use crate::image::{Picture, PictureMut};
use crate::kernel::{Level, convert};

/// Time stamps of what is encoded: fine enough for every camera, coarse enough for MPEG-4 (at most 65535 to a second).
const CLOCK: &str = "1/60000";
/// Bytes that are collected for the pipe.
const BUFFER: usize = 1 << 16;

/// Encodes pictures with their times. ffmpeg is started with the first one; a file of no pictures stays empty.
#[derive(Debug)]
pub struct FfmpegSink {
    path: PathBuf,
    container: Container,
    codec: Option<String>,
    origin: Option<Origin>,
    format: StreamFormat,
    canvas: Picture,
    bytes: Vec<u8>,
    level: Level,
    encoder: Option<Encoder>,
    /// Time of the first picture, and that of the last one after it.
    first_ns: i64,
    last_ns: i64,
}

/// The program while it runs.
#[derive(Debug)]
struct Encoder {
    child: Child,
    /// `None` once all is written.
    pipe: Option<Matroska<BufWriter<ChildStdin>>>,
    words: Words,
}

impl FfmpegSink {
    /// Makes a file for pictures of frames of `format`; `container` by its name. `codec` is an encoder of ffmpeg's, by its name or its
    /// format's; `None` takes the container's usual one. The sound, the colours' meaning and the way the picture is turned are those of
    /// `origin`.
    ///
    /// # Errors
    /// [`DeviceError::Unsupported`] where ffmpeg is not installed or cannot encode so, [`DeviceError::Io`] where the file cannot be
    /// created.
    pub fn create(
        path: &Path,
        container: Container,
        format: &StreamFormat,
        codec: Option<&str>,
        origin: Option<&Origin>,
    ) -> Result<Self, DeviceError> {
        if !is_installed() {
            return Err(missing(path, "writing it takes"));
        }
        if let Some(codec) = codec {
            try_codec(path, codec)?;
        }
        // Made here, so that it is its owner's alone; ffmpeg writes into what is there.
        private::create(path).map_err(|error| DeviceError::io(path, "create", error))?;
        let given = format.planar();
        let bytes = vec![0; given.frame_bytes().unwrap_or(0)];
        Ok(Self {
            path: path.into(),
            container,
            codec: codec.map(str::to_owned),
            origin: origin.cloned(),
            format: given,
            canvas: given.picture(),
            bytes,
            level: Level::detected(),
            encoder: None,
            first_ns: 0,
            last_ns: -1,
        })
    }

    /// The command that encodes pictures of which the first was taken at `first_ns`.
    fn command(&self, first_ns: i64) -> Command {
        let mut command = program("ffmpeg");
        command.stdin(Stdio::piped());
        command.args(["-y", "-hide_banner", "-nostats", "-loglevel", "repeat+level+error", "-copyts", "-start_at_zero"]);
        command.args(["-itsoffset", &format!("{:.6}", first_ns as f64 / 1e9), "-f", "matroska", "-i", "pipe:0"]);
        if let Some(origin) = &self.origin {
            command.args(open_file(&origin.path)).args(["-map_metadata", "1"]);
        }
        command.args(["-map", "0:v:0", "-vf", &self.filters()]);
        command.args(keep_times()).args(self.encoding()).args(self.meaning()).args(self.sound());
        match self.container {
            Container::Mp4 => command.args(["-movflags", "+faststart", "-f", "mp4"]),
            Container::QuickTime => command.args(["-movflags", "+faststart", "-f", "mov"]),
            Container::Matroska => command.args(["-f", "matroska"]),
            Container::WebM => command.args(["-f", "webm"]),
            Container::Avi => command.args(["-f", "avi"]),
        };
        command.arg(url(&self.path));
        command
    }

    /// From the pictures to what is encoded: turned as they are to be shown, an odd last row or column left out (most encoders take
    /// none), with the shape of their samples.
    fn filters(&self) -> String {
        let turned = match self.origin.as_ref().map_or(Turn::None, |origin| origin.turn) {
            Turn::None => "",
            Turn::Right => ",transpose=clock",
            Turn::Left => ",transpose=cclock",
            Turn::Over => ",hflip,vflip",
        };
        let (mut across, mut down) = self.format.aspect;
        if matches!(turned, ",transpose=clock" | ",transpose=cclock") {
            std::mem::swap(&mut across, &mut down);
        }
        let shape = if across > 0 && down > 0 { format!(",setsar={across}/{down}") } else { String::new() };
        format!("crop=trunc(iw/2)*2:trunc(ih/2)*2:0:0{turned}{shape}")
    }

    /// The encoder and its options.
    fn encoding(&self) -> Vec<String> {
        let words = |text: &str| text.split_whitespace().map(str::to_owned).collect::<Vec<_>>();
        // AVI has one rate, that of the pictures.
        let mut options = if self.container == Container::Avi { Vec::new() } else { words(&format!("-enc_time_base {CLOCK}")) };
        options.extend(match (&self.codec, self.container) {
            (Some(codec), _) => vec!["-c:v".to_owned(), codec.clone()],
            // What every player shows: 4:2:0 of 8 bits.
            (None, Container::Mp4 | Container::QuickTime | Container::Matroska) => words("-pix_fmt yuv420p"),
            (None, Container::WebM) => {
                words("-c:v libvpx-vp9 -crf 31 -b:v 0 -deadline realtime -cpu-used 5 -row-mt 1 -pix_fmt yuv420p")
            }
            (None, Container::Avi) => words("-c:v mjpeg -q:v 3 -pix_fmt yuvj420p"),
        });
        options
    }

    /// What the samples mean, as the origin said it. Pictures that come from RGB or from no file are BT.601.
    fn meaning(&self) -> Vec<String> {
        let from_file = self.origin.as_ref().filter(|origin| !origin.is_rgb());
        let names =
            from_file.map_or_else(|| ["smpte170m".to_owned(), String::new(), String::new()], |origin| origin.colours.clone());
        let mut options = Vec::new();
        for (option, name) in ["-colorspace", "-color_primaries", "-color_trc"].into_iter().zip(names) {
            if !name.is_empty() {
                options.extend([option.to_owned(), name]);
            }
        }
        options
    }

    /// The sound: copied where the container takes it as it is, else encoded in the container's usual way.
    fn sound(&self) -> Vec<OsString> {
        let Some(origin) = &self.origin else { return Vec::new() };
        let mut options = vec![OsString::from("-map"), OsString::from("1:a?")];
        for (index, codec) in origin.sound.iter().enumerate() {
            let usual = match self.container {
                Container::Matroska => None,
                Container::Mp4 => Some((&["aac", "mp3", "ac3", "eac3", "opus", "alac"][..], "aac")),
                Container::QuickTime => {
                    Some((&["aac", "mp3", "ac3", "alac", "pcm_s16le", "pcm_s16be", "pcm_s24le"][..], "aac"))
                }
                Container::WebM => Some((&["opus", "vorbis"][..], "libopus")),
                Container::Avi => Some((&["mp3", "ac3", "pcm_s16le", "pcm_u8"][..], "pcm_s16le")),
            };
            let encoder = usual.filter(|(taken, _)| !taken.contains(&codec.as_str())).map_or("copy", |(_, usual)| usual);
            options.extend([OsString::from(format!("-c:a:{index}")), OsString::from(encoder)]);
        }
        options
    }

    fn start(&mut self, first_ns: i64) -> Result<(), DeviceError> {
        let cannot = |error| DeviceError::io(&self.path, "start ffmpeg for", error);
        let mut child = self.command(first_ns).spawn().map_err(cannot)?;
        let (Some(pipe), Some(said)) = (child.stdin.take(), child.stderr.take()) else {
            return Err(cannot(std::io::ErrorKind::BrokenPipe.into()));
        };
        let words = Words::listen(said, |_| false).map_err(cannot)?;
        let pipe = Matroska::new(BufWriter::with_capacity(BUFFER, pipe), &self.format);
        // Where it has ended already, it is told why below.
        self.encoder = Some(Encoder { child, pipe: pipe.ok(), words });
        self.first_ns = first_ns;
        Ok(())
    }

    /// Waits for ffmpeg's end.
    fn end(&mut self) -> Result<(), DeviceError> {
        let Some(mut encoder) = self.encoder.take() else { return Ok(()) };
        drop(encoder.pipe.take());
        let status = encoder.child.wait();
        let heard = encoder.words.all();
        match status {
            Ok(status) if status.success() => Ok(()),
            Ok(_) => Err(DeviceError::io(&self.path, "write", std::io::Error::other(format!("ffmpeg: {}", heard.in_words())))),
            Err(error) => Err(DeviceError::io(&self.path, "write", error)),
        }
    }
}

/// Has ffmpeg encode one black picture with `codec`.
///
/// # Errors
/// What it says where it cannot.
fn try_codec(path: &Path, codec: &str) -> Result<(), DeviceError> {
    let mut command = program("ffmpeg");
    command.args([
        "-hide_banner",
        "-nostdin",
        "-loglevel",
        "level+error",
        "-f",
        "lavfi",
        "-i",
        "color=size=320x240:duration=0.1",
    ]);
    let output = command.args(["-c:v", codec, "-f", "null", "-"]).output();
    let output = output.map_err(|error| DeviceError::io(path, "start ffmpeg for", error))?;
    if output.status.success() {
        return Ok(());
    }
    let heard = Words::listen(std::io::Cursor::new(output.stderr), |_| false).map(|mut words| words.all());
    let why = heard.map_or_else(|error| error.to_string(), |heard| heard.in_words());
    let what = format!("ffmpeg cannot encode with --codec {codec}: {why}; `ffmpeg -encoders` lists what it has");
    Err(DeviceError::Unsupported { path: path.into(), what })
}

impl FrameSink for FfmpegSink {
    fn format(&self) -> StreamFormat {
        self.format
    }

    fn canvas(&mut self) -> Result<PictureMut<'_>, DeviceError> {
        Ok(self.canvas.as_mut())
    }

    fn submit(&mut self, stamp: &Stamp) -> Result<(), DeviceError> {
        if self.encoder.is_none() {
            self.start(stamp.time_ns)?;
        }
        // Encoders take no frame that is not after the one before; a microsecond is the pipe's unit.
        let time_ns = stamp.time_ns.saturating_sub(self.first_ns).max(self.last_ns + 1000).max(0);
        self.last_ns = time_ns;
        convert::pack(self.level, self.canvas.as_ref(), self.format.pixel, self.format.stride, &mut self.bytes)
            .map_err(|error| DeviceError::format(&self.path, error.to_string()))?;
        let written =
            self.encoder.as_mut().and_then(|encoder| encoder.pipe.as_mut()).map(|pipe| pipe.add(&self.bytes, time_ns));
        match written {
            Some(Ok(())) => Ok(()),
            // The reason is in its own words.
            Some(Err(error)) => self.end().and(Err(DeviceError::io(&self.path, "write", error))),
            None => self.end().and(Err(DeviceError::io(&self.path, "write", std::io::ErrorKind::BrokenPipe.into()))),
        }
    }

    fn finish(&mut self) -> Result<(), DeviceError> {
        let flushed = match self.encoder.as_mut().and_then(|encoder| encoder.pipe.as_mut()) {
            Some(pipe) => pipe.finish(),
            None => Ok(()),
        };
        self.end().and(flushed.map_err(|error| DeviceError::io(&self.path, "write", error)))
    }
}

impl Drop for FfmpegSink {
    fn drop(&mut self) {
        if let Some(encoder) = &mut self.encoder {
            let _ = encoder.child.kill();
            let _ = encoder.child.wait();
        }
    }
}
