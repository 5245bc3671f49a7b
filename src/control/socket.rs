//! The socket's place in the file system: whose it is, who may use it, and what was left behind by others.

use std::fs::{self, File, OpenOptions, Permissions};
use std::io;
use std::os::unix::fs::{FileTypeExt, MetadataExt, OpenOptionsExt, PermissionsExt};
use std::os::unix::net::UnixListener;
use std::path::{Path, PathBuf};

use rustix::fs::{FlockOperation, OFlags, flock};

/// The socket's name in a runtime directory.
const NAME: &str = "control.sock";

/// A socket that listens; its file goes with it.
#[derive(Debug)]
pub struct Place {
    pub(super) listener: UnixListener,
    path: PathBuf,
    /// Which file is ours: another may have taken its name.
    file: (u64, u64),
    /// Held for as long as we live: says that the socket is in use, which its mere presence does not.
    _lock: File,
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

impl Place {
    /// Listens at `path`, for those whom `mode` and `group` allow. What a daemon that died left there is taken away; one that
    /// lives is left alone.
    ///
    /// # Errors
    /// What stands in the way, and what to do.
    pub fn take(path: &Path, mode: u32, group: Option<&str>) -> Result<Self, String> {
        let shown = path.display();
        let told = |what: &'static str| {
            move |error: io::Error| format!("{}: cannot {what}: {error}; give another control.socket", path.display())
        };
        if let Some(directory) = path.parent().filter(|directory| !directory.as_os_str().is_empty()) {
            fs::create_dir_all(directory).map_err(told("make its directory"))?;
        }
        let mut lock_path = path.as_os_str().to_owned();
        lock_path.push(".lock");
        // Where others may write, a link may wait there.
        let nofollow = OFlags::NOFOLLOW.bits().cast_signed();
        let mut options = OpenOptions::new();
        let lock = options.write(true).create(true).truncate(false).mode(0o600).custom_flags(nofollow).open(&lock_path);
        let lock = lock.map_err(told("make its lock"))?;
        match flock(&lock, FlockOperation::NonBlockingLockExclusive) {
            Ok(()) => {}
            Err(rustix::io::Errno::WOULDBLOCK) => {
                return Err(format!("{shown}: another gimbald listens there; give each a control.socket of its own"));
            }
            Err(error) => return Err(told("lock it")(error.into())),
        }
        match fs::symlink_metadata(path) {
            Ok(there) if there.file_type().is_socket() => fs::remove_file(path).map_err(told("remove what was left there"))?,
            Ok(_) => return Err(format!("{shown}: is there and is no socket; remove it or give another control.socket")),
            Err(error) if error.kind() == io::ErrorKind::NotFound => {}
            Err(error) => return Err(told("look at it")(error)),
        }
        let listener = UnixListener::bind(path).map_err(told("listen there"))?;
        let there = fs::symlink_metadata(path).map_err(told("look at it"))?;
        let place = Self { listener, path: path.into(), file: (there.dev(), there.ino()), _lock: lock };
        if let Some(group) = group {
            let id = group_id(group).ok_or_else(|| format!("{group:?}: no such group; correct control.group"))?;
            if there.gid() != id {
                let why = "the daemon has to be a member of it (systemd: Group=)";
                std::os::unix::fs::chown(path, None, Some(id))
                    .map_err(|error| format!("{shown}: cannot give it to the group {group}: {error}; {why}"))?;
            }
        }
        fs::set_permissions(path, Permissions::from_mode(mode)).map_err(told("set its mode"))?;
        place.listener.set_nonblocking(true).map_err(told("listen without waiting"))?;
        Ok(place)
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        if fs::symlink_metadata(&self.path).is_ok_and(|there| (there.dev(), there.ino()) == self.file) {
            let _ = fs::remove_file(&self.path);
        }
    }
}

/// A group's number: by its name in /etc/group, or as it stands.
fn group_id(group: &str) -> Option<u32> {
    if let Ok(id) = group.parse() {
        return Some(id);
    }
    let groups = fs::read_to_string("/etc/group").ok()?;
    let fields = groups.lines().map(|line| line.split(':').collect::<Vec<_>>()).find(|fields| fields[0] == group)?;
    fields.get(2)?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Scratch(PathBuf);

    impl Scratch {
        fn new(name: &str) -> Self {
            let path = std::env::temp_dir().join(format!("gimbald-socket-{}-{name}", std::process::id()));
            fs::create_dir_all(&path).unwrap();
            Self(path)
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
        let place = Place::take(&path, 0o640, None).unwrap();
        assert_eq!(fs::metadata(&path).unwrap().mode() & 0o7777, 0o640);
        let second = Place::take(&path, 0o660, None).unwrap_err();
        assert!(second.contains("another gimbald listens"), "{second}");
        assert!(std::os::unix::net::UnixStream::connect(&path).is_ok(), "the first still listens");
        drop(place);
        assert!(!path.exists(), "its file goes with it");
        // what somebody leaves who is killed: the file without a lock
        drop(UnixListener::bind(&path).unwrap());
        assert!(path.exists());
        let place = Place::take(&path, 0o660, None).unwrap();
        fs::remove_file(&path).unwrap();
        fs::write(&path, "another's").unwrap();
        drop(place);
        assert!(path.exists(), "what is not ours stays");
        let refused = Place::take(&path, 0o660, None).unwrap_err();
        assert!(refused.contains("no socket"), "{refused}");
    }

    #[test]
    fn what_cannot_be_is_said() {
        let scratch = Scratch::new("cannot");
        let path = scratch.0.join("s");
        let error = Place::take(&path, 0o660, Some("no-such-group-here")).unwrap_err();
        assert!(error.contains("control.group"), "{error}");
        assert!(!path.exists(), "nothing is left of it");
        fs::remove_file(scratch.0.join("s.lock")).unwrap();
        std::os::unix::fs::symlink("elsewhere", scratch.0.join("s.lock")).unwrap();
        assert!(Place::take(&path, 0o660, None).is_err() && !scratch.0.join("elsewhere").exists());
        fs::remove_file(scratch.0.join("s.lock")).unwrap();
        let long = scratch.0.join("x".repeat(200));
        assert!(Place::take(&long, 0o660, None).unwrap_err().contains("control.socket"));
        assert!(Place::take(Path::new("/proc/gimbald/s"), 0o660, None).unwrap_err().contains("control.socket"));
        let own = fs::metadata(&scratch.0).unwrap().gid().to_string();
        assert!(Place::take(&path, 0o660, Some(&own)).is_ok());
        assert_eq!(group_id("root"), Some(0));
    }
}
