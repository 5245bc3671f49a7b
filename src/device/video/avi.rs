//! AVI files with one MJPEG stream: RIFF chunks, which every player reads.
//!
//! ```text
//! RIFF 'AVI '
//!   LIST 'hdrl'   avih, then LIST 'strl': strh, strf (a BITMAPINFOHEADER)
//!   LIST 'movi'   '00dc' chunks, a picture each; an empty one shows the picture before for another interval
//!   idx1          each chunk's place and size
//! ```
//!
//! Frames stand at a fixed rate: one that comes late leaves empty chunks before it. (Microsoft, "AVI RIFF File Reference".)

use std::io::{self, Seek, SeekFrom, Write};

use crate::device::StreamFormat;

/// Bytes of all that stands before the list's first chunk.
const HEAD: usize = 224;
/// Where sizes and counts stand that are known at the end.
const RIFF_SIZE: u64 = 4;
const FRAMES: u64 = 48;
const LENGTH: u64 = 140;
const MOVI_SIZE: u64 = 216;
/// Players read sizes as signed numbers of 32 bits.
const LARGEST: u64 = i32::MAX as u64;
/// Bytes of an entry of the index.
const ENTRY: u64 = 16;
/// Empty chunks before a frame, at most: after a longer pause the stream goes on at once.
const LONGEST_PAUSE: u64 = 600;
/// A frame that can be decoded alone.
const KEY_FRAME: u32 = 0x10;

/// Writes one file.
#[derive(Debug)]
pub(super) struct Avi<W> {
    out: W,
    /// Place of each chunk, from the list's name on, and its size.
    index: Vec<(u32, u32)>,
    /// Bytes of the list's chunks.
    filled: u64,
    interval_ns: f64,
}

impl<W: Write + Seek> Avi<W> {
    /// Begins a file for pictures of `format`'s size and rate.
    ///
    /// # Errors
    /// What `out` reports.
    pub(super) fn new(mut out: W, format: &StreamFormat) -> io::Result<Self> {
        let interval = if format.interval.0 > 0 && format.interval.1 > 0 { format.interval } else { (1, 30) };
        out.write_all(&head(format.width, format.height, interval))?;
        let interval_ns = 1e9 * f64::from(interval.0) / f64::from(interval.1);
        Ok(Self { out, index: Vec::new(), filled: 0, interval_ns })
    }

    /// Adds the picture `jpeg`, `time_ns` nanoseconds after the first one.
    ///
    /// # Errors
    /// What the file reports; where it would have more than 2 GiB, as AVI cannot.
    pub(super) fn add(&mut self, jpeg: &[u8], time_ns: i64) -> io::Result<()> {
        let place = (time_ns as f64 / self.interval_ns).round().max(0.0) as u64;
        let next = self.index.len() as u64;
        for _ in 0..place.saturating_sub(next).min(LONGEST_PAUSE) {
            self.chunk(&[])?;
        }
        self.chunk(jpeg)
    }

    fn chunk(&mut self, bytes: &[u8]) -> io::Result<()> {
        let padded = bytes.len().next_multiple_of(2) as u64;
        if HEAD as u64 + self.filled + padded + ENTRY * (self.index.len() as u64 + 2) > LARGEST {
            let what = "an AVI file cannot have more than 2 GiB; with ffmpeg installed, name it .mkv";
            return Err(io::Error::new(io::ErrorKind::FileTooLarge, what));
        }
        // The list's own name comes first.
        self.index.push((4 + self.filled as u32, bytes.len() as u32));
        self.out.write_all(b"00dc")?;
        self.out.write_all(&(bytes.len() as u32).to_le_bytes())?;
        self.out.write_all(bytes)?;
        self.out.write_all(&[0][..bytes.len() % 2])?;
        self.filled += 8 + padded;
        Ok(())
    }

    /// Writes the index, and the sizes and counts at the beginning.
    ///
    /// # Errors
    /// What the file reports.
    pub(super) fn finish(&mut self) -> io::Result<()> {
        let entries = self.index.len() as u32;
        self.out.write_all(b"idx1")?;
        self.out.write_all(&(entries * ENTRY as u32).to_le_bytes())?;
        for &(place, len) in &self.index {
            self.out.write_all(b"00dc")?;
            let flags = if len > 0 { KEY_FRAME } else { 0 };
            for number in [flags, place, len] {
                self.out.write_all(&number.to_le_bytes())?;
            }
        }
        let movi = 4 + self.filled as u32;
        let riff = HEAD as u32 - 8 + self.filled as u32 + 8 + entries * ENTRY as u32;
        for (at, number) in [(RIFF_SIZE, riff), (FRAMES, entries), (LENGTH, entries), (MOVI_SIZE, movi)] {
            self.out.seek(SeekFrom::Start(at))?;
            self.out.write_all(&number.to_le_bytes())?;
        }
        self.out.seek(SeekFrom::End(0))?;
        self.out.flush()
    }
}

/// The beginning, with zeros for what is known at the end.
fn head(width: u32, height: u32, (seconds, frames): (u32, u32)) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(HEAD);
    let mut put = |text: &[u8; 4], numbers: &[u32]| {
        bytes.extend_from_slice(text);
        numbers.iter().for_each(|number| bytes.extend_from_slice(&number.to_le_bytes()));
    };
    let interval_us = (1e6 * f64::from(seconds) / f64::from(frames)).round() as u32;
    let has_index = 0x10;
    put(b"RIFF", &[0]);
    put(b"AVI ", &[]);
    put(b"LIST", &[192]);
    put(b"hdrl", &[]);
    put(b"avih", &[56, interval_us, 0, 0, has_index, 0, 0, 1, 0, width, height, 0, 0, 0, 0]);
    put(b"LIST", &[116]);
    put(b"strl", &[]);
    put(b"strh", &[56]);
    put(b"vids", &[]);
    // Flags, priority and language, first frames, scale, rate, start, length, buffer, quality (default), sample size, rectangle.
    put(b"MJPG", &[0, 0, 0, seconds, frames, 0, 0, 0, u32::MAX, 0, 0, (height & 0xffff) << 16 | (width & 0xffff)]);
    put(b"strf", &[40, 40, width, height, 24 << 16 | 1]);
    put(b"MJPG", &[width.saturating_mul(height).saturating_mul(3), 0, 0, 0, 0]);
    put(b"LIST", &[0]);
    put(b"movi", &[]);
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::PixelFormat;
    use std::io::Cursor;

    fn number(bytes: &[u8], at: usize) -> u32 {
        u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap())
    }

    #[test]
    fn every_size_and_place_is_where_it_says() {
        let format = StreamFormat::tight(320, 240, PixelFormat::Mjpeg, (1, 25));
        let mut avi = Avi::new(Cursor::new(Vec::new()), &format).unwrap();
        // The second picture is two intervals late, the third a little early.
        for (jpeg, ms) in [(&b"abc"[..], 0), (b"defg", 121), (b"h", 158)] {
            avi.add(jpeg, ms * 1_000_000).unwrap();
        }
        avi.finish().unwrap();
        let bytes = avi.out.into_inner();
        assert_eq!(bytes.len() as u32 - 8, number(&bytes, 4), "RIFF");
        assert_eq!(&bytes[HEAD - 4..HEAD], b"movi");
        assert_eq!(&bytes[20..24], b"hdrl");
        assert_eq!(&bytes[12 + 8 + 192..][..4], b"LIST", "the size of hdrl");
        assert_eq!(&bytes[20 + 4 + 8 + 56 + 8 + 116..][..4], b"LIST", "the size of strl");
        let movi = HEAD - 4;
        let idx1 = movi + number(&bytes, movi - 4) as usize;
        assert_eq!(&bytes[idx1..idx1 + 4], b"idx1");
        let entries = number(&bytes, idx1 + 4) as usize / 16;
        assert_eq!((entries, number(&bytes, 48), number(&bytes, 140)), (5, 5, 5), "two empty ones");
        let found: Vec<&[u8]> = (0..entries)
            .map(|entry| {
                let at = movi + number(&bytes, idx1 + 8 + 16 * entry + 8) as usize;
                assert_eq!(&bytes[at..at + 4], b"00dc");
                let len = number(&bytes, idx1 + 8 + 16 * entry + 12);
                assert_eq!(len, number(&bytes, at + 4));
                &bytes[at + 8..][..len as usize]
            })
            .collect();
        assert_eq!(found, [&b"abc"[..], b"", b"", b"defg", b"h"]);
        assert_eq!((number(&bytes, 128), number(&bytes, 132)), (1, 25), "scale and rate");
    }

    #[test]
    fn it_ends_before_two_gigabytes() {
        let format = StreamFormat::tight(320, 240, PixelFormat::Mjpeg, (1, 25));
        let mut avi = Avi::new(Cursor::new(Vec::new()), &format).unwrap();
        avi.filled = LARGEST - 1000;
        assert!(avi.chunk(&[0; 500]).is_ok());
        assert!(avi.chunk(&[0; 500]).unwrap_err().to_string().contains(".mkv"));
    }
}
