//! The control socket in the file system: ownership, permissions, lock, and sockets that a crashed daemon left behind.

use std::ffi::{OsStr, OsString};
use std::fs;
use std::io;
use std::os::fd::{AsFd, AsRawFd, OwnedFd};
use std::os::unix::net::UnixListener;
use std::path::{Path, PathBuf};

use rustix::fs::{
    AtFlags, FileType, FlockOperation, Mode, OFlags, RenameFlags, Stat, chmodat, chownat, fchmod, flock, fstat, openat,
    renameat, renameat_with, unlinkat,
};
use rustix::io::Errno;
use rustix::net::{AddressFamily, SocketAddrUnix, SocketFlags, SocketType, bind, listen, socket_with};

use super::folder::{Folder, is_own, kind};

/// The socket's name in a runtime directory.
const NAME: &str = "control.sock";
/// The socket's name in the directory in which it is prepared.
const PREPARED: &str = "s";
/// Bytes of a socket's path, at most: what `sockaddr_un` holds, less the end mark.
const LONGEST_PATH: usize = 107;
/// Connections that wait to be accepted, at most; who comes then waits in connect(). Short, so that this wait is.
const BACKLOG: i32 = 64;

/// A socket that listens; its file goes with it.
#[derive(Debug)]
pub struct BoundSocket {
    pub(super) listener: UnixListener,
    path: PathBuf,
    folder: Folder,
    name: OsString,
    /// Which file is ours: another may have taken its name.
    file: (u64, u64),
    /// Held for as long as we live: says that the socket is in use, which its mere presence does not.
    _lock: OwnedFd,
}

/// Where daemons have their sockets, by default: the first is a service's own.
pub fn default_paths(instance: Option<&str>) -> Vec<PathBuf> {
    let directory = instance.map_or("gimbald".to_owned(), |instance| format!("gimbald-{instance}"));
    let mut paths = vec![Path::new("/run").join(&directory).join(NAME)];
    if let Some(runtime) = std::env::var_os("XDG_RUNTIME_DIR").filter(|path| Path::new(path).is_absolute()) {
        paths.push(Path::new(&runtime).join(directory).join(NAME));
    }
    paths
}

/// The socket's place for a daemon whose configuration says "auto": the service's runtime directory, or the user's. `None` where
/// there is neither.
pub(super) fn own_path(service: Option<&Path>) -> Option<PathBuf> {
    match service {
        Some(directory) => Some(directory.join(NAME)),
        None if rustix::process::geteuid().is_root() => default_paths(None).into_iter().next(),
        None => default_paths(None).into_iter().nth(1),
    }
}

impl BoundSocket {
    /// Listens at `path`, for those whom `mode` and `group` allow. A socket that a daemon of the same user left there is replaced;
    /// one on which a daemon listens, and whatever is no socket of this user, is left alone. No link is followed, in the place of
    /// the socket or of its lock (`path` and `.lock`). The socket appears under its name with its final group and mode.
    ///
    /// # Errors
    /// What stands in the way, and what to do.
    pub fn bind(path: &Path, mode: u32, group: Option<&str>) -> Result<Self, String> {
        let wrong = |what: String| format!("{}: {what}; use another control.socket", path.display());
        let cannot = |what: &'static str| move |error: io::Error| wrong(format!("cannot {what}: {error}"));
        let name = path.file_name().ok_or_else(|| wrong("is not the path of a file".into()))?;
        if path.as_os_str().len() > LONGEST_PATH {
            return Err(wrong(format!("is too long, a socket path has at most {LONGEST_PATH} bytes")));
        }
        let directory = path.parent().filter(|directory| !directory.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let folder = Folder::open(directory).map_err(cannot("open its directory"))?;
        let mut lock_name = name.to_owned();
        lock_name.push(".lock");
        let lock = lock_file(&folder, &lock_name).map_err(|refused| match refused {
            Refused::InUse => {
                format!("{}: in use by another daemon; use a different control.socket for each", path.display())
            }
            Refused::Foreign(what) => format!(
                "{}.lock: {what} is in the place of the socket's lock; remove it or use another control.socket",
                path.display()
            ),
            Refused::System(error) => cannot("create its lock")(error),
        })?;
        if let Some(what) = folder.look(name).map_err(cannot("inspect it"))?.and_then(|found| foreign(&found, FileType::Socket))
        {
            return Err(format!(
                "{}: {what} is in the place of the socket; remove it or use another control.socket",
                path.display()
            ));
        }
        let group = group.map(|group| Ok((group, group_id(group)?))).transpose();
        let group = group.map_err(|name: String| format!("{name:?}: no such group; fix control.group"))?;
        let prepared = Prepared::new(&folder, name).map_err(cannot("prepare it"))?;
        let listener = prepared.listen(mode, group).map_err(|refused| match refused {
            Unprepared::Group(name, error) => {
                let why = "the daemon has to be a member of it (systemd: Group=)";
                format!("{}: cannot give it to the group {name}: {error}; {why}", path.display())
            }
            Unprepared::System(error) => cannot("listen there")(error),
        })?;
        let file = prepared.move_to(name).map_err(cannot("create it"))?;
        drop(prepared);
        Ok(Self { listener, path: path.into(), folder, name: name.to_owned(), file, _lock: lock })
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

impl Drop for BoundSocket {
    fn drop(&mut self) {
        if let Ok(Some(found)) = self.folder.look(&self.name)
            && identity(&found) == self.file
        {
            let _ = unlinkat(&self.folder, &self.name, AtFlags::empty());
        }
    }
}

/// Which file it is.
fn identity(found: &Stat) -> (u64, u64) {
    (found.st_dev, found.st_ino)
}

/// What is wrong with what was found in the place of a file of the process's own user and of this kind.
fn foreign(found: &Stat, wanted: FileType) -> Option<String> {
    if FileType::from_raw_mode(found.st_mode) != wanted {
        Some(kind(found).to_owned())
    } else if !is_own(found) {
        Some(format!("{} of another user (uid {})", kind(found), found.st_uid))
    } else {
        None
    }
}

/// Why there is no lock.
enum Refused {
    /// Another process holds it.
    InUse,
    /// What stands there is no lock of ours.
    Foreign(String),
    System(io::Error),
}

impl From<Errno> for Refused {
    fn from(error: Errno) -> Self {
        Self::System(error.into())
    }
}

/// Makes the lock or takes the one that is there; never waits.
fn lock_file(folder: &Folder, name: &OsStr) -> Result<OwnedFd, Refused> {
    let check = |found: &Stat| foreign(found, FileType::RegularFile).map_or(Ok(()), |what| Err(Refused::Foreign(what)));
    let look = || folder.look(name).map_err(Refused::System);
    // Looked at before it is opened: a device may do something when it is.
    look()?.iter().try_for_each(check)?;
    let how = OFlags::RDWR | OFlags::CREATE | OFlags::NOFOLLOW | OFlags::NONBLOCK | OFlags::NOCTTY | OFlags::CLOEXEC;
    let lock = openat(folder, name, how, Mode::RUSR | Mode::WUSR)?;
    let ours = fstat(&lock)?;
    check(&ours)?;
    match flock(&lock, FlockOperation::NonBlockingLockExclusive) {
        Ok(()) => {}
        Err(Errno::WOULDBLOCK) => return Err(Refused::InUse),
        Err(error) => return Err(error.into()),
    }
    // The lock counts only for as long as others find it under its name.
    if look()?.is_some_and(|found| identity(&found) == identity(&ours)) {
        Ok(lock)
    } else {
        Err(Refused::Foreign("another file".into()))
    }
}

/// Why the socket could not be prepared.
enum Unprepared<'a> {
    Group(&'a str, io::Error),
    System(io::Error),
}

impl From<Errno> for Unprepared<'_> {
    fn from(error: Errno) -> Self {
        Self::System(error.into())
    }
}

/// A directory for our eyes only, beside the socket's place: there the socket is made, and moved from there when all about it is right.
/// So there is no moment in which others may use it or put something else in its place. Goes when it is dropped.
struct Prepared<'a> {
    folder: &'a Folder,
    name: String,
    private: Folder,
}

impl<'a> Prepared<'a> {
    fn new(folder: &'a Folder, socket: &OsStr) -> io::Result<Self> {
        let name = format!(".{}.new", socket.to_string_lossy());
        let private = match folder.make_private(&name) {
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {
                // Left by a daemon that was killed: we hold the lock, so no living one is at it.
                let _ = unlinkat(folder, format!("{name}/{PREPARED}"), AtFlags::empty());
                unlinkat(folder, &name, AtFlags::REMOVEDIR)?;
                folder.make_private(&name)?
            }
            other => other?,
        };
        Ok(Self { folder, name, private })
    }

    /// Makes the socket and listens.
    fn listen<'g>(&self, mode: u32, group: Option<(&'g str, u32)>) -> Result<UnixListener, Unprepared<'g>> {
        let flags = SocketFlags::CLOEXEC | SocketFlags::NONBLOCK;
        let socket = socket_with(AddressFamily::UNIX, SocketType::STREAM, flags, None)?;
        // Linux makes the file with the mode that the socket has (and less, by the umask).
        fchmod(&socket, Mode::RUSR | Mode::WUSR)?;
        // There is no bindat().
        let path = format!("/proc/self/fd/{}/{PREPARED}", self.private.as_fd().as_raw_fd());
        bind(&socket, &SocketAddrUnix::new(path)?)?;
        if let Some((name, id)) = group {
            let group = Some(rustix::fs::Gid::from_raw(id));
            let given = chownat(&self.private, PREPARED, None, group, AtFlags::SYMLINK_NOFOLLOW);
            given.map_err(|error| Unprepared::Group(name, error.into()))?;
        }
        chmodat(&self.private, PREPARED, Mode::from_raw_mode(mode), AtFlags::empty())?;
        listen(&socket, BACKLOG)?;
        Ok(UnixListener::from(socket))
    }

    /// Moves the socket to its place in one step; a socket of ours that is there is replaced. Returns which file it is.
    fn move_to(&self, name: &OsStr) -> io::Result<(u64, u64)> {
        let moved = self.private.look(OsStr::new(PREPARED))?.ok_or(io::ErrorKind::NotFound)?;
        let exchange = |flags| renameat_with(&self.private, PREPARED, self.folder, name, flags);
        match exchange(RenameFlags::NOREPLACE) {
            Ok(()) => {}
            Err(Errno::EXIST) => {
                exchange(RenameFlags::EXCHANGE)?;
                let replaced = self.private.look(OsStr::new(PREPARED))?;
                if let Some(what) = replaced.and_then(|found| foreign(&found, FileType::Socket)) {
                    exchange(RenameFlags::EXCHANGE)?;
                    return Err(io::Error::other(format!("{what} took its place")));
                }
            }
            // A file system that does not know these flags, and a name that was looked at before.
            Err(Errno::INVAL | Errno::NOSYS) => renameat(&self.private, PREPARED, self.folder, name)?,
            Err(error) => return Err(error.into()),
        }
        Ok(identity(&moved))
    }
}

impl Drop for Prepared<'_> {
    fn drop(&mut self) {
        let _ = unlinkat(&self.private, PREPARED, AtFlags::empty());
        let _ = unlinkat(self.folder, &self.name, AtFlags::REMOVEDIR);
    }
}

/// A group's number: by its name in /etc/group, or as it stands.
///
/// # Errors
/// The name, where there is no such group.
fn group_id(group: &str) -> Result<u32, String> {
    if let Ok(id) = group.parse() {
        return Ok(id);
    }
    let groups = fs::read_to_string("/etc/group").unwrap_or_default();
    let fields = groups.lines().map(|line| line.split(':').collect::<Vec<_>>()).find(|fields| fields[0] == group);
    fields.and_then(|fields| fields.get(2)?.parse().ok()).ok_or_else(|| group.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;
    use std::os::unix::fs::{MetadataExt, PermissionsExt, symlink};
    use std::os::unix::net::UnixStream;

    struct Scratch(PathBuf);

    impl Scratch {
        fn new(name: &str) -> Self {
            let path = std::env::temp_dir().join(format!("gimbald-socket-{}-{name}", std::process::id()));
            fs::create_dir_all(&path).unwrap();
            Self(path)
        }

        fn names(&self) -> Vec<String> {
            let entries = fs::read_dir(&self.0).unwrap();
            let mut names: Vec<String> = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
            names.sort();
            names
        }
    }

    impl Drop for Scratch {
        fn drop(&mut self) {
            let _ = fs::remove_dir_all(&self.0);
        }
    }

    #[test]
    fn a_stale_socket_is_taken_over_and_a_living_one_is_not() {
        let scratch = Scratch::new("stale");
        let path = scratch.0.join("deeper").join("s");
        let place = BoundSocket::bind(&path, 0o640, None).unwrap();
        assert_eq!(fs::metadata(&path).unwrap().mode() & 0o7777, 0o640);
        assert_eq!(fs::metadata(path.with_extension("lock")).unwrap().mode() & 0o7777, 0o600);
        let second = BoundSocket::bind(&path, 0o660, None).unwrap_err();
        assert!(second.contains("in use by another daemon"), "{second}");
        assert!(UnixStream::connect(&path).is_ok(), "the first still listens");
        drop(place);
        assert!(!path.exists(), "its file goes with it");
        // what a killed process leaves: the file without a lock
        drop(UnixListener::bind(&path).unwrap());
        assert!(UnixStream::connect(&path).is_err());
        let place = BoundSocket::bind(&path, 0o660, None).unwrap();
        assert!(UnixStream::connect(&path).is_ok());
        fs::remove_file(&path).unwrap();
        fs::write(&path, "another's").unwrap();
        drop(place);
        assert_eq!(fs::read_to_string(&path).unwrap(), "another's", "what is not ours stays");
    }

    #[test]
    fn what_a_killed_daemon_left_half_done_is_no_hindrance() {
        let scratch = Scratch::new("half");
        let half = scratch.0.join(".s.new");
        fs::create_dir(&half).unwrap();
        drop(UnixListener::bind(half.join(PREPARED)).unwrap());
        let place = BoundSocket::bind(&scratch.0.join("s"), 0o660, None).unwrap();
        assert_eq!(scratch.names(), ["s", "s.lock"]);
        drop(place);
        // but nothing is deleted that is not of it
        fs::create_dir(&half).unwrap();
        fs::write(half.join("mine"), "").unwrap();
        let error = BoundSocket::bind(&scratch.0.join("s"), 0o660, None).unwrap_err();
        assert!(error.contains("control.socket") && half.join("mine").exists(), "{error}");
    }

    #[test]
    fn what_stands_in_the_place_of_socket_or_lock_is_named_and_left_alone() {
        let scratch = Scratch::new("instead");
        let path = scratch.0.join("s");
        let aim = scratch.0.join("aim");
        fs::write(&aim, "aim").unwrap();
        fs::set_permissions(&aim, fs::Permissions::from_mode(0o600)).unwrap();
        for name in ["s", "s.lock"] {
            let there = scratch.0.join(name);
            let fifo = || {
                rustix::fs::mknodat(rustix::fs::CWD, &there, FileType::Fifo, Mode::RWXU, 0).unwrap();
            };
            let made: [(&dyn Fn(), &str); 6] = [
                (&|| symlink(&aim, &there).unwrap(), "a symbolic link is in the place"),
                (&|| symlink(scratch.0.join("nowhere"), &there).unwrap(), "a symbolic link is in the place"),
                (&fifo, "a FIFO is in the place"),
                (&|| fs::create_dir(&there).unwrap(), "a directory is in the place"),
                (&|| fs::write(&there, "text").unwrap(), "a regular file is in the place"),
                (&|| drop(UnixListener::bind(&there).unwrap()), "a socket is in the place"),
            ];
            for (make, what) in made {
                make();
                let before = fs::symlink_metadata(&there).unwrap();
                let took = BoundSocket::bind(&path, 0o666, None);
                let fits = matches!((name, what.split(' ').nth(1)), ("s", Some("socket")) | ("s.lock", Some("regular")));
                if fits {
                    drop(took.unwrap());
                } else {
                    let error = took.unwrap_err();
                    assert!(error.contains(what) && error.contains(name) && error.contains("remove it"), "{name}: {error}");
                    assert_eq!(fs::symlink_metadata(&there).unwrap().ino(), before.ino());
                }
                if before.is_dir() {
                    fs::remove_dir(&there).unwrap()
                } else {
                    let _ = fs::remove_file(&there);
                }
                let _ = fs::remove_file(scratch.0.join("s.lock"));
                assert_eq!(scratch.names(), ["aim"]);
            }
        }
        assert_eq!((fs::read_to_string(&aim).unwrap().as_str(), fs::metadata(&aim).unwrap().mode() & 0o777), ("aim", 0o600));
    }

    #[test]
    fn links_of_other_users_are_not_followed_on_the_way_either() {
        let scratch = Scratch::new("way");
        fs::create_dir(scratch.0.join("real")).unwrap();
        symlink("real", scratch.0.join("ours")).unwrap();
        symlink("ours/../loop", scratch.0.join("loop")).unwrap();
        let place = BoundSocket::bind(&scratch.0.join("ours/s"), 0o600, None).unwrap();
        assert!(UnixStream::connect(scratch.0.join("real/s")).is_ok(), "our own are");
        drop(place);
        let error = BoundSocket::bind(&scratch.0.join("loop/s"), 0o600, None).unwrap_err();
        assert!(error.contains("symbolic links"), "{error}");
        // where others may write, a link of ours may be exchanged for one of theirs
        fs::set_permissions(&scratch.0, fs::Permissions::from_mode(0o777)).unwrap();
        let error = BoundSocket::bind(&scratch.0.join("ours/s"), 0o600, None).unwrap_err();
        assert!(error.contains("\"ours\" is a symbolic link which another user"), "{error}");
        if !rustix::process::geteuid().is_root() {
            // Past the test harness, which keeps what a test prints to itself unless it fails.
            let _ = writeln!(io::stderr(), "SKIPPED: links and files of another user: only root can make them");
            return;
        }
        fs::set_permissions(&scratch.0, fs::Permissions::from_mode(0o755)).unwrap();
        std::os::unix::fs::lchown(scratch.0.join("ours"), Some(12345), None).unwrap();
        let error = BoundSocket::bind(&scratch.0.join("ours/s"), 0o600, None).unwrap_err();
        assert!(error.contains("another user"), "{error}");
        for name in ["s", "s.lock"] {
            let there = scratch.0.join("real").join(name);
            if name == "s" {
                drop(UnixListener::bind(&there).unwrap())
            } else {
                fs::write(&there, "").unwrap()
            }
            std::os::unix::fs::chown(&there, Some(12345), None).unwrap();
            let error = BoundSocket::bind(&scratch.0.join("real/s"), 0o600, None).unwrap_err();
            assert!(error.contains("of another user (uid 12345) is in the place"), "{error}");
            fs::remove_file(&there).unwrap();
        }
    }

    #[test]
    fn what_cannot_be_is_said() {
        let scratch = Scratch::new("cannot");
        let path = scratch.0.join("s");
        let error = BoundSocket::bind(&path, 0o660, Some("no-such-group-here")).unwrap_err();
        assert!(error.contains("control.group"), "{error}");
        assert_eq!(scratch.names(), ["s.lock"], "nothing is left of it but the lock");
        let long = scratch.0.join("x".repeat(200));
        assert!(BoundSocket::bind(&long, 0o660, None).unwrap_err().contains("107 bytes"));
        assert!(BoundSocket::bind(Path::new("/proc/gimbald/s"), 0o660, None).unwrap_err().contains("control.socket"));
        assert!(BoundSocket::bind(Path::new("/dev/null/s"), 0o660, None).unwrap_err().contains("control.socket"));
        assert!(BoundSocket::bind(Path::new("/"), 0o660, None).unwrap_err().contains("control.socket"));
        let own = fs::metadata(&scratch.0).unwrap().gid().to_string();
        assert!(BoundSocket::bind(&path, 0o660, Some(&own)).is_ok());
        assert_eq!((group_id("root"), group_id("12")), (Ok(0), Ok(12)));
    }
}
