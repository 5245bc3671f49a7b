//! Text to standard output, and warnings to standard error.

use std::io::{self, ErrorKind, Write};
use std::path::Path;

use super::Failure;

/// Writes `text`. A reader that has seen enough (`head`, a pager) is not a failure.
///
/// # Errors
/// Where standard output cannot be written otherwise.
pub(super) fn print(text: &str) -> Result<(), Failure> {
    written_or_closed(write(&mut io::stdout().lock(), text))
}

/// Writes a warning on standard error: the command goes on, or ends well.
#[expect(clippy::print_stderr, reason = "the one place where the user is warned")]
pub(super) fn warn(text: &str) {
    eprintln!("gimbald: warning: {text}");
}

fn write(to: &mut dyn Write, text: &str) -> io::Result<()> {
    to.write_all(text.as_bytes()).and_then(|()| to.flush())
}

/// What came of writing to standard output.
///
/// # Errors
/// As [`print()`].
pub(super) fn written_or_closed(written: io::Result<()>) -> Result<(), Failure> {
    match written {
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(()),
        written => written.map_err(|error| Failure::writing(Path::new("standard output"), &error)),
    }
}
