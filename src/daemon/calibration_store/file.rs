//! The file of saved calibrations: read only if it is a regular file of limited size; replaced atomically, by one writer at a time.

use std::fs::{self, File, FileType, OpenOptions};
use std::io::{self, Read, Write};
use std::os::unix::fs::{FileTypeExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::thread;
use std::time::{Duration, Instant};

use rustix::fs::{FlockOperation, OFlags, flock};
use rustix::io::Errno;

/// Most bytes that are read.
pub(super) const LARGEST: u64 = 1 << 16;
/// How long a writer waits for another, and how often it asks.
const LOCK_TIMEOUT: Duration = Duration::from_secs(1);
const ASK_EVERY: Duration = Duration::from_millis(10);
/// A file that is being written is named so, with random letters between; it becomes the state file by being renamed.
const UNFINISHED: (&str, &str) = (".cameras-", ".new");

/// Why the file's content cannot be used.
#[derive(Debug, thiserror::Error)]
pub(super) enum Unusable {
    /// It is not what gimbald writes. It may be replaced.
    #[error("{0}")]
    Damaged(String),
    /// Something else stands in its place, or the system refuses to read it. It is left as it is.
    #[error("{0}")]
    Refused(String),
}

/// A file in a directory that exists.
#[derive(Debug)]
pub(super) struct StateFile {
    directory: PathBuf,
    path: PathBuf,
}

impl StateFile {
    /// The file `name` in `directory`. Nothing is opened.
    pub(super) fn new(directory: &Path, name: &str) -> Self {
        Self { directory: directory.into(), path: directory.join(name) }
    }

    /// Where it is.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Its text; `None` where there is no file. It never waits, whatever is in the file's place.
    ///
    /// # Errors
    /// What is wrong, and what to do.
    pub(super) fn read(&self) -> Result<Option<String>, Unusable> {
        let refused = |error: io::Error| Unusable::Refused(format!("cannot be read: {error}"));
        // Looked at before it is opened: opening a device may do something.
        match fs::symlink_metadata(&self.path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(refused(error)),
            Ok(there) => regular(there.file_type())?,
        }
        // It may have been exchanged in between: no link is followed, and a FIFO is not waited for.
        let flags = (OFlags::NOFOLLOW | OFlags::NONBLOCK).bits().cast_signed();
        let file = match OpenOptions::new().read(true).custom_flags(flags).open(&self.path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
            opened => opened.map_err(refused)?,
        };
        regular(file.metadata().map_err(refused)?.file_type())?;
        let mut bytes = Vec::new();
        file.take(LARGEST + 1).read_to_end(&mut bytes).map_err(refused)?;
        if bytes.len() as u64 > LARGEST {
            return Err(Unusable::Damaged(format!("larger than {LARGEST} bytes, not written by gimbald")));
        }
        let text = String::from_utf8(bytes).map_err(|_| Unusable::Damaged("invalid UTF-8, not written by gimbald".into()))?;
        Ok(Some(text))
    }

    /// Replaces the file by what `change` makes of the present one, which no other writer changes meanwhile. At every moment, also after
    /// the power fails, the file is wholly the old or wholly the new one.
    ///
    /// # Errors
    /// `change`'s, or what the system refuses; the file is then as it was.
    pub(super) fn update(
        &self,
        change: impl FnOnce(Result<Option<String>, Unusable>) -> Result<String, Unusable>,
    ) -> Result<(), Unusable> {
        let refused = |error: io::Error| Unusable::Refused(format!("cannot be written: {error}"));
        let directory = File::open(&self.directory).map_err(refused)?;
        lock(&directory)?;
        let text = change(self.read())?;
        self.sweep();
        let (prefix, suffix) = UNFINISHED;
        let mut unfinished =
            tempfile::Builder::new().prefix(prefix).suffix(suffix).tempfile_in(&self.directory).map_err(refused)?;
        unfinished.write_all(text.as_bytes()).map_err(refused)?;
        unfinished.as_file().sync_all().map_err(refused)?;
        unfinished.persist(&self.path).map_err(|error| refused(error.error))?;
        // The new name, too, is to outlast a power failure.
        directory.sync_all().map_err(refused)
    }

    /// Removes what writers left that were killed while they wrote. The lock is held: no other process is writing.
    fn sweep(&self) {
        let Ok(entries) = fs::read_dir(&self.directory) else { return };
        for entry in entries.flatten() {
            let name = entry.file_name();
            let name = name.to_string_lossy();
            if name.starts_with(UNFINISHED.0) && name.ends_with(UNFINISHED.1) {
                let _ = fs::remove_file(entry.path());
            }
        }
    }
}

/// Takes the lock on the state directory, which goes when `directory` is closed.
fn lock(directory: &File) -> Result<(), Unusable> {
    let began = Instant::now();
    loop {
        match flock(directory, FlockOperation::NonBlockingLockExclusive) {
            Ok(()) => return Ok(()),
            Err(Errno::WOULDBLOCK | Errno::INTR) if began.elapsed() < LOCK_TIMEOUT => thread::sleep(ASK_EVERY),
            Err(Errno::WOULDBLOCK) => {
                let what = "cannot be written: another process holds the lock on its directory".into();
                return Err(Unusable::Refused(what));
            }
            Err(error) => return Err(Unusable::Refused(format!("cannot be written: no lock on its directory: {error}"))),
        }
    }
}

/// Whether it is a regular file.
fn regular(kind: FileType) -> Result<(), Unusable> {
    let what = match kind {
        kind if kind.is_file() => return Ok(()),
        kind if kind.is_symlink() => "a symbolic link",
        kind if kind.is_dir() => "a directory",
        kind if kind.is_fifo() => "a FIFO",
        kind if kind.is_socket() => "a socket",
        _ => "a device",
    };
    Err(Unusable::Refused(format!("is {what}, not a regular file; remove it. Calibrations are not saved until then")))
}

#[cfg(test)]
mod tests {
    use super::*;

    use std::os::unix::fs::{PermissionsExt, symlink};
    use std::os::unix::net::UnixListener;
    use std::sync::mpsc::channel;

    const NAME: &str = "state";

    fn append(file: &StateFile, line: &str) -> Result<(), Unusable> {
        file.update(|before| Ok(before?.unwrap_or_default() + line))
    }

    #[test]
    fn what_is_no_regular_file_is_named_and_left_as_it_is() {
        let scratch = tempfile::tempdir().unwrap();
        let elsewhere = scratch.path().join("elsewhere");
        fs::write(&elsewhere, "another's").unwrap();
        for what in ["a symbolic link", "a directory", "a FIFO", "a socket"] {
            let directory = scratch.path().join(what);
            fs::create_dir(&directory).unwrap();
            let path = directory.join(NAME);
            match what {
                "a symbolic link" => symlink(&elsewhere, &path).unwrap(),
                "a directory" => fs::create_dir(&path).unwrap(),
                "a FIFO" => rustix::fs::mkfifoat(rustix::fs::CWD, &path, 0o600.into()).unwrap(),
                _ => drop(UnixListener::bind(&path).unwrap()),
            }
            let file = StateFile::new(&directory, NAME);
            let before = fs::symlink_metadata(&path).unwrap().file_type();
            // In a thread of its own: opening a FIFO may block forever.
            let (done, finished) = channel();
            thread::spawn(move || done.send((file.read(), append(&file, "x"))));
            let (read, written) = finished.recv_timeout(Duration::from_secs(20)).expect("it waits");
            for error in [read.unwrap_err(), written.unwrap_err()] {
                assert!(matches!(error, Unusable::Refused(_)), "{error:?}");
                assert!(error.to_string().starts_with(&format!("is {what}, not a regular file")), "{error}");
            }
            assert_eq!(fs::symlink_metadata(&path).unwrap().file_type(), before);
            assert_eq!(fs::read_to_string(&elsewhere).unwrap(), "another's");
            assert_eq!(fs::read_dir(&directory).unwrap().count(), 1, "{what}: something was left");
        }
    }

    #[test]
    fn one_that_is_too_large_or_no_text_is_damaged_and_the_largest_is_read() {
        let scratch = tempfile::tempdir().unwrap();
        let file = StateFile::new(scratch.path(), NAME);
        assert!(file.read().unwrap().is_none());
        fs::write(file.path(), vec![b'#'; LARGEST as usize]).unwrap();
        assert_eq!(file.read().unwrap().unwrap().len() as u64, LARGEST);
        for content in [vec![b'#'; LARGEST as usize + 1], b"\xff\xfe".to_vec()] {
            fs::write(file.path(), content).unwrap();
            assert!(matches!(file.read(), Err(Unusable::Damaged(_))));
        }
        file.update(|before| before.or(Ok(None)).map(|_| "new".into())).unwrap();
        assert_eq!(file.read().unwrap().unwrap(), "new");
    }

    #[test]
    fn writers_at_once_lose_nothing_and_readers_see_whole_files() {
        let scratch = tempfile::tempdir().unwrap();
        let file = StateFile::new(scratch.path(), NAME);
        let (writers, rounds) = (4, 12);
        thread::scope(|scope| {
            let writing: Vec<_> = (0..writers)
                .map(|writer| {
                    let file = &file;
                    scope.spawn(move || {
                        for round in 0..rounds {
                            // Another's turn may last longer than that on a busy machine; a refusal changes nothing.
                            while append(file, &format!("{writer} {round} {}\n", "x".repeat(999))).is_err() {}
                        }
                    })
                })
                .collect();
            while !writing.iter().all(thread::ScopedJoinHandle::is_finished) {
                let text = file.read().unwrap().unwrap_or_default();
                assert!(text.is_empty() || text.ends_with("x\n"), "a torn file: {} bytes", text.len());
            }
        });
        let text = file.read().unwrap().unwrap();
        for writer in 0..writers {
            let own: Vec<_> = text.lines().filter(|line| line.starts_with(&format!("{writer} "))).collect();
            assert_eq!(own.len(), rounds, "writer {writer}");
            assert!(own.iter().enumerate().all(|(round, line)| line.starts_with(&format!("{writer} {round} x"))));
        }
    }

    #[test]
    fn it_is_its_owners_alone_and_what_a_killed_writer_left_goes() {
        let scratch = tempfile::tempdir().unwrap();
        let file = StateFile::new(scratch.path(), NAME);
        let left = scratch.path().join(format!("{}abc{}", UNFINISHED.0, UNFINISHED.1));
        fs::write(&left, "half").unwrap();
        append(&file, "a").unwrap();
        assert_eq!(fs::metadata(file.path()).unwrap().permissions().mode() & 0o777, 0o600);
        assert_eq!(fs::read_dir(scratch.path()).unwrap().count(), 1);
    }

    #[test]
    fn a_lock_that_is_never_given_back_is_not_waited_for_for_ever() {
        let scratch = tempfile::tempdir().unwrap();
        let file = StateFile::new(scratch.path(), NAME);
        append(&file, "a").unwrap();
        let held = File::open(scratch.path()).unwrap();
        flock(&held, FlockOperation::LockExclusive).unwrap();
        let error = append(&file, "b").unwrap_err();
        assert!(error.to_string().contains("holds the lock"), "{error}");
        drop(held);
        append(&file, "c").unwrap();
        assert_eq!(file.read().unwrap().unwrap(), "ac");
    }
}
