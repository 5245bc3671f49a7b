//! Matroska streams of raw pictures, each with its own time: the form in which ffmpeg takes them from a pipe.
//!
//! An EBML element is its number, its size and its content (RFC 8794, RFC 9559). The segment's size is left open, so that a stream can
//! be written to a pipe; each picture is a cluster of its own, which gives it a time of its own.

use std::io::{self, Write};

use crate::device::StreamFormat;
use crate::image::PixelFormat;

/// Nanoseconds of a unit of time: microseconds.
const TICK_NS: i64 = 1000;
/// A size that is not known yet, of eight bytes.
const OPEN: [u8; 8] = [1, 255, 255, 255, 255, 255, 255, 255];
/// Pictures follow one another in one cluster's time at most: each has its own.
const SAME_TIME: [u8; 2] = [0, 0];
const KEY_FRAME: u8 = 0x80;

/// Writes one stream.
#[derive(Debug)]
pub(super) struct Matroska<W> {
    out: W,
}

impl<W: Write> Matroska<W> {
    /// Begins a stream of pictures of `format`, which is planar.
    ///
    /// # Errors
    /// What `out` reports.
    pub(super) fn new(mut out: W, format: &StreamFormat) -> io::Result<Self> {
        out.write_all(&head(format))?;
        Ok(Self { out })
    }

    /// Adds a picture's bytes, `time_ns` nanoseconds (not negative) after the stream's beginning.
    ///
    /// # Errors
    /// What the stream reports.
    pub(super) fn add(&mut self, picture: &[u8], time_ns: i64) -> io::Result<()> {
        let time = element(0xE7, &unsigned(time_ns.max(0) / TICK_NS));
        let block_head = [&[0x81], &SAME_TIME[..], &[KEY_FRAME]].concat();
        let block_len = (block_head.len() + picture.len()) as u64;
        let block = [&number(0xA3)[..], &size(block_len)].concat();
        let cluster_len = time.len() as u64 + block.len() as u64 + block_len;
        self.out.write_all(&number(0x1F43_B675))?;
        self.out.write_all(&size(cluster_len))?;
        for part in [&time[..], &block, &block_head, picture] {
            self.out.write_all(part)?;
        }
        Ok(())
    }

    /// Hands on what is buffered. There is nothing to add at the end.
    ///
    /// # Errors
    /// What the stream reports.
    pub(super) fn finish(&mut self) -> io::Result<()> {
        self.out.flush()
    }
}

/// All that comes before the first cluster.
fn head(format: &StreamFormat) -> Vec<u8> {
    let kind = b"matroska";
    let ebml = [
        element(0x4286, &[1]),
        element(0x42F7, &[1]),
        element(0x42F2, &[4]),
        element(0x42F3, &[8]),
        element(0x4282, kind),
        element(0x4287, &[4]),
        element(0x4285, &[2]),
    ];
    let info = [element(0x2A_D7B1, &unsigned(TICK_NS)), element(0x4D80, b"gimbald"), element(0x5741, b"gimbald")];
    let picture = [
        element(0xB0, &unsigned(i64::from(format.width))),
        element(0xBA, &unsigned(i64::from(format.height))),
        element(0x2E_B524, colour_space(format.pixel)),
    ];
    let mut track = vec![
        element(0xD7, &[1]),
        element(0x73C5, &[1]),
        element(0x83, &[1]),
        element(0x9C, &[0]),
        element(0x86, b"V_UNCOMPRESSED"),
        element(0xE0, &picture.concat()),
    ];
    if format.rate() > 0.0 {
        track.push(element(0x23_E383, &unsigned((1e9 / format.rate()) as i64)));
    }
    let track = element(0xAE, &track.concat());
    let segment = [&number(0x1853_8067)[..], &OPEN].concat();
    [element(0x1A45_DFA3, &ebml.concat()), segment, element(0x1549_A966, &info.concat()), element(0x1654_AE6B, &track)].concat()
}

/// The four characters by which readers know raw pictures.
fn colour_space(pixel: PixelFormat) -> &'static [u8] {
    match pixel {
        PixelFormat::Grey => b"Y800",
        PixelFormat::I422 => b"Y42B",
        PixelFormat::I444 => b"444P",
        _ => b"I420",
    }
}

fn element(name: u32, content: &[u8]) -> Vec<u8> {
    [&number(name)[..], &size(content.len() as u64), content].concat()
}

/// An element's name: its bytes without leading zeros.
fn number(name: u32) -> Vec<u8> {
    name.to_be_bytes().into_iter().skip_while(|byte| *byte == 0).collect()
}

/// An element's size, in eight bytes.
fn size(len: u64) -> [u8; 8] {
    (len | 1 << 56).to_be_bytes()
}

/// A whole number's bytes without leading zeros, one at least.
fn unsigned(value: i64) -> Vec<u8> {
    let bytes = value.max(0).to_be_bytes();
    let zeros = bytes.iter().take(7).take_while(|byte| **byte == 0).count();
    bytes[zeros..].to_vec()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_those_of_the_standard() {
        assert_eq!(number(0xA3), [0xA3]);
        assert_eq!(number(0x1A45_DFA3), [0x1A, 0x45, 0xDF, 0xA3]);
        assert_eq!(size(300), [1, 0, 0, 0, 0, 0, 1, 44]);
        assert_eq!((unsigned(0), unsigned(300), unsigned(-5)), (vec![0], vec![1, 44], vec![0]));
        assert_eq!(element(0xB0, &unsigned(320)), [0xB0, 1, 0, 0, 0, 0, 0, 0, 2, 1, 64]);
    }

    #[test]
    fn a_cluster_has_the_size_that_it_says() {
        let format = StreamFormat::tight(4, 2, PixelFormat::I420, (1, 30));
        let mut matroska = Matroska::new(Vec::new(), &format).unwrap();
        let before = matroska.out.len();
        matroska.add(&[7; 12], 33_000_000).unwrap();
        let cluster = &matroska.out[before..];
        assert_eq!(&cluster[..4], [0x1F, 0x43, 0xB6, 0x75]);
        assert_eq!(u64::from_be_bytes(cluster[4..12].try_into().unwrap()) & !(1 << 56), cluster.len() as u64 - 12);
        assert_eq!(cluster[cluster.len() - 12..], [7; 12]);
    }
}
