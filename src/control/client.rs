//! The other end of the socket: asks a daemon and reads its answer.

use std::io::{self, BufRead, BufReader, Read, Write};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::time::Duration;

use serde_json::Value;

/// A daemon that does not answer for this long hangs.
const PATIENCE: Duration = Duration::from_secs(5);
/// Bytes of an answer, at most.
const LONGEST_ANSWER: u64 = 1 << 20;

/// Why there is no answer.
#[derive(Debug, thiserror::Error)]
pub enum ClientError {
    /// Nobody listens.
    #[error("no gimbald listens on {path}: {source}")]
    Nobody {
        /// The socket.
        path: PathBuf,
        /// The system's words.
        source: io::Error,
    },
    /// One may not talk to it.
    #[error(
        "{path}: you may not talk to this gimbald (control.mode and control.group in its configuration say who may): {source}"
    )]
    Forbidden {
        /// The socket.
        path: PathBuf,
        /// The system's words.
        source: io::Error,
    },
    /// It is there and does not answer, or not as it should.
    #[error("{path}: gimbald does not answer: {what}")]
    Silent {
        /// The socket.
        path: PathBuf,
        /// What came instead.
        what: String,
    },
    /// It says no.
    #[error("{0}")]
    Refused(String),
}

/// A way to a daemon.
#[derive(Debug)]
pub struct Connection {
    path: PathBuf,
    stream: BufReader<UnixStream>,
}

impl Connection {
    /// Connects to the daemon that listens at `path`.
    ///
    /// # Errors
    /// Where nobody listens there.
    pub fn open(path: &Path) -> Result<Self, ClientError> {
        let failed = |source: io::Error| match source.kind() {
            io::ErrorKind::PermissionDenied => ClientError::Forbidden { path: path.into(), source },
            _ => ClientError::Nobody { path: path.into(), source },
        };
        let stream = UnixStream::connect(path).map_err(failed)?;
        stream.set_read_timeout(Some(PATIENCE)).map_err(failed)?;
        stream.set_write_timeout(Some(PATIENCE)).map_err(failed)?;
        Ok(Self { path: path.into(), stream: BufReader::new(stream) })
    }

    /// Asks one thing. Line ends in `request` become spaces.
    ///
    /// # Errors
    /// Where no answer comes, and where the answer is no.
    pub fn ask(&mut self, request: &str) -> Result<Value, ClientError> {
        let silent = |what: String| ClientError::Silent { path: self.path.clone(), what };
        let line = request.replace(['\n', '\r'], " ") + "\n";
        self.stream.get_mut().write_all(line.as_bytes()).map_err(|error| silent(error.to_string()))?;
        let mut answer = String::new();
        let read = self.stream.by_ref().take(LONGEST_ANSWER).read_line(&mut answer);
        read.map_err(|error| silent(error.to_string()))?;
        if !answer.ends_with('\n') {
            return Err(silent("the connection ended; it may be busy with many others".into()));
        }
        let value: Value = serde_json::from_str(&answer).map_err(|error| silent(format!("no JSON: {error}")))?;
        match value["ok"].as_bool() {
            Some(true) => Ok(value),
            _ => Err(ClientError::Refused(value["error"].as_str().unwrap_or("refused without a reason").to_owned())),
        }
    }
}
