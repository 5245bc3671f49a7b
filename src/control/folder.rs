//! A directory that is held open: operations refer to it even if its name changes meanwhile.

use std::ffi::OsString;
use std::io;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::os::unix::ffi::OsStringExt;
use std::path::{Component, Path};

use rustix::fs::{AtFlags, CWD, FileType, Mode, OFlags, Stat, fstat, mkdirat, openat, readlinkat, statat};
use rustix::io::Errno;

/// Links that are followed on the way to a directory, at most.
const MAX_LINKS: u32 = 40;
/// A place in the file system, and nothing that could have an effect on what is there.
const PLACE: OFlags = OFlags::PATH.union(OFlags::NOFOLLOW).union(OFlags::CLOEXEC);

/// A directory.
#[derive(Debug)]
pub(super) struct Folder(OwnedFd);

impl AsFd for Folder {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.0.as_fd()
    }
}

impl Folder {
    /// Opens the directory `path`; it and those above it are made where they are missing.
    ///
    /// Links on the way are followed where only root or the process's own user can have made them, as /var/run.
    ///
    /// # Errors
    /// The system's, and that there is a link which another user made.
    pub(super) fn open(path: &Path) -> io::Result<Self> {
        let mut ahead: Vec<OsString> = Vec::new();
        let push = |ahead: &mut Vec<OsString>, path: &Path| {
            ahead.extend(path.components().rev().map(|component| component.as_os_str().to_owned()));
        };
        let mut at = openat(CWD, ".", PLACE, Mode::empty())?;
        push(&mut ahead, path);
        let mut links = 0;
        while let Some(name) = ahead.pop() {
            if Path::new(&name).components().next() == Some(Component::RootDir) {
                at = openat(CWD, "/", PLACE, Mode::empty())?;
                continue;
            }
            let next = open_or_make(&at, &name)?;
            let found = fstat(&next)?;
            if !is_link(&found) {
                at = next;
                continue;
            }
            if !(is_trusted(&found) && is_guarded(&fstat(&at)?)) {
                let what = format!("{name:?} is a symbolic link which another user made or could have made");
                return Err(io::Error::other(what));
            }
            links += 1;
            if links > MAX_LINKS {
                return Err(Errno::LOOP.into());
            }
            let target = OsString::from_vec(readlinkat(&next, "", Vec::new())?.into_bytes());
            push(&mut ahead, Path::new(&target));
        }
        if FileType::from_raw_mode(fstat(&at)?.st_mode) == FileType::Directory {
            Ok(Self(at))
        } else {
            Err(Errno::NOTDIR.into())
        }
    }

    /// Makes a directory in it that is for the process's own user alone, and opens it.
    ///
    /// # Errors
    /// The system's, and that the directory is not what was made.
    pub(super) fn make_private(&self, name: &str) -> io::Result<Self> {
        mkdirat(self, name, Mode::RWXU)?;
        let made = openat(self, name, PLACE.union(OFlags::DIRECTORY), Mode::empty())?;
        let found = fstat(&made)?;
        if !is_own(&found) || found.st_mode & 0o077 != 0 {
            return Err(io::Error::other(format!("the directory {name} was exchanged for another")));
        }
        Ok(Self(made))
    }

    /// What `name` in it is, not following a link; `None` where there is nothing.
    ///
    /// # Errors
    /// The system's.
    pub(super) fn look(&self, name: &std::ffi::OsStr) -> io::Result<Option<Stat>> {
        match statat(self, name, AtFlags::SYMLINK_NOFOLLOW) {
            Ok(found) => Ok(Some(found)),
            Err(Errno::NOENT) => Ok(None),
            Err(error) => Err(error.into()),
        }
    }
}

fn open_or_make(at: &OwnedFd, name: &OsString) -> io::Result<OwnedFd> {
    match openat(at, name, PLACE, Mode::empty()) {
        Err(Errno::NOENT) => {
            match mkdirat(at, name, Mode::from_raw_mode(0o755)) {
                Ok(()) | Err(Errno::EXIST) => {}
                Err(error) => return Err(error.into()),
            }
            Ok(openat(at, name, PLACE, Mode::empty())?)
        }
        other => Ok(other?),
    }
}

fn is_link(found: &Stat) -> bool {
    FileType::from_raw_mode(found.st_mode) == FileType::Symlink
}

/// Whether it belongs to the process's own user.
pub(super) fn is_own(found: &Stat) -> bool {
    found.st_uid == rustix::process::geteuid().as_raw()
}

fn is_trusted(found: &Stat) -> bool {
    found.st_uid == 0 || is_own(found)
}

/// Whether only root and the process's own user can exchange what they themselves have put there.
fn is_guarded(directory: &Stat) -> bool {
    let (for_others, sticky) = (directory.st_mode & 0o022 != 0, directory.st_mode & 0o1000 != 0);
    is_trusted(directory) && (!for_others || sticky)
}

/// The kind of file, for messages.
pub(super) fn kind(found: &Stat) -> &'static str {
    match FileType::from_raw_mode(found.st_mode) {
        FileType::RegularFile => "a regular file",
        FileType::Directory => "a directory",
        FileType::Symlink => "a symbolic link",
        FileType::Fifo => "a FIFO",
        FileType::Socket => "a socket",
        FileType::CharacterDevice | FileType::BlockDevice => "a device",
        _ => "a file of an unknown kind",
    }
}
