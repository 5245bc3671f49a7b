//! Access control for a camera's pictures: users who may open the camera's node.

use std::os::fd::AsFd;
use std::path::{Path, PathBuf};

use rustix::fs::{AtFlags, FileType, OFlags, StatxFlags, fcntl_getfl, makedev, stat, statx};

/// A camera's node as the kernel knows it. One that was plugged in again has a node of its own.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CameraNode {
    /// Its path.
    pub path: PathBuf,
    device: u64,
    file_system: u64,
    inode: u64,
}

impl CameraNode {
    /// The node at `path`; `None` where there is no character device.
    pub fn at(path: &Path) -> Option<Self> {
        let found = stat(path).ok()?;
        let is_device = FileType::from_raw_mode(found.st_mode) == FileType::CharacterDevice;
        is_device.then(|| Self { path: path.into(), device: found.st_rdev, file_system: found.st_dev, inode: found.st_ino })
    }

    /// Whether `fd` is this node, opened to read and write: the kernel has then checked that its owner may.
    pub fn is_proven_by(&self, fd: impl AsFd) -> bool {
        let Ok(flags) = fcntl_getfl(&fd) else { return false };
        // What is known of it, without asking a file system that may never answer.
        let at = AtFlags::EMPTY_PATH | AtFlags::STATX_DONT_SYNC;
        let Ok(found) = statx(&fd, c"", at, StatxFlags::BASIC_STATS) else { return false };
        let device = makedev(found.stx_rdev_major, found.stx_rdev_minor);
        let file_system = makedev(found.stx_dev_major, found.stx_dev_minor);
        // Opened with O_PATH, nothing was checked.
        flags & OFlags::ACCMODE == OFlags::RDWR
            && !flags.contains(OFlags::PATH)
            && FileType::from_raw_mode(found.stx_mode.into()) == FileType::CharacterDevice
            && (device, file_system, found.stx_ino) == (self.device, self.file_system, self.inode)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rustix::fs::{Mode, open};

    #[test]
    fn only_the_node_itself_opened_to_read_and_write_is_a_proof() {
        let node = CameraNode::at(Path::new("/dev/null")).unwrap();
        let opened = |path: &str, flags| open(path, flags | OFlags::CLOEXEC, Mode::empty()).unwrap();
        assert!(node.is_proven_by(opened("/dev/null", OFlags::RDWR)));
        assert!(!node.is_proven_by(opened("/dev/null", OFlags::RDONLY)), "who may only read may not have it");
        assert!(!node.is_proven_by(opened("/dev/null", OFlags::WRONLY)));
        assert!(!node.is_proven_by(opened("/dev/null", OFlags::PATH)), "every user can open it so");
        assert!(!node.is_proven_by(opened("/dev/null", OFlags::PATH | OFlags::RDWR)));
        assert!(!node.is_proven_by(opened("/dev/zero", OFlags::RDWR)), "another device");
        let (reader, _writer) = std::io::pipe().unwrap();
        assert!(!node.is_proven_by(reader));
        assert_eq!(CameraNode::at(Path::new("/proc/self/exe")), None);
        assert_eq!(CameraNode::at(Path::new("/no/such/node")), None);
    }
}
