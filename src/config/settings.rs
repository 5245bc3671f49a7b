//! All settings, section by section.

use std::fmt;

use super::read;
use super::{Fault, Faults, Key, keys};
use crate::device::v4l2::CaptureParams;
use crate::image::PixelFormat;
use crate::pipeline::Params;

/// All settings of a run. [`Settings::default`] is what `config/gimbald.toml` says.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Settings {
    /// What the pipeline and its stages do.
    pub pipeline: Params,
    /// Which camera, and in which mode.
    pub camera: Capture,
    /// Where the picture goes.
    pub output: Output,
    /// What is told.
    pub log: Log,
    /// Who may talk to it.
    pub control: Control,
    /// What was written and has no effect any more: nothing is wrong with the rest, so this is for a warning.
    pub retired: Vec<Fault>,
}

/// How a camera is to be opened.
#[derive(Clone, Debug, PartialEq)]
pub struct Capture {
    /// Path, number or name of the device; "auto": the first camera that is no loopback.
    pub device: String,
    /// Pixel format; `None`: the one that costs least.
    pub format: Option<PixelFormat>,
    /// Width (pixels); 0: the camera's best.
    pub width: u32,
    /// Height (pixels); 0: the camera's best.
    pub height: u32,
    /// Frames a second; 0: the camera's best.
    pub fps: f64,
}

impl Default for Capture {
    fn default() -> Self {
        Self { device: "auto".into(), format: None, width: 0, height: 0, fps: 0.0 }
    }
}

/// How the loopback device is to be opened.
#[derive(Clone, Debug, PartialEq)]
pub struct Output {
    /// Path, number or label of the device; "auto": the first v4l2loopback that is free.
    pub device: String,
    /// Pixel format that readers get.
    pub format: PixelFormat,
    /// Whether a loopback device is to be made where there is none.
    pub create: bool,
    /// Whether PipeWire companions get pictures; `Some(true)`: and no loopback is waited for. `None` is "auto".
    pub pipewire: Option<bool>,
    /// Whether the camera is open only while there are viewers.
    pub on_demand: bool,
    /// How long it stays open after the last viewer has left (seconds).
    pub linger_s: f64,
}

impl Default for Output {
    fn default() -> Self {
        Self { device: "auto".into(), format: PixelFormat::Yuyv, create: false, pipewire: None, on_demand: true, linger_s: 5.0 }
    }
}

/// The socket on which a daemon that runs is talked to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Control {
    /// Its path; "auto": in the service's or user's runtime directory, "off": none.
    pub socket: String,
    /// Who may talk, as permissions in octal digits.
    pub mode: String,
    /// Whose group it is, by name or number; "own": the daemon's own.
    pub group: String,
}

impl Default for Control {
    fn default() -> Self {
        Self { socket: "auto".into(), mode: "0660".into(), group: "own".into() }
    }
}

impl Control {
    /// The permissions as a number.
    pub fn mode_bits(&self) -> u32 {
        u32::from_str_radix(&self.mode, 8).map_or(0o600, |mode| mode & 0o777)
    }

    /// Whether text says permissions.
    pub(super) fn is_mode(text: &str) -> bool {
        (3..=4).contains(&text.len()) && u32::from_str_radix(text, 8).is_ok_and(|mode| mode <= 0o777)
    }

    /// Whether text says a socket's place.
    pub(super) fn is_place(text: &str) -> bool {
        matches!(text, "auto" | "off") || (text.starts_with('/') && !text.contains('\0') && text.len() < 100)
    }
}

/// What the log holds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Log {
    /// Least important messages that are still written.
    pub level: Level,
}

/// Importance of a log message.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Level {
    /// What failed.
    Error,
    /// What needs the user's attention.
    Warn,
    /// What happened.
    #[default]
    Info,
    /// Why it happened.
    Debug,
    /// Everything.
    Trace,
}

impl fmt::Display for Level {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Error => "error",
            Self::Warn => "warn",
            Self::Info => "info",
            Self::Debug => "debug",
            Self::Trace => "trace",
        })
    }
}

impl Capture {
    /// What to ask of the camera.
    pub fn params(&self) -> CaptureParams {
        let asked = |number: u32| (number > 0).then_some(number);
        CaptureParams {
            device: self.device.clone(),
            format: self.format,
            width: asked(self.width),
            height: asked(self.height),
            fps: (self.fps > 0.0).then_some(self.fps),
            ..CaptureParams::default()
        }
    }
}

impl Settings {
    /// The defaults, then what `file` says (its name, for messages, and its text), then `sets`, each `KEY=VALUE`, in order.
    ///
    /// # Errors
    /// The faults found, each with its place.
    pub fn read(file: Option<(&str, &str)>, sets: &[String]) -> Result<Self, Faults> {
        let mut settings = Self::default();
        let mut faults = Faults::default();
        if let Some((name, text)) = file {
            read::file(name, text, &mut settings, &mut faults);
        }
        for set in sets {
            read::set(set, &mut settings, &mut faults);
        }
        faults.or(settings)
    }

    /// Takes one `KEY=VALUE`.
    ///
    /// # Errors
    /// What is wrong with it; nothing has changed then.
    pub fn set(&mut self, assignment: &str) -> Result<(), Faults> {
        let mut faults = Faults::default();
        read::set(assignment, self, &mut faults);
        faults.or(())
    }

    /// The keys whose value differs between `self` and `other`.
    pub fn differing<'a>(&'a self, other: &'a Self) -> impl Iterator<Item = &'static Key> + 'a {
        keys::KEYS.iter().filter(move |key| key.value_text(self) != key.value_text(other))
    }
}
