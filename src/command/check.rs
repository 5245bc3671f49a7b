//! `gimbald check`: whether a configuration or a recorded stream is right, and what it holds.

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use super::say::say;
use super::settings::text_of;
use super::{Exit, Failure};
use crate::config::{Settings, key_table, keys, shipped_file};
use crate::device::{DeviceError, FrameSource, Lent, replay};
use crate::frame::FrameFlags;
use crate::image::{Picture, PixelFormat};
use crate::pipeline::{Decoder, Reasons};

/// Arguments of `check`.
#[derive(Clone, Debug, clap::Args)]
pub struct Args {
    /// A configuration file, or a recorded stream (y4m, .gbr), which is read to its end
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
    say(&answer)
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
        format!("{}: right; {} of {} keys differ from the default\n", path.display(), changed.len(), keys::KEYS.len());
    for key in changed {
        answer += &format!("  {} = {}  (default {})\n", key.name, key.shown(&settings), key.shown(&defaults));
    }
    for retired in &settings.retired {
        answer += &format!("  {retired}\n");
    }
    Ok(answer)
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
    /// Frames whose time is not after that of the frame before.
    disordered: u64,
    sizes: Vec<(u32, u32, PixelFormat)>,
    first_ns: i64,
    last_ns: i64,
    last_sequence: u64,
}

/// Reads a stream through and says what it holds.
fn stream(path: &Path) -> Result<(), Failure> {
    let mut source = replay::open(path)?;
    let mut found = Found::default();
    let ended = read_through(source.as_mut(), &mut found);
    say(&told(path, source.as_ref(), &found))?;
    ended?;
    let what = match found.unusable.in_words(found.frames) {
        Some(_) if found.unusable.total() == found.frames => "no frame can be used; replay can show nothing of it".to_owned(),
        Some(why) => format!("{why}; replay shows the picture before each again"),
        None if found.truncated > 0 => format!("{} frames are shorter than they should be", found.truncated),
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
        if found.frames == 0 {
            found.first_ns = stamp.time_ns;
        } else {
            let missing = stamp.sequence.saturating_sub(found.last_sequence).saturating_sub(1);
            found.missing = found.missing.saturating_add(missing);
            found.disordered += u64::from(stamp.time_ns <= found.last_ns);
        }
        (found.last_ns, found.last_sequence) = (stamp.time_ns, stamp.sequence);
        match decoder.decode(&frame, &mut picture) {
            Ok(()) => found.truncated += u64::from(stamp.flags.contains(FrameFlags::TRUNCATED) || decoder.is_cut()),
            Err(why) => found.unusable.add(&why),
        }
        found.frames += 1;
    }
}

fn told(path: &Path, source: &dyn FrameSource, found: &Found) -> String {
    let sizes: Vec<String> = found.sizes.iter().map(|(width, height, pixel)| format!("{width}x{height} {pixel}")).collect();
    let span_s = found.last_ns.saturating_sub(found.first_ns) as f64 / 1e9;
    let nominal_s = if source.format().rate() > 0.0 { 1.0 / source.format().rate() } else { 0.0 };
    let duration_s = if found.frames == 0 { 0.0 } else { span_s + nominal_s };
    let mean = if span_s > 0.0 { (found.frames - 1) as f64 / span_s } else { source.format().rate() };
    let mut text = format!(
        "{}: {} frames, {}, {duration_s:.3} s, {mean:.3} frames a second (nominal {:.3})\n",
        path.display(),
        found.frames,
        if sizes.is_empty() { "no size".to_owned() } else { sizes.join(", then ") },
        source.format().rate()
    );
    if let Some(why) = found.unusable.in_words(found.frames) {
        text += &format!("  {why}\n");
    }
    for (count, what) in [
        (found.truncated, "shorter than they should be"),
        (found.missing, "missing: the camera counted them but did not give them"),
        (found.disordered, "not later than the frame before"),
    ] {
        if count > 0 {
            text += &format!("  {count} frames {what}\n");
        }
    }
    text
}
