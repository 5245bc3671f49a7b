//! Memory between two pages that may not be touched.

use std::marker::PhantomData;
use std::ptr::{self, NonNull};

use rustix::mm::{MapFlags, MprotectFlags, ProtFlags, mmap_anonymous, mprotect, munmap};

/// Which end of a slice lies at a forbidden page.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Edge {
    /// The page before its first byte is forbidden.
    Start,
    /// The page after its last byte is.
    End,
}

/// Room for values with a forbidden page on either side.
pub struct Fenced<T> {
    mapping: NonNull<u8>,
    /// Bytes of the mapping, both forbidden pages included.
    mapped: usize,
    values: PhantomData<T>,
}

/// At least a page, on every machine that Linux runs on.
const PAGE: usize = 1 << 16;

impl<T: Copy> Fenced<T> {
    /// Room for at least `capacity` values.
    pub fn new(capacity: usize) -> Self {
        let mapped = (capacity * size_of::<T>()).next_multiple_of(PAGE).max(PAGE) + 2 * PAGE;
        let access = ProtFlags::READ | ProtFlags::WRITE;
        // SAFETY: a new mapping, at a place that the kernel chooses, touches no other memory.
        let mapping = unsafe { mmap_anonymous(ptr::null_mut(), mapped, access, MapFlags::PRIVATE) }.expect("memory");
        for page in [mapping, mapping.wrapping_byte_add(mapped - PAGE)] {
            // SAFETY: the page lies in our mapping, and no reference to it was ever made.
            unsafe { mprotect(page, PAGE, MprotectFlags::empty()) }.expect("a page can be forbidden");
        }
        Self { mapping: NonNull::new(mapping.cast()).expect("a mapping is not at 0"), mapped, values: PhantomData }
    }

    /// `len` values that lie at the forbidden page before or after them; value `i` is what `value` says.
    pub fn filled(&mut self, edge: Edge, len: usize, mut value: impl FnMut(usize) -> T) -> &mut [T] {
        let (bytes, room) = (len * size_of::<T>(), self.mapped - 2 * PAGE);
        assert!(bytes <= room, "{len} values are more than there is room for");
        let offset = if edge == Edge::Start { PAGE } else { PAGE + room - bytes };
        // SAFETY: the offset lies within the mapping.
        let first: *mut T = unsafe { self.mapping.add(offset) }.as_ptr().cast();
        assert!(first.is_aligned());
        for i in 0..len {
            // SAFETY: `len` values from `first` on lie in the part that may be written, aligned, and are ours alone.
            unsafe { first.add(i).write(value(i)) };
        }
        // SAFETY: as above; each was just written, and they stay borrowed as long as `self`.
        unsafe { std::slice::from_raw_parts_mut(first, len) }
    }
}

impl<T> Drop for Fenced<T> {
    fn drop(&mut self) {
        // SAFETY: our own mapping; nothing that was lent of it is left.
        let _ = unsafe { munmap(self.mapping.as_ptr().cast(), self.mapped) };
    }
}

/// The kernel refuses to read from the byte before and the byte after; those between are what was written.
#[test]
fn what_lies_beside_is_forbidden() {
    let (reader, writer) = std::io::pipe().unwrap();
    let readable = |at: *const u8| {
        // SAFETY: the kernel checks the address itself, and says EFAULT where it may not be read.
        let written = unsafe { libc::write(std::os::fd::AsRawFd::as_raw_fd(&writer), at.cast(), 1) };
        written == 1 || {
            assert_eq!(std::io::Error::last_os_error().raw_os_error(), Some(libc::EFAULT));
            false
        }
    };
    for len in [1, 40, PAGE - 1, PAGE] {
        let mut memory = Fenced::new(len);
        for edge in [Edge::Start, Edge::End] {
            let values = memory.filled(edge, len, |i| i as u8);
            assert!(values.iter().enumerate().all(|(i, &value)| value == i as u8));
            let range = values.as_ptr_range();
            let (before, last) = (range.start.wrapping_sub(1), range.end.wrapping_sub(1));
            assert!(readable(range.start) && readable(last));
            match edge {
                Edge::Start => assert!(!readable(before)),
                Edge::End => assert!(!readable(range.end)),
            }
        }
    }
    drop(reader);
}
