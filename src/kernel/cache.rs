//! Memory out of the processor's caches: how a frame lies that a camera has just written. For measuring.

/// Bytes that go out of the caches at a time.
#[cfg(target_arch = "x86_64")]
const LINE: usize = 64;

/// Writes `bytes` back to memory and out of all caches, so that the next reader has to fetch them. Does nothing on processors
/// that let no program do so.
pub fn flush(bytes: &[u8]) {
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::x86_64::{_mm_clflush, _mm_mfence};
        for line in bytes.chunks(LINE).chain(bytes.last().map(std::slice::from_ref)) {
            // SAFETY: the address is that of a byte lent to us, and no byte changes; every x86-64 processor has it.
            unsafe { _mm_clflush(line.as_ptr()) };
        }
        // SAFETY: a fence touches nothing; every x86-64 processor has it.
        unsafe { _mm_mfence() };
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = bytes;
}
