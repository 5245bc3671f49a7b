//! Picture memory that is shared between two processes: a memfd, mapped.

use std::io;
use std::os::fd::AsFd;
use std::ptr::NonNull;

use rustix::fs::{SealFlags, fcntl_get_seals, fstat, fstatfs};
use rustix::io::Errno;
use rustix::mm::{MapFlags, ProtFlags, mmap, munmap};

/// `TMPFS_MAGIC`: memory of ordinary pages. (That of huge pages can fail when it is first written to.)
const TMPFS: i64 = 0x0102_1994;

/// A mapped piece of shared memory.
///
/// The other process may write to it at any time; so what is in it is never trusted, only shown.
#[derive(Debug)]
pub struct Memory {
    start: NonNull<u8>,
    len: usize,
}

// SAFETY: the mapping belongs to this value alone within this process, and any thread may use or unmap it.
unsafe impl Send for Memory {}

impl Memory {
    /// Maps the first `len` bytes of a memfd, to read and write.
    ///
    /// # Errors
    /// Where it is no memfd of ordinary memory, its size is not sealed, it is smaller than `len`, or it must not be written to: such
    /// memory could be taken away while it is drawn into.
    pub fn map(fd: impl AsFd, len: usize) -> io::Result<Self> {
        let refuse = |what: &str| Err(io::Error::new(io::ErrorKind::InvalidInput, what));
        let Ok(seals) = fcntl_get_seals(&fd) else { return refuse("no memfd") };
        if !seals.contains(SealFlags::SHRINK) {
            return refuse("its size is not sealed (F_SEAL_SHRINK)");
        }
        if fstatfs(&fd)?.f_type as i64 != TMPFS {
            return refuse("not of ordinary memory");
        }
        let size = fstat(&fd)?.st_size;
        if len == 0 || u64::try_from(size).is_ok_and(|size| size < len as u64) {
            return refuse("smaller than a picture");
        }
        // SAFETY: a new mapping at a place that the kernel chooses touches nothing that exists. The file cannot become shorter than the
        // mapping: its size is sealed, and was compared after that was known.
        let start = unsafe { mmap(std::ptr::null_mut(), len, ProtFlags::READ | ProtFlags::WRITE, MapFlags::SHARED, &fd, 0)? };
        NonNull::new(start.cast()).map(|start| Self { start, len }).ok_or_else(|| Errno::NOMEM.into())
    }

    /// What is in it.
    pub fn bytes(&self) -> &[u8] {
        // SAFETY: mapped to read for `len` bytes as long as this lives; any byte is a valid u8. Another process may change them meanwhile:
        // then they are another picture's, and nothing but what is shown depends on them.
        unsafe { std::slice::from_raw_parts(self.start.as_ptr(), self.len) }
    }

    /// To be drawn into.
    pub fn bytes_mut(&mut self) -> &mut [u8] {
        // SAFETY: as above, and mapped to write; within this process this value is the only way to the mapping.
        unsafe { std::slice::from_raw_parts_mut(self.start.as_ptr(), self.len) }
    }
}

impl Drop for Memory {
    fn drop(&mut self) {
        // SAFETY: mapped by `map` with this length, and no reference into it is left: each borrows this value.
        let _ = unsafe { munmap(self.start.as_ptr().cast(), self.len) };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rustix::fs::{MemfdFlags, fcntl_add_seals, ftruncate, memfd_create};
    use std::os::fd::OwnedFd;

    fn memfd(size: u64, seals: SealFlags) -> OwnedFd {
        let fd = memfd_create(c"test", MemfdFlags::CLOEXEC | MemfdFlags::ALLOW_SEALING).unwrap();
        ftruncate(&fd, size).unwrap();
        fcntl_add_seals(&fd, seals).unwrap();
        fd
    }

    #[test]
    fn two_maps_of_one_memfd_show_the_same() {
        let fd = memfd(5000, SealFlags::SHRINK);
        let (mut one, two) = (Memory::map(&fd, 5000).unwrap(), Memory::map(&fd, 5000).unwrap());
        one.bytes_mut()[4999] = 7;
        assert_eq!((two.bytes()[4999], two.bytes().len()), (7, 5000));
    }

    #[test]
    fn memory_that_could_be_taken_away_is_refused() {
        let refused = |fd: OwnedFd, len: usize| Memory::map(&fd, len).unwrap_err().to_string();
        assert!(refused(memfd(4096, SealFlags::GROW), 4096).contains("not sealed"));
        assert!(refused(memfd(4095, SealFlags::SHRINK), 4096).contains("smaller"));
        assert!(refused(memfd(4096, SealFlags::SHRINK), 0).contains("smaller"));
        let file = std::fs::File::open("/proc/self/exe").unwrap();
        assert!(refused(file.into(), 10).contains("no memfd"));
        let read_only = memfd(4096, SealFlags::SHRINK | SealFlags::WRITE);
        assert!(Memory::map(&read_only, 4096).is_err(), "it must not be written to");
        // A sealed size cannot be changed by who has the other descriptor.
        let fd = memfd(4096, SealFlags::SHRINK);
        let _mapped = Memory::map(&fd, 4096).unwrap();
        assert!(ftruncate(&fd, 0).is_err());
    }
}
