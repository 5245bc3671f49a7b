//! `gimbald check`: validates a configuration file or a recording, and describes it.

use std::fmt::Write as _;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use super::print::print;
use super::settings::text_of;
use super::{Exit, Failure};
use crate::config::{Settings, key_table, keys, shipped_file};
use crate::device::{DeviceError, FrameSource, Lent, replay};
use crate::frame::{FrameFlags, Stamp};
use crate::image::{Picture, PixelFormat};
use crate::pipeline::{Decoder, Reasons};

/// Arguments of `check`.
#[derive(Clone, Debug, clap::Args)]
pub struct Args {
    /// Configuration file, or recording (y4m, .gbr), which is decoded completely
    #[arg(value_name = "FILE", required_unless_present_any = ["defaults", "keys"])]
    file: Option<PathBuf>,
    /// Print a configuration file with every key, its unit, range and default
    #[arg(long, conflicts_with_all = ["file", "keys"])]
    defaults: bool,
    /// Print every key as a Markdown table
    #[arg(long, conflicts_with = "file")]
    keys: bool,
}

/// Runs the command.
///
/// # Errors
/// What is wrong with the file; every fault of a configuration, the first damage of a stream that ends it.
pub fn run(args: &Args) -> Result<(), Failure> {
    let answer = match &args.file {
        _ if args.defaults => shipped_file(),
        _ if args.keys => key_table(),
        None => return Err(Failure::new(Exit::Usage, "no FILE given")),
        Some(path) if is_stream(path)? => return stream(path),
        Some(path) => configuration(path)?,
    };
    print(&answer)
}

/// Whether the file is meant as a stream: by its beginning, or where that is damaged or of another kind, by its name. Standard
/// input is.
fn is_stream(path: &Path) -> Result<bool, Failure> {
    if path.as_os_str() == "-" {
        return Ok(true);
    }
    let mut begin = [0; 256];
    let mut file =
        File::open(path).map_err(|error| Failure::new(Exit::NoInput, format!("{}: cannot open: {error}", path.display())))?;
    let read = file
        .read(&mut begin)
        .map_err(|error| Failure::new(Exit::NoInput, format!("{}: cannot read: {error}", path.display())))?;
    let named = path.extension().is_some_and(|extension| extension != "toml" && extension != "conf");
    let binary = begin[..read].iter().any(|byte| *byte < 32 && !byte.is_ascii_whitespace());
    Ok(begin.starts_with(b"YUV4MPEG2") || binary || (named && read == 0))
}

/// Judges a configuration.
fn configuration(path: &Path) -> Result<String, Failure> {
    let text = text_of(path)?;
    let settings = Settings::read(Some((&path.to_string_lossy(), &text)), &[])?;
    let defaults = Settings::default();
    let changed: Vec<_> = settings.differing(&defaults).collect();
    let mut answer =
        format!("{}: valid; {} of {} keys differ from the default\n", path.display(), changed.len(), keys::KEYS.len());
    for key in changed {
        answer += &format!("  {} = {}  (default {})\n", key.name, key.value_text(&settings), key.value_text(&defaults));
    }
    for retired in &settings.retired {
        answer += &format!("  {retired}\n");
    }
    Ok(answer)
}

/// A number of frames, as text.
pub(super) fn frames_text(count: u64) -> String {
    format!("{count} {}", if count == 1 { "frame" } else { "frames" })
}

/// What a stream was found to hold.
#[derive(Debug, Default, PartialEq)]
struct Found {
    frames: u64,
    /// Frames that cannot be used.
    unusable: Reasons,
    /// Frames that are shorter than they should be, and can be used.
    truncated: u64,
    /// Frames that the camera counted but did not give.
    missing: u64,
    /// Frames whose number is not after that of the frame before, or impossibly far.
    misnumbered: u64,
    /// Frames whose time is not after that of the frame before.
    disordered: u64,
    /// Frames whose time is more than [`LONGEST_PAUSE_NS`] after that of the frame before.
    paused: u64,
    sizes: Vec<(u32, u32, PixelFormat)>,
    /// Time between frames, but for those that are `disordered` or `paused`.
    span_ns: i128,
    last: Stamp,
}

/// Frames further apart than this (nanoseconds) are no stream that goes on: the camera was away, or its clock is wrong.
const LONGEST_PAUSE_NS: i128 = 10_000_000_000;
/// Drivers count frames in 32 bits: no more can be missing at once.
const MAX_MISSING: u64 = 1 << 32;

/// Reads a stream through and says what it holds.
fn stream(path: &Path) -> Result<(), Failure> {
    let mut source = replay::open(path)?;
    let mut found = Found::default();
    let ended = read_through(source.as_mut(), &mut found);
    print(&summary(path, source.as_ref(), &found))?;
    ended?;
    let what = match found.unusable.in_words(found.frames) {
        Some(_) if found.unusable.total() == found.frames => "no usable frames, replay cannot show anything".to_owned(),
        Some(why) => format!("{why}; replay repeats the previous picture for each"),
        None if found.truncated > 0 => format!("{} truncated", frames_text(found.truncated)),
        None => return Ok(()),
    };
    Err(Failure::new(Exit::BadData, format!("{}: {what}", path.display())))
}

/// Reads every frame and decodes it, as replay would.
fn read_through(source: &mut dyn FrameSource, found: &mut Found) -> Result<(), DeviceError> {
    let (mut decoder, mut picture) = (Decoder::default(), Picture::default());
    loop {
        let frame = match source.lend()? {
            Lent::Frame(frame) => frame,
            Lent::Idle => continue,
            Lent::End => return Ok(()),
        };
        let (stamp, format) = (frame.stamp, frame.format);
        let size = (format.width, format.height, format.pixel);
        // A stream that changes size at every frame is told by its first few.
        if found.sizes.last() != Some(&size) && found.sizes.len() < 10 {
            found.sizes.push(size);
        }
        if found.frames > 0 {
            found.follow(stamp);
        }
        found.last = stamp;
        match decoder.decode(&frame, &mut picture) {
            Ok(()) => found.truncated += u64::from(stamp.flags.contains(FrameFlags::TRUNCATED) || decoder.is_cut()),
            Err(why) => found.unusable.add(&why),
        }
        found.frames += 1;
    }
}

impl Found {
    /// Takes in a frame that comes after another.
    fn follow(&mut self, stamp: Stamp) {
        match stamp.sequence.checked_sub(self.last.sequence) {
            Some(step @ 1..MAX_MISSING) => self.missing += step - 1,
            _ => self.misnumbered += 1,
        }
        match i128::from(stamp.time_ns) - i128::from(self.last.time_ns) {
            ..=0 => self.disordered += 1,
            step @ ..=LONGEST_PAUSE_NS => self.span_ns += step,
            _ => self.paused += 1,
        }
    }

    /// How long the stream is (seconds), and its frame rate, where its nominal rate is `rate` (0: unknown). A frame whose time says
    /// nothing lasts for the nominal interval, as the last one does.
    fn length(&self, rate: f64) -> (f64, f64) {
        let span_s = self.span_ns as f64 / 1e9;
        let timed = self.frames.saturating_sub(1 + self.disordered + self.paused);
        let untimed = self.frames - timed;
        let rest_s = if rate > 0.0 { untimed as f64 / rate } else { 0.0 };
        // where most times say nothing, the others are no measure of the rate
        (span_s + rest_s, if span_s > 0.0 && untimed <= timed + 1 { timed as f64 / span_s } else { rate })
    }
}

fn summary(path: &Path, source: &dyn FrameSource, found: &Found) -> String {
    let sizes: Vec<String> = found.sizes.iter().map(|(width, height, pixel)| format!("{width}x{height} {pixel}")).collect();
    let rate = source.format().rate();
    let (duration_s, mean) = found.length(rate);
    let mut text = format!(
        "{}: {}, {}, {duration_s:.3} s, {mean:.3} fps (nominal {:.3})\n",
        path.display(),
        frames_text(found.frames),
        if sizes.is_empty() { "no frames".to_owned() } else { sizes.join(", then ") },
        rate
    );
    if let Some(why) = found.unusable.in_words(found.frames) {
        text += &format!("  {why}\n");
    }
    for (count, what) in [
        (found.truncated, "truncated"),
        (found.missing, "missing (counted by the camera but not delivered)"),
        (found.misnumbered, "out of sequence"),
        (found.disordered, "with a time stamp that does not increase (counted as one nominal interval)"),
        (found.paused, "after a gap of more than 10 s (counted as one nominal interval)"),
    ] {
        if count > 0 {
            let _ = writeln!(text, "  {} {what}", frames_text(count));
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(stamps: &[(i64, u64)]) -> Found {
        let mut found = Found::default();
        for (i, &(time_ns, sequence)) in stamps.iter().enumerate() {
            let stamp = Stamp { time_ns, sequence, ..Stamp::default() };
            if i > 0 {
                found.follow(stamp);
            }
            (found.last, found.frames) = (stamp, found.frames + 1);
        }
        found
    }

    fn faults(found: &Found) -> [u64; 4] {
        [found.missing, found.misnumbered, found.disordered, found.paused]
    }

    #[test]
    fn the_length_is_that_of_the_times_that_follow_each_other() {
        const MS: i64 = 1_000_000;
        let even = found(&[(0, 5), (40 * MS, 6), (120 * MS, 8)]);
        assert_eq!((even.length(25.0), faults(&even)), ((0.16, 2.0 / 0.12), [1, 0, 0, 0]));
        // a first time of 131 years, then even ones; and a camera that was away for a minute
        let nonsense = found(&[(4_154_505_010_207_436_000, 0), (50_000 * MS, 1), (50_040 * MS, 2)]);
        assert_eq!((nonsense.length(25.0), faults(&nonsense)), ((0.12, 25.0), [0, 0, 1, 0]));
        let away = found(&[(0, 0), (40 * MS, 1), (60_000 * MS, 2), (60_040 * MS, 3)]);
        assert_eq!((away.length(25.0), faults(&away)), ((0.16, 25.0), [0, 0, 0, 1]));
        assert_eq!(away.length(0.0), (0.08, 25.0), "no nominal rate");
        assert_eq!(found(&[]).length(25.0), (0.0, 25.0));
        assert_eq!(found(&[(i64::MIN, 0)]).length(25.0), (0.04, 25.0));
    }

    #[test]
    fn the_wildest_stamps_overflow_nothing() {
        let wild = [(0, 0), (i64::MAX, u64::MAX), (i64::MIN, 0), (0, u64::MAX), (0, u64::MAX), (i64::MAX, 0)];
        let found = found(&wild);
        assert_eq!((found.length(30.0), faults(&found)), ((0.2, 30.0), [0, 5, 2, 3]));
    }
}
