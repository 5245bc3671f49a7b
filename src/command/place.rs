//! Where output goes: opened early, never over the input.

use std::fs::{self, File};
use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use super::{Exit, Failure};

/// Refuses a command line in which one file would be written that is also read, or written twice.
///
/// # Errors
/// The first such file, by name.
pub(super) fn all_differ(input: &Path, outputs: &[&Path]) -> Result<(), Failure> {
    for (index, output) in outputs.iter().enumerate() {
        if same(input, output) {
            let what =
                format!("{}: is the input; writing it would destroy what is being read. Choose another name", output.display());
            return Err(Failure::new(Exit::Usage, what));
        }
        if outputs[..index].iter().any(|other| same(other, output)) {
            let what = format!("{}: two outputs would be written to it; choose another name for one of them", output.display());
            return Err(Failure::new(Exit::Usage, what));
        }
    }
    Ok(())
}

/// Whether both paths are one regular file, by whatever names, or one that is not yet there.
fn same(a: &Path, b: &Path) -> bool {
    match (fs::metadata(a), fs::metadata(b)) {
        (Ok(a), Ok(b)) => a.is_file() && (a.dev(), a.ino()) == (b.dev(), b.ino()),
        (Err(_), Err(_)) => a == b && a.as_os_str() != "-",
        _ => false,
    }
}

/// A file for a report, made before the work begins: a name that cannot be written is told at once, not after an hour.
#[derive(Debug)]
pub(super) struct ReportFile {
    /// Its name.
    pub(super) path: PathBuf,
    file: File,
}

impl ReportFile {
    /// Makes the file, empty.
    ///
    /// # Errors
    /// Where the system refuses.
    pub(super) fn create(path: &Path) -> Result<Self, Failure> {
        let file = File::create(path).map_err(|error| Failure::creating(path, &error))?;
        Ok(Self { path: path.into(), file })
    }

    /// Writes the whole content.
    ///
    /// # Errors
    /// Where the system refuses.
    pub(super) fn fill(mut self, content: &str) -> Result<(), Failure> {
        io::Write::write_all(&mut self.file, content.as_bytes()).map_err(|error| Failure::writing(&self.path, &error))
    }
}
