//! A video that repeats a clip which is too short to be watched once.

use crate::device::{DeviceError, FrameSink, StreamFormat};
use crate::frame::Stamp;
use crate::image::{Picture, PictureMut};

/// Hands pictures on, and at the end all of them again until each was sent `times` times. For that it keeps them in memory: for short clips.
#[derive(Debug)]
pub(super) struct Repeated<S> {
    inner: S,
    times: u32,
    canvas: Picture,
    sent: Vec<(Stamp, Picture)>,
}

impl<S: FrameSink> Repeated<S> {
    /// Sends everything to `inner` `times` times.
    pub(super) fn new(inner: S, times: u32) -> Self {
        let canvas = inner.format().picture();
        Self { inner, times, canvas, sent: Vec::new() }
    }
}

/// Sends a picture.
fn send(sink: &mut impl FrameSink, stamp: &Stamp, picture: &Picture) -> Result<(), DeviceError> {
    sink.canvas()?.planes.iter_mut().zip(picture.as_ref().planes).for_each(|(to, from)| to.copy_from(from));
    sink.submit(stamp)
}

impl<S: FrameSink> FrameSink for Repeated<S> {
    fn format(&self) -> StreamFormat {
        self.inner.format()
    }

    fn canvas(&mut self) -> Result<PictureMut<'_>, DeviceError> {
        Ok(self.canvas.as_mut())
    }

    fn submit(&mut self, stamp: &Stamp) -> Result<(), DeviceError> {
        send(&mut self.inner, stamp, &self.canvas)?;
        if self.times > 1 {
            self.sent.push((*stamp, self.canvas.clone()));
        }
        Ok(())
    }

    fn finish(&mut self) -> Result<(), DeviceError> {
        if let (Some((first, _)), Some((last, _))) = (self.sent.first(), self.sent.last()) {
            let frame_ns = self.inner.format().nominal_time_ns(1);
            let length_ns = last.time_ns.saturating_sub(first.time_ns).saturating_add(frame_ns);
            for n in 1..self.times {
                for (stamp, picture) in &self.sent {
                    let time_ns = stamp.time_ns.saturating_add(i64::from(n).saturating_mul(length_ns));
                    send(&mut self.inner, &Stamp { time_ns, ..*stamp }, picture)?;
                }
            }
        }
        self.inner.finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::PixelFormat;

    /// Notes time and first sample of what it is sent.
    struct Noting(StreamFormat, Picture, Vec<(i64, u8)>);

    impl FrameSink for Noting {
        fn format(&self) -> StreamFormat {
            self.0
        }

        fn canvas(&mut self) -> Result<PictureMut<'_>, DeviceError> {
            Ok(self.1.as_mut())
        }

        fn submit(&mut self, stamp: &Stamp) -> Result<(), DeviceError> {
            self.2.push((stamp.time_ns, self.1.luma().at(0, 0)));
            Ok(())
        }
    }

    #[test]
    fn the_clip_follows_itself_without_a_gap() {
        let format = StreamFormat::tight(4, 4, PixelFormat::I420, (1, 10));
        let mut sink = Repeated::new(Noting(format, format.picture(), Vec::new()), 3);
        for n in 0..2u8 {
            sink.canvas().unwrap().planes[0].fill(n);
            sink.submit(&Stamp { time_ns: 7 + i64::from(n) * 100_000_000, ..Stamp::default() }).unwrap();
        }
        sink.finish().unwrap();
        let expected: Vec<(i64, u8)> = (0..6).map(|n| (7 + n * 100_000_000, (n % 2) as u8)).collect();
        assert_eq!(sink.inner.2, expected);
        let mut once = Repeated::new(Noting(format, format.picture(), Vec::new()), 1);
        once.submit(&Stamp::default()).unwrap();
        once.finish().unwrap();
        assert!(once.inner.2.len() == 1 && once.sent.is_empty(), "nothing is kept of what is not repeated");
        let mut nothing = Repeated::new(Noting(format, format.picture(), Vec::new()), 3);
        nothing.finish().unwrap();
        assert!(nothing.inner.2.is_empty());
    }
}
