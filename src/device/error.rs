//! Errors of sources and sinks, with what the user can do about them.

use std::io;
use std::path::PathBuf;

/// An error of a source or a sink. Each names the file or device, what was found, what was expected and, where there is
/// something to do, what.
#[derive(Debug, thiserror::Error)]
pub enum DeviceError {
    /// The operating system refused.
    #[error("{}: cannot {doing}: {source}{hint}", path.display())]
    Io {
        /// The file or device.
        path: PathBuf,
        /// What was tried, as "open" or "write".
        doing: &'static str,
        /// What to do about it, beginning with "; ", or empty.
        hint: &'static str,
        /// The system's own words.
        source: io::Error,
    },
    /// A file is not what it should be, or damaged.
    #[error("{}: {what}", path.display())]
    Format {
        /// The file.
        path: PathBuf,
        /// What was found at which byte or frame, and what was expected.
        what: String,
    },
    /// A device cannot do what was asked of it.
    #[error("{}: {what}", path.display())]
    Unsupported {
        /// The device.
        path: PathBuf,
        /// What was asked, what the device offers, and what to do.
        what: String,
    },
    /// Another program uses the device.
    #[error("{}: in use by another program; close that program, or choose another device", path.display())]
    Busy {
        /// The device.
        path: PathBuf,
    },
    /// The device was there and is not any more.
    #[error("{}: the device is gone (unplugged, or its driver removed)", path.display())]
    Gone {
        /// The device.
        path: PathBuf,
    },
}

impl DeviceError {
    /// An [`DeviceError::Io`] without a hint.
    pub fn io(path: impl Into<PathBuf>, doing: &'static str, source: io::Error) -> Self {
        Self::Io { path: path.into(), doing, hint: "", source }
    }

    /// A [`DeviceError::Format`].
    pub fn format(path: impl Into<PathBuf>, what: impl Into<String>) -> Self {
        Self::Format { path: path.into(), what: what.into() }
    }
}
