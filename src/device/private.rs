//! Files with personal data, such as pictures: readable only by their owner.

use std::fs::{File, OpenOptions, Permissions};
use std::io;
use std::os::unix::fs::{MetadataExt, OpenOptionsExt, PermissionsExt};
use std::path::Path;

/// Opens a file for writing, empty. A new one has mode 0600 (less what the umask takes). From a regular file that was there before, the
/// group's and others' rights are taken away before it is emptied. Pipes and devices are left as they are, and so are files on a file
/// system without modes.
///
/// # Errors
/// Where the file cannot be opened or made, and where it is another user's: that user could read it.
pub fn create(path: &Path) -> io::Result<File> {
    let file = OpenOptions::new().write(true).create(true).truncate(false).mode(0o600).open(path)?;
    let there = file.metadata()?;
    if !there.is_file() {
        return Ok(file);
    }
    let mode = there.mode() & 0o777;
    if there.uid() != rustix::process::geteuid().as_raw() && !rustix::process::geteuid().is_root() {
        let what = "the file belongs to another user, who could read the output; choose another name or remove it";
        return Err(io::Error::new(io::ErrorKind::PermissionDenied, what));
    }
    if mode & 0o077 != 0 {
        // Refused on a file system without modes, as on a memory card: who mounts it says who may read it.
        let _ = file.set_permissions(Permissions::from_mode(mode & 0o700));
    }
    file.set_len(0)?;
    Ok(file)
}

#[cfg(test)]
mod tests {
    use super::*;

    use std::fs;

    fn mode(path: &Path) -> u32 {
        fs::metadata(path).unwrap().permissions().mode() & 0o777
    }

    #[test]
    fn new_files_and_those_that_were_there_are_their_owners_alone() {
        let scratch = tempfile::tempdir().unwrap();
        let path = scratch.path().join("file");
        create(&path).unwrap();
        assert_eq!(mode(&path), 0o600);
        for before in [0o644, 0o666, 0o755, 0o600] {
            fs::write(&path, "old").unwrap();
            fs::set_permissions(&path, Permissions::from_mode(before)).unwrap();
            create(&path).unwrap();
            assert_eq!(mode(&path), before & 0o700);
            assert_eq!(fs::read(&path).unwrap(), b"");
        }
        // Through a link it is the file behind it.
        let link = scratch.path().join("link");
        std::os::unix::fs::symlink(&path, &link).unwrap();
        fs::set_permissions(&path, Permissions::from_mode(0o644)).unwrap();
        create(&link).unwrap();
        assert_eq!(mode(&path), 0o600);
    }

    #[test]
    fn devices_keep_their_modes() {
        let before = mode(Path::new("/dev/null"));
        create(Path::new("/dev/null")).unwrap();
        assert_eq!(mode(Path::new("/dev/null")), before);
    }
}
