//! A sink that stores one digest per picture, so that tests can compare runs.

use super::{DeviceError, FrameSink, Output, StreamFormat};
use crate::frame::Stamp;
use crate::image::{Picture, PictureMut, PictureRef};

/// A running 64-bit hash, not meant to withstand an adversary. Each step is a bijection of the state, so a change in a single
/// word always shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Hash(u64);

impl Default for Hash {
    fn default() -> Self {
        // Digits of pi.
        Self(0x243f_6a88_85a3_08d3)
    }
}

impl Hash {
    /// Takes in a number.
    #[inline]
    pub fn number(&mut self, word: u64) {
        // An odd multiplier (the golden ratio's digits), then high bits down to low ones.
        let mixed = (self.0 ^ word).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        self.0 = mixed ^ (mixed >> 32);
    }

    /// Takes in bytes and how many they are.
    pub fn bytes(&mut self, bytes: &[u8]) {
        let (words, rest) = bytes.as_chunks::<8>();
        for word in words {
            self.number(u64::from_le_bytes(*word));
        }
        let mut last = [0; 8];
        last[..rest.len()].copy_from_slice(rest);
        self.number(u64::from_le_bytes(last));
        self.number(bytes.len() as u64);
    }

    /// Takes in a picture: its shape and its visible samples; how rows are padded makes no difference.
    pub fn picture(&mut self, picture: PictureRef<'_>) {
        for plane in picture.planes {
            self.number(plane.width() as u64);
            self.number(plane.height() as u64);
            for row in 0..plane.height() {
                self.bytes(plane.row(row));
            }
        }
    }

    /// The hash of what was taken in so far.
    pub fn value(self) -> u64 {
        self.0
    }
}

/// Hashes every picture with its time.
#[derive(Debug)]
pub struct DigestSink {
    format: StreamFormat,
    canvas: Picture,
    lines: Option<Output>,
    submitted: u64,
    last: Hash,
    total: Hash,
}

impl DigestSink {
    /// For pictures of frames of `format`.
    pub fn new(format: &StreamFormat) -> Self {
        let (format, canvas) = (format.planar(), format.picture());
        Self { format, canvas, lines: None, submitted: 0, last: Hash::default(), total: Hash::default() }
    }

    /// Also writes a line per picture to `lines`: its number, its time in nanoseconds, its digest; and [`Self::text`] at the end.
    pub fn with_lines(mut self, lines: Output) -> Self {
        self.lines = Some(lines);
        self
    }

    /// Digest of the last picture and its time.
    pub fn last(&self) -> u64 {
        self.last.value()
    }

    /// Digest of all pictures and times so far, their order included.
    pub fn total(&self) -> u64 {
        self.total.value()
    }

    /// Pictures taken so far.
    pub fn submitted(&self) -> u64 {
        self.submitted
    }

    /// The total in words: `24 frames 400x300 0123456789abcdef`.
    pub fn text(&self) -> String {
        format!("{} frames {}x{} {:016x}", self.submitted, self.format.width, self.format.height, self.total())
    }
}

impl FrameSink for DigestSink {
    fn format(&self) -> StreamFormat {
        self.format
    }

    fn canvas(&mut self) -> Result<PictureMut<'_>, DeviceError> {
        Ok(self.canvas.as_mut())
    }

    fn submit(&mut self, stamp: &Stamp) -> Result<(), DeviceError> {
        self.last = Hash::default();
        self.last.number(stamp.time_ns as u64);
        self.last.picture(self.canvas.as_ref());
        self.total.number(self.last.value());
        if let Some(lines) = &mut self.lines {
            let line = format!("{} {} {:016x}\n", self.submitted, stamp.time_ns, self.last.value());
            lines.write(line.as_bytes())?;
        }
        self.submitted += 1;
        Ok(())
    }

    fn finish(&mut self) -> Result<(), DeviceError> {
        let text = self.text();
        match &mut self.lines {
            Some(lines) => lines.write(format!("{text}\n").as_bytes()).and_then(|()| lines.flush()),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::{PixelFormat, PlaneRef, Sampling};

    #[test]
    fn a_digest_sees_every_sample_and_the_time_and_the_order() {
        let format = StreamFormat::tight(6, 4, PixelFormat::I420, (1, 30));
        let digest = |samples: &[(usize, usize, usize, u8)], times: &[i64]| {
            let mut sink = DigestSink::new(&format);
            for &time_ns in times {
                for &(plane, x, y, value) in samples {
                    sink.canvas().unwrap().planes[plane].row_mut(y)[x] = value;
                }
                sink.submit(&Stamp { time_ns, ..Stamp::default() }).unwrap();
            }
            sink.total()
        };
        let base = digest(&[], &[0, 1]);
        assert_eq!(base, digest(&[], &[0, 1]));
        assert_ne!(base, digest(&[], &[1, 0]));
        assert_ne!(base, digest(&[], &[0]));
        for (plane, (width, height)) in [(6, 4), (3, 2), (3, 2)].into_iter().enumerate() {
            for (x, y) in (0..height).flat_map(|y| (0..width).map(move |x| (x, y))) {
                assert_ne!(base, digest(&[(plane, x, y, 1)], &[0, 1]), "plane {plane} at {x}, {y}");
            }
        }
    }

    #[test]
    fn padding_makes_no_difference() {
        let (tight, padded) = ([1, 2, 3, 4], [1, 2, 9, 3, 4, 9]);
        let empty = PlaneRef::new(&[], 0, 0, 0).unwrap();
        let digest = |bytes: &[u8], stride| {
            let mut hash = Hash::default();
            let luma = PlaneRef::new(bytes, 2, 2, stride).unwrap();
            hash.picture(PictureRef { sampling: Sampling::Mono, planes: [luma, empty, empty] });
            hash.value()
        };
        assert_eq!(digest(&tight, 2), digest(&padded, 3));
    }
}
