//! Exit codes with their names and meanings, and the error message of a command that fails.

use std::fmt::Write as _;
use std::io;
use std::path::Path;
use std::process::ExitCode;

use crate::config::Faults;
use crate::device::DeviceError;

/// The program's exit codes, as sysexits.h has them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Exit {
    /// Success.
    Ok = 0,
    /// Doctor found something to improve, but no fault.
    Advised = 1,
    /// The command line is invalid.
    Usage = 64,
    /// An input file is damaged or of a kind that gimbald does not read.
    BadData = 65,
    /// An input file is not there or cannot be opened.
    NoInput = 66,
    /// A device, the service or another program (ffmpeg) is not there, in use, or cannot do what was asked.
    Unavailable = 69,
    /// An output file cannot be created.
    CannotCreate = 73,
    /// Reading or writing failed midway, as on a full disk.
    Io = 74,
    /// The input does not allow a reliable result.
    Inconclusive = 75,
    /// The configuration has faults.
    Config = 78,
    /// Ended by Ctrl-C before the end; what was written until then is whole.
    Interrupted = 130,
}

impl Exit {
    /// Every code with its meaning, in order.
    pub const ALL: [(Self, &'static str); 11] = [
        (Self::Ok, "success"),
        (Self::Advised, "doctor found something to improve, but no fault"),
        (Self::Usage, "invalid command line"),
        (Self::BadData, "an input file is damaged or has an unsupported format"),
        (Self::NoInput, "an input file does not exist or cannot be opened"),
        (
            Self::Unavailable,
            "a device, the service or another program is not available, is in use, or does not support the request",
        ),
        (Self::CannotCreate, "an output file cannot be created"),
        (Self::Io, "reading or writing failed, e.g. the disk is full"),
        (Self::Inconclusive, "calibrate saw too little motion for a reliable result"),
        (Self::Config, "the configuration is invalid"),
        (Self::Interrupted, "interrupted by Ctrl-C; files written so far are valid"),
    ];

    /// The number that the shell sees.
    pub fn code(self) -> u8 {
        self as u8
    }

    /// The list of all codes, for `--help`.
    pub fn help() -> String {
        let mut text = String::from("Exit codes:\n");
        for (exit, meaning) in Self::ALL {
            let _ = writeln!(text, "  {:>3}  {meaning}", exit.code());
        }
        text
    }
}

impl From<Exit> for ExitCode {
    fn from(exit: Exit) -> Self {
        Self::from(exit.code())
    }
}

/// Why a command ended without success.
#[derive(Debug)]
pub struct Failure {
    /// The code to end with.
    pub exit: Exit,
    /// What to tell the user: what was found, what was expected, what to do.
    pub message: String,
}

impl Failure {
    /// A failure with its message.
    pub fn new(exit: Exit, message: impl Into<String>) -> Self {
        Self { exit, message: message.into() }
    }

    /// An output file that cannot be created.
    pub fn creating(path: &Path, error: &io::Error) -> Self {
        Self::new(Exit::CannotCreate, format!("{}: cannot create: {error}", path.display()))
    }

    /// A file whose reading or writing failed midway.
    pub fn writing(path: &Path, error: &io::Error) -> Self {
        Self::new(Exit::Io, format!("{}: cannot write: {error}", path.display()))
    }
}

impl From<Faults> for Failure {
    fn from(faults: Faults) -> Self {
        Self::new(Exit::Config, faults.to_string())
    }
}

impl From<DeviceError> for Failure {
    fn from(error: DeviceError) -> Self {
        let exit = match &error {
            DeviceError::Io { doing: "create", .. } => Exit::CannotCreate,
            DeviceError::Io { doing, .. } if doing.starts_with("find such a ") => Exit::Unavailable,
            DeviceError::Io { path, .. } if path.to_str().is_some_and(|path| path.starts_with("/dev/video")) => {
                Exit::Unavailable
            }
            DeviceError::Io { doing: "open", .. } => Exit::NoInput,
            DeviceError::Io { source, .. } if source.kind() == io::ErrorKind::IsADirectory => Exit::NoInput,
            DeviceError::Io { .. } => Exit::Io,
            DeviceError::Format { .. } => Exit::BadData,
            DeviceError::Unsupported { .. } | DeviceError::Busy { .. } | DeviceError::Gone { .. } => Exit::Unavailable,
        };
        Self::new(exit, error.to_string())
    }
}
