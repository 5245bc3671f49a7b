//! A fault planted on purpose, to show that one in the C decoder would be noticed.

use turbojpeg::raw;

/// Tells the C decoder that a JPEG is longer than its memory. AddressSanitizer ends the program where the decoder reads on.
pub fn over_read(_: &[u8]) {
    // SOI, then the beginning of a quantization table
    let jpeg: Box<[u8]> = Box::new([0xff, 0xd8, 0xff, 0xdb, 0, 67, 0, 16, 11]);
    let claimed = jpeg.len() + 62;
    // SAFETY: none; this is the fault. The handle is made here and not used after.
    unsafe {
        let handle = raw::tj3Init(raw::TJINIT_TJINIT_DECOMPRESS as _);
        raw::tj3DecompressHeader(handle, jpeg.as_ptr(), claimed as _);
        raw::tj3Destroy(handle);
    }
}
