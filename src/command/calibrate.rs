//! `gimbald calibrate`: estimates a camera's readout time, field of view and lens distortion from footage of a moving camera.
//!
//! The points of the whole footage are followed once; then the continuous model goes through them several times, from readout
//! times all over the possible range, either sign: its equations hold near the truth only. The answer that leaves least of the
//! points' motion unexplained is taken. A file is then followed a second time by a pipeline that knows that answer, which tells
//! background from people better, and the answer is found again.

mod footage;
mod limited;

use std::fmt::Write as _;
use std::fs;
use std::os::unix::fs::FileTypeExt;
use std::path::{Path, PathBuf};

use super::interrupt::stop_on_signal;
use super::print::{print, warn};
use super::record::{positive, synthetic};
use super::{Exit, Failure, SettingsArgs};
use crate::config::Settings;
use crate::device::v4l2::Capture;
use crate::device::{FrameSource, replay};
use crate::pipeline::Camera;
use crate::rt::notifier::Notifier;
use crate::stage::shutter::certainty::{self, Stated};
use footage::{Answer, Evenness, Footage, MIN_MOTION_PX};
use limited::Limited;

/// Footage looked at where nothing else is said, seconds: of a camera, of a file.
const SECONDS: (f64, f64) = (20.0, 120.0);
/// Frames below which nothing is said.
const MIN_FRAMES: u64 = 10;
/// Part of the intervals that may be doubtful.
const MAX_DOUBT: f64 = 0.25;
/// Jitter (frame intervals), and part of the intervals that is doubtful, from which times are called uneven.
const UNEVEN: (f64, f64) = (0.05, 0.1);
/// Share by which another answer's misfit must be larger than the best one's.
const CLEARLY: f64 = 0.05;

/// Arguments of `calibrate`.
#[derive(Clone, Debug, clap::Args)]
pub struct Args {
    /// Recording (y4m, .gbr, - for standard input), or camera: path, number or part of its name; by default camera.device
    #[arg(value_name = "IN|DEVICE")]
    input: Option<PathBuf>,
    /// Use S seconds of it; by default 20 of a camera, 120 of a file
    #[arg(long, value_name = "S", value_parser = positive)]
    seconds: Option<f64>,
    /// Use at most N frames
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    frames: Option<u64>,
    /// Settings for opening the camera; readout time, field of view and lens distortion are ignored
    #[command(flatten)]
    settings: SettingsArgs,
}

/// Runs the command.
///
/// # Errors
/// Where the input cannot be read, and [`Exit::Inconclusive`] where it shows too little.
pub fn run(args: &Args) -> Result<(), Failure> {
    let settings = args.settings.read()?;
    let input = args.input.clone().unwrap_or_else(|| settings.camera.device.clone().into());
    let wake = Notifier::new().map_err(|error| Failure::new(Exit::Io, format!("cannot make an event descriptor: {error}")))?;
    let stop = stop_on_signal(Some(wake.clone()))?;
    let recorded = is_recorded(&input);
    let seconds = args.seconds.unwrap_or(if recorded { SECONDS.1 } else { SECONDS.0 });
    let source = if recorded { replay::open(&input)? } else { camera(&settings, &input, wake)? };
    if !recorded {
        print(&format!(
            "Move the camera for {seconds:.0} seconds: turn it left and right, up and down, briskly, in front of a scene that \
             is static and not close.\n"
        ))?;
    }
    let look = |source: Box<dyn FrameSource>, known: Camera, what: &'static str| {
        let mut source = Limited::new(source, seconds, args.frames);
        let frames = source.frames();
        Footage::gather(&mut source, &settings.pipeline, known, &stop, (what, frames))
    };
    let mut footage = look(source, Camera::default(), "analysing")?;
    usable(&input.display().to_string(), recorded, &footage)?;
    let (mut best, mut other) = footage.answers(None);
    if recorded && input.is_file() && !stop.is_set() && footage.frames >= MIN_FRAMES {
        footage = look(replay::open(&input)?, footage.about(&best.camera), "refining")?;
        (best, other) = footage.answers(Some(&best.camera));
    }
    if stop.is_set() && recorded {
        return Err(Failure::new(Exit::Interrupted, "interrupted; no result"));
    }
    let found = Found {
        interval_s: footage.interval_s(),
        evenness: footage.evenness(),
        best,
        ambiguous: other.filter(|other| !clearly(&best, other)),
    };
    let name = input.display().to_string();
    let fault = found.fault(&footage);
    print(&found.summary(&name, &footage, fault.is_none()))?;
    fault.map_or(Ok(()), |fault| Err(Failure::new(Exit::Inconclusive, format!("{name}: {fault}"))))
}

/// Where most frames cannot be used, that is to blame and not the motion; a few are no matter.
///
/// # Errors
/// What is wrong with the frames.
fn usable(name: &str, recorded: bool, footage: &Footage) -> Result<(), Failure> {
    let Some(why) = footage.unusable.in_words(footage.frames) else { return Ok(()) };
    let usable = footage.frames.saturating_sub(footage.unusable.total());
    if usable >= MIN_FRAMES && 2 * usable >= footage.frames {
        warn(&format!("{name}: {why}; the result is based on the other frames"));
        return Ok(());
    }
    let (exit, what) = if recorded {
        (Exit::BadData, "cannot calibrate")
    } else {
        (Exit::Unavailable, "try another camera.format, cable or USB port")
    };
    Err(Failure::new(exit, format!("{name}: {why}; {what}")))
}

/// Whether `input` is a file or pipe of recorded frames; everything else is a camera.
fn is_recorded(input: &Path) -> bool {
    let named = input.extension().is_some_and(|extension| extension == "y4m" || extension == super::destination::RECORDING);
    let there = fs::metadata(input).is_ok_and(|about| about.is_file() || about.is_dir() || about.file_type().is_fifo());
    input.as_os_str() == "-" || named || there
}

fn camera(settings: &Settings, input: &Path, wake: Notifier) -> Result<Box<dyn FrameSource>, Failure> {
    let device = input.to_string_lossy().into_owned();
    if let Some(motion) = device.strip_prefix("synthetic:") {
        return Ok(Box::new(synthetic(motion)?));
    }
    let mut camera = settings.camera.clone();
    camera.device = device;
    Ok(Box::new(Capture::open(&camera.params(), wake)?))
}

fn clearly(best: &Answer, other: &Answer) -> bool {
    other.misfit > (1.0 + CLEARLY) * best.misfit
}

/// What was found.
struct Found {
    interval_s: f64,
    evenness: Evenness,
    best: Answer,
    /// Another answer that agrees with the footage about as well.
    ambiguous: Option<Answer>,
}

impl Found {
    fn readout(&self) -> Option<Stated> {
        let known = certainty::known_readout(&self.best.camera, self.interval_s);
        known.filter(|_| self.ambiguous.is_none() && self.evenness.doubt() <= MAX_DOUBT)
    }

    fn hfov(&self) -> Option<Stated> {
        certainty::known_hfov(&self.best.camera).filter(|_| self.readout().is_some())
    }

    fn lens(&self) -> Option<Stated> {
        certainty::known_lens(&self.best.camera).filter(|_| self.hfov().is_some())
    }

    /// Whether the frames' times are so uneven that they are worth a word.
    fn is_uneven(&self) -> bool {
        self.evenness.jitter_s > UNEVEN.0 * self.interval_s || self.evenness.doubt() > UNEVEN.1
    }

    /// The answer in words, and where it is whole, the lines for the configuration.
    fn summary(&self, name: &str, footage: &Footage, is_whole: bool) -> String {
        let Answer { motion_px, moving_s, .. } = self.best;
        let (duration_s, interval_s) = (footage.duration_s(), self.interval_s);
        let mut text = format!("{name}: {} frames, {duration_s:.1} s", footage.frames);
        if footage.cut {
            text += "; the frame size changed, frames after that were ignored";
        }
        let _ =
            writeln!(text, "\nmotion: {motion_px:.1} pixels per frame (RMS); more than {MIN_MOTION_PX} for {moving_s:.1} s");
        if self.is_uneven() {
            let _ = writeln!(text, "time stamps: {}", self.unevenness());
        }
        let mut lines = String::new();
        if let Some(Stated { value, uncertainty }) = self.readout() {
            let direction = match value {
                _ if value.abs() <= uncertainty => "not distinguishable from a global shutter",
                _ if value < 0.0 => "bottom to top",
                _ => "top to bottom",
            };
            let _ = writeln!(
                text,
                "readout time: {:.2} ± {:.2} ms, {:.1} % of the frame interval, {direction}",
                1e3 * value.abs(),
                1e3 * uncertainty,
                100.0 * value.abs() / interval_s
            );
            let _ = writeln!(lines, "readout_ms = {:.2}", 1e3 * value);
        }
        if let Some(Stated { value, uncertainty }) = self.hfov() {
            let _ = writeln!(text, "field of view: {value:.1} ± {uncertainty:.1} degrees (horizontal)");
            let _ = writeln!(lines, "hfov_deg = {value:.1}");
        }
        if let Some(Stated { value, uncertainty }) = self.lens() {
            let kind = match value {
                _ if value.abs() <= uncertainty => "not distinguishable from none",
                _ if value < 0.0 => "barrel",
                _ => "pincushion",
            };
            let _ = writeln!(text, "lens distortion: k1 {value:.3} ± {uncertainty:.3}, {kind}");
            let _ = writeln!(lines, "lens_k1 = {value:.3}");
        }
        if is_whole {
            let _ = write!(text, "Add to the configuration:\n\n[camera]\n{lines}");
        }
        text
    }

    fn unevenness(&self) -> String {
        let Evenness { jitter_s, intervals, doubtful } = self.evenness;
        format!("jitter of {:.1} ms (RMS), {doubtful} of {intervals} intervals are outliers", 1e3 * jitter_s)
    }

    /// Why not everything is known, where it is not, and what to do.
    fn fault(&self, footage: &Footage) -> Option<String> {
        let missing = self.missing(footage);
        if missing.is_empty() {
            return None;
        }
        let what = missing.join("; ");
        Some(match () {
            () if footage.frames < MIN_FRAMES => {
                format!("too short: {what}; use a longer recording, or keep the settings at \"auto\"")
            }
            () if self.is_uneven() => format!(
                "uneven time stamps: {}; {what}; record longer, on an idle machine, with the camera on a \
                 USB port of its own, or keep the settings at \"auto\"",
                self.unevenness()
            ),
            () => format!(
                "too little or unsuitable motion: {what}; turn the camera more, left and right, up and \
                 down, in front of a static scene that is not close, without moving it sideways, or keep the settings at \"auto\""
            ),
        })
    }

    /// What is not known, and why, in so many words.
    fn missing(&self, footage: &Footage) -> Vec<String> {
        let limit = certainty::LIMIT;
        if footage.frames < MIN_FRAMES {
            return vec![format!("only {} frames", footage.frames)];
        }
        let mut missing = Vec::new();
        if self.evenness.doubt() > MAX_DOUBT {
            missing.push(format!("more than {:.0} % of the intervals are outliers", 100.0 * MAX_DOUBT));
        } else if certainty::known_readout(&self.best.camera, self.interval_s).is_none() {
            let Stated { value, uncertainty } = certainty::readout(&self.best.camera, self.interval_s);
            let [value, uncertainty] = [value, uncertainty].map(|seconds| 100.0 * seconds / self.interval_s);
            missing.push(if uncertainty > 100.0 * limit.0 {
                format!(
                    "the uncertainty of the readout time is {uncertainty:.0} % of the frame interval (at most {:.0} % is accepted)",
                    100.0 * limit.0
                )
            } else {
                format!("the readout time of {value:.0} % of the frame interval is at the limit of the search range")
            });
        } else if let Some(other) = &self.ambiguous {
            let [a, b] = [&self.best, other].map(|answer| 1e3 * answer.camera.readout_s.value);
            missing.push(format!("readout times of {a:.1} and {b:.1} ms fit about equally well"));
        }
        if certainty::known_hfov(&self.best.camera).is_none() {
            let Stated { value, uncertainty } = certainty::hfov(&self.best.camera);
            missing.push(if uncertainty > limit.1 {
                format!("the uncertainty of the field of view is {uncertainty:.0} degrees (at most {:.0} is accepted)", limit.1)
            } else {
                format!("the field of view of {value:.0} degrees is at the limit of the search range")
            });
        }
        missing
    }
}
