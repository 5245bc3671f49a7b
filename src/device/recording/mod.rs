//! gimbald's recordings (`.gbr`): raw frames as the camera delivered them, each with its time, sequence number and flags.
//!
//! # The format, version 1
//! All numbers are little-endian. A file is a head and then records until it ends; it can be written to a pipe and read from one.
//! A recorder that is killed leaves a file that ends within a record; all records before that one are whole.
//!
//! ```text
//! head (16 bytes)
//!    0  8 bytes  89 'G' 'B' 'R' 0d 0a 1a 0a
//!    8  u16      version, 1
//!   10  u16      0
//!   12  u32      CRC-32 of bytes 0 to 11
//!
//! record: a header (36 bytes), then its payload
//!    0  4 bytes  kind: "FORM" or "FRAM"
//!    4  u32      bytes of payload
//!    8  i64      FRAM: capture time of the first row, nanoseconds, on the source's clock; FORM: 0
//!   16  u64      FRAM: the source's sequence number; FORM: 0
//!   24  u32      FRAM: flags, 1 = marked as damaged by the driver, 2 = shorter than it should be; FORM: 0
//!   28  u32      CRC-32 of the payload
//!   32  u32      CRC-32 of header bytes 0 to 31
//!
//! payload of FORM: the format of the frames that follow, up to the next FORM. The first record is one.
//!    0  4 bytes  pixel format, V4L2's four characters: YUYV UYVY NV12 YU12 422P 444P GREY RGB3 BGR3 MJPG
//!    4  u32      width, pixels, 1 to 8192
//!    8  u32      height, rows, 1 to 8192; of MJPG at most 7680 x 4320 pixels in all
//!   12  u32      bytes from one row of the first plane to the next (chroma rows in proportion, as V4L2 has it); 0 for MJPG
//!   16  2 u32    nominal time between frames, seconds, numerator and denominator
//!   24  2 u32    shape of a sample, width and height; 0 0 unknown
//!   32  u8       range of samples: 0 unknown, 1 limited, 2 full
//!   33  u8       place of 4:2:0 chroma: 0 in the middle, 1 left, 2 top left
//!   34  u16      bytes of the device's name, at most 255
//!   36           the device's name, UTF-8
//!
//! payload of FRAM: the frame's bytes. At most twice what the format needs and 64 KiB (MJPG: four bytes a pixel and 64 KiB).
//! ```
//!
//! CRC-32 is that of PNG and gzip. A reader skips records of a kind it does not know whose payload is at most 1 MiB. A frame
//! whose payload fails its CRC is given with the flag "damaged", and reading goes on; any other damage ends the recording with an
//! error that names the byte and the frame. A reader refuses versions it does not know.

mod reader;
mod record;
mod writer;

#[cfg(test)]
mod tests;

pub use reader::RecordingSource;
pub use writer::{RecordingSink, RecordingWriter};

/// What a recording begins with.
pub(super) const MAGIC: &[u8; 8] = b"\x89GBR\r\n\x1a\n";
