//! `gimbald record`: writes a camera's raw frames to a file.

use std::path::{Path, PathBuf};
use std::time::Duration;

use super::check::frames_text;
use super::destination::RECORDING;
use super::interrupt::stop_on_signal;
use super::print::warn;
use super::progress::Progress;
use super::{Exit, Failure, SettingsArgs};
use crate::device::recording::RecordingWriter;
use crate::device::synthetic::{self, Synthetic};
use crate::device::v4l2::Capture;
use crate::device::{FrameSource, Lent, RawFrame};
use crate::frame::{FrameFlags, Stamp};
use crate::image::Picture;
use crate::pipeline::{Decoder, Reasons};
use crate::rt::clock::monotonic_ns;
use crate::rt::notifier::Notifier;
use crate::stage::timing::Timing;

/// A camera that gave nothing for this long will not.
pub(super) const MAX_SILENCE: Duration = Duration::from_secs(15);

/// A frame is decoded this often, by the frames' own clock (nanoseconds).
const TRY_EVERY_NS: i64 = 1_000_000_000;

/// Arguments of `record`.
#[derive(Clone, Debug, clap::Args)]
pub struct Args {
    /// Camera: path, number or part of its name; overrides camera.device. "synthetic:" or "synthetic:MOTION" generates frames
    #[arg(short, long, value_name = "D")]
    device: Option<String>,
    /// Recording to write (.gbr)
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    /// Stop after N frames; without a limit, stop with Ctrl-C
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    frames: Option<u64>,
    /// Stop after S seconds
    #[arg(long, value_name = "S", value_parser = positive)]
    seconds: Option<f64>,
    /// Settings for opening the camera
    #[command(flatten)]
    settings: SettingsArgs,
}

/// A number of seconds above 0.
pub(super) fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(number) if number > 0.0 && number <= 1e6 => Ok(number),
        _ => Err("expected a number above 0, at most 1000000 (seconds)".into()),
    }
}

/// Runs the command.
///
/// # Errors
/// Where the camera cannot be opened or goes away, or the file cannot be written. What was recorded until then is whole.
pub fn run(args: &Args) -> Result<(), Failure> {
    let mut camera = args.settings.read()?.camera;
    if let Some(device) = &args.device {
        camera.device.clone_from(device);
    }
    if args.output.extension().is_none_or(|extension| extension != RECORDING) {
        let what = format!("{}: the name of a recording must end in .{RECORDING}", args.output.display());
        return Err(Failure::new(Exit::Usage, what));
    }
    let wake = Notifier::new().map_err(|error| Failure::new(Exit::Io, format!("cannot make an event descriptor: {error}")))?;
    let stop = stop_on_signal(Some(wake.clone()))?;
    let mut source: Box<dyn FrameSource> = match camera.device.strip_prefix("synthetic:") {
        Some(motion) => Box::new(synthetic(motion)?),
        None => Box::new(Capture::open(&camera.params(), wake)?),
    };
    let mut writer = RecordingWriter::create(&args.output, &source.format(), &camera.device)?;
    let progress = Progress::new("recording", args.frames);
    let (mut frames, mut last_came_ns) = (0u64, monotonic_ns());
    let mut length = Length::new(args.seconds, source.format().rate());
    let mut tried = Tried::default();
    let ended = loop {
        if stop.is_set() {
            break Ok(());
        }
        let frame = match source.lend() {
            Ok(Lent::Frame(frame)) => frame,
            Ok(Lent::End) => break Ok(()),
            Ok(Lent::Idle) if monotonic_ns() - last_came_ns > MAX_SILENCE.as_nanos() as i64 => {
                let what = format!(
                    "{}: the camera delivered no frames for {} s; unplug it and try again",
                    camera.device,
                    MAX_SILENCE.as_secs()
                );
                break Err(Failure::new(Exit::Unavailable, what));
            }
            Ok(Lent::Idle) => continue,
            Err(error) => break Err(error.into()),
        };
        last_came_ns = monotonic_ns();
        if length.is_reached(&frame.stamp) {
            break Ok(());
        }
        if let Err(error) = writer.write_raw(&frame) {
            break Err(error.into());
        }
        tried.look(&frame);
        frames += 1;
        progress.step();
        if args.frames == Some(frames) {
            break Ok(());
        }
    };
    progress.finish();
    ended.and(writer.finish().map_err(Failure::from))?;
    tell(&args.output, source.as_ref(), frames);
    tried.tell(&args.output);
    Ok(())
}

/// How much is to be recorded, by the frames' own time as `replay` judges it: a recording of 5 seconds plays for 5 seconds, whatever
/// single stamps say.
struct Length {
    seconds: Option<f64>,
    timing: Timing,
}

impl Length {
    /// `rate`: frames a second, as the source says; 0 where it does not.
    fn new(seconds: Option<f64>, rate: f64) -> Self {
        Self { seconds, timing: Timing::new(if rate > 0.0 { 1.0 / rate } else { 1.0 / 30.0 }) }
    }

    /// Whether as much was recorded before the next frame, which is stamped `stamp`.
    fn is_reached(&mut self, stamp: &Stamp) -> bool {
        let passed_ns = self.timing.judge(stamp).time_ns;
        self.seconds.is_some_and(|seconds| passed_ns as f64 / 1e9 >= seconds)
    }
}

/// Decodes a few of the recorded frames, to warn early of a recording that cannot be shown. Not all: on a slow machine that would cost
/// frames.
#[derive(Default)]
struct Tried {
    decoder: Decoder,
    picture: Picture,
    next_ns: Option<i64>,
    frames: u64,
    unusable: Reasons,
}

impl Tried {
    /// Decodes about one frame per second; those without bytes or marked as damaged, which cost nothing, always.
    fn look(&mut self, frame: &RawFrame<'_>) {
        let now_ns = frame.stamp.time_ns;
        let is_free = frame.bytes.is_empty() || frame.stamp.flags.contains(FrameFlags::ERROR);
        // A clock that runs back begins again.
        if !is_free && self.next_ns.is_some_and(|next_ns| (next_ns - TRY_EVERY_NS..next_ns).contains(&now_ns)) {
            return;
        }
        if !is_free {
            self.next_ns = Some(now_ns.saturating_add(TRY_EVERY_NS));
        }
        self.frames += 1;
        if let Err(why) = self.decoder.decode(frame, &mut self.picture) {
            self.unusable.add(&why);
        }
    }

    fn tell(&self, path: &Path) {
        if let Some(why) = self.unusable.in_words(self.frames) {
            let path = path.display();
            warn(&format!("{path}: of the frames that were checked, {why}; `gimbald check {path}` checks all"));
        }
    }
}

/// A camera of arithmetic, endless.
pub(super) fn synthetic(motion: &str) -> Result<Synthetic, Failure> {
    let usage = |what: String| Failure::new(Exit::Usage, format!("synthetic:{motion}: {what}"));
    let motion = if motion.is_empty() { synthetic::Motion::default() } else { motion.parse().map_err(usage)? };
    Synthetic::new(&synthetic::Params { motion, frames: 0, ..synthetic::Params::default() }).map_err(usage)
}

/// Prints what was recorded.
fn tell(path: &Path, source: &dyn FrameSource, frames: u64) {
    let format = source.format();
    println!("{}: {} of {}x{} {}", path.display(), frames_text(frames), format.width, format.height, format.pixel);
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Frames at 30 a second that are recorded with `--seconds 2`; the one of number n is stamped `off_ns(n)` later than it was taken.
    fn recorded(off_ns: impl Fn(u64) -> i64) -> u64 {
        let mut length = Length::new(Some(2.0), 30.0);
        let stamp = |sequence: u64| {
            let time_ns = 5_000_000_000 + sequence as i64 * 33_333_334 + off_ns(sequence);
            Stamp { time_ns, sequence, ..Stamp::default() }
        };
        (0..1000).find(|&n| length.is_reached(&stamp(n))).expect("it ends")
    }

    #[test]
    fn so_many_seconds_are_recorded() {
        assert_eq!(recorded(|_| 0), 60);
    }

    #[test]
    fn single_stamps_of_another_clock_change_the_length_by_a_second_at_most() {
        for off_ns in [9_000_000_000, -9_000_000_000, 3_600_000_000_000] {
            let frames = recorded(|n| if n == 7 { off_ns } else { 0 });
            assert!((30..=61).contains(&frames), "{off_ns}: {frames}");
        }
    }

    #[test]
    fn a_clock_that_was_set_or_stands_still_changes_little() {
        for (frames, what) in [
            (recorded(|n| if n > 20 { 7_200_000_000_000 } else { 0 }), "two hours on"),
            (recorded(|n| if n > 20 { -7_200_000_000_000 } else { 0 }), "two hours back"),
            (recorded(|n| n as i64 * -33_333_334), "each frame has the same time"),
        ] {
            assert!((30..=90).contains(&frames), "{what}: {frames}");
        }
    }
}
