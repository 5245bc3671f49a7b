//! JPEG encoding with libjpeg-turbo.

use turbojpeg::{Compressor, Subsamp, YuvImage};

use crate::image::{PictureRef, PlaneMut, Sampling, ToFull};
use crate::kernel::convert::{NEUTRAL, to_full};

/// Writes pictures as baseline JPEG of full range, as JFIF has it. Keeps its memory from one picture to the next.
#[derive(Debug)]
pub struct Jpeg {
    compressor: Compressor,
    /// The planes, one after the other, without padding.
    planes: Vec<u8>,
    bytes: Vec<u8>,
}

impl Jpeg {
    /// An encoder of `quality` 1 (poor) to 100.
    ///
    /// # Errors
    /// libjpeg-turbo's words, as where there is no memory.
    pub fn new(quality: i32) -> Result<Self, String> {
        let mut compressor = Compressor::new().map_err(|error| error.to_string())?;
        compressor.set_quality(quality).map_err(|error| error.to_string())?;
        Ok(Self { compressor, planes: Vec::new(), bytes: Vec::new() })
    }

    /// The bytes of `picture` as a JPEG file. Chroma is kept as it is; a picture without any gets grey 4:2:0, since some players show
    /// no JPEG of luma alone.
    ///
    /// # Errors
    /// libjpeg-turbo's words, as where the picture has no pixels.
    pub fn encode(&mut self, picture: PictureRef<'_>) -> Result<&[u8], String> {
        let (width, height) = (picture.width(), picture.height());
        if width == 0 || height == 0 {
            return Err("the picture has no pixels".into());
        }
        let sampling = if picture.sampling == Sampling::Mono { Sampling::S420 } else { picture.sampling };
        let (right, down) = sampling.shift().unwrap_or((0, 0));
        let subsamp = match sampling {
            Sampling::S422 => Subsamp::Sub2x1,
            Sampling::S444 => Subsamp::None,
            _ => Subsamp::Sub2x2,
        };
        // libjpeg-turbo wants luma for every chroma sample, at odd sizes too.
        let luma = (width.next_multiple_of(1 << right), height.next_multiple_of(1 << down));
        let chroma = sampling.chroma_size(width, height);
        let samples = luma.0 * luma.1 + 2 * chroma.0 * chroma.1;
        self.planes.clear();
        self.planes.resize(samples, NEUTRAL);
        let (first, rest) = self.planes.split_at_mut(luma.0 * luma.1);
        let (second, third) = rest.split_at_mut(chroma.0 * chroma.1);
        let shapes = [(first, luma, ToFull::LUMA), (second, chroma, ToFull::CHROMA), (third, chroma, ToFull::CHROMA)];
        for (from, (samples, (across, rows), map)) in picture.planes.into_iter().zip(shapes) {
            if let Some(into) = PlaneMut::new(samples, across, rows, across) {
                to_full(map, from, into);
            }
        }
        self.compressor.set_subsamp(subsamp).map_err(|error| error.to_string())?;
        let most = self.compressor.buf_len(width, height).map_err(|error| error.to_string())?;
        if self.bytes.len() < most {
            self.bytes.resize(most, 0);
        }
        let image = YuvImage { pixels: &self.planes[..], width, align: 1, height, subsamp };
        let len = self.compressor.compress_yuv_to_slice(image, &mut self.bytes).map_err(|error| error.to_string())?;
        Ok(&self.bytes[..len])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Picture;

    /// What is written is what gimbald's own decoder, which knows JPEG's range, reads back.
    #[test]
    fn a_picture_comes_back_in_every_sampling_and_odd_size() {
        for sampling in [Sampling::Mono, Sampling::S420, Sampling::S422, Sampling::S444] {
            let (width, height) = (45, 31);
            let mut picture = Picture::new(sampling, width, height);
            for (index, plane) in picture.as_mut().planes.iter_mut().enumerate() {
                let (columns, rows) = (plane.width(), plane.height());
                for y in 0..rows {
                    for (x, out) in plane.row_mut(y).iter_mut().enumerate() {
                        *out = (16 + 60 * index + (2 * x + y) * 90 / (2 * columns + rows)) as u8;
                    }
                }
            }
            let mut jpeg = Jpeg::new(97).unwrap();
            let bytes = jpeg.encode(picture.as_ref()).unwrap();
            let mut decoder = jpeg_decoder::Decoder::new(bytes);
            let rgb = decoder.decode().unwrap();
            let about = decoder.info().unwrap();
            assert_eq!((about.width, about.height), (width as u16, height as u16));
            for (x, y) in [(3, 4), (40, 2), (44, 30), (20, 15)] {
                let shift = sampling.shift();
                let chroma = |plane: usize| match shift {
                    Some((right, down)) => picture.as_ref().planes[plane].at(x >> right, y >> down),
                    None => NEUTRAL,
                };
                let wanted = crate::image::rgb([picture.luma().at(x, y), chroma(1), chroma(2)]);
                let found = &rgb[3 * (y * width + x)..][..3];
                assert!(
                    wanted.iter().zip(found).all(|(a, b)| a.abs_diff(*b) <= 12),
                    "{sampling:?} at {x}, {y}: {wanted:?} became {found:?}"
                );
            }
        }
    }

    #[test]
    fn no_picture_is_an_error() {
        assert!(Jpeg::new(90).unwrap().encode(Picture::new(Sampling::S420, 0, 0).as_ref()).is_err());
        assert!(Jpeg::new(0).is_err());
    }
}
