//! Small pictures of before and after for pages: input and output of a frame as one JPEG.

use crate::device::video::Jpeg;
use crate::image::{Picture, PictureRef, PlaneMut, Sampling};
use crate::kernel::shrink;

/// An encoded pair.
#[derive(Clone, Debug)]
pub struct EncodedPair {
    /// Width and height of each of both pictures.
    pub size: [usize; 2],
    /// Width and height of the input.
    pub input: [usize; 2],
    /// Both pictures, the output above the input.
    pub jpeg: Vec<u8>,
}

/// Makes pairs small and encodes them. Keeps its buffers.
#[derive(Debug)]
pub struct PairEncoder {
    jpeg: Jpeg,
    widest: usize,
    pair: Picture,
}

impl PairEncoder {
    /// An encoder for pictures of at most `widest` pixels' width, with JPEG `quality` 1 to 100.
    ///
    /// # Errors
    /// What libjpeg-turbo reports.
    pub fn new(widest: usize, quality: i32) -> Result<Self, String> {
        Ok(Self { jpeg: Jpeg::new(quality)?, widest, pair: Picture::default() })
    }

    /// Encodes both pictures as one JPEG, the output above the input, which is cropped or padded to the output's size. Both are reduced by
    /// the same whole number.
    ///
    /// # Errors
    /// What libjpeg-turbo reports, and pictures of less than two pixels.
    pub fn encode(&mut self, output: PictureRef<'_>, input: PictureRef<'_>) -> Result<EncodedPair, String> {
        let factor = factor(output, self.widest);
        // Even, so that both have whole samples of chroma.
        let [width, height] = [output.width(), output.height()].map(|side| (side / factor) & !1);
        if width == 0 || height == 0 {
            return Err("the picture is too small to show".into());
        }
        self.pair.reshape(Sampling::S420, width, 2 * height);
        let mut pair = self.pair.as_mut();
        for (index, plane) in pair.planes.iter_mut().enumerate() {
            for (half, picture) in [output, input].into_iter().enumerate() {
                reduce(picture, index, factor, plane, [half, 2]);
            }
        }
        let jpeg = self.jpeg.encode(self.pair.as_ref())?.to_vec();
        Ok(EncodedPair { size: [width, height], input: [input.width(), input.height()], jpeg })
    }
}

/// `picture` in 4:2:0, reduced by a whole number to at most `widest` pixels' width.
pub(super) fn reduced(picture: PictureRef<'_>, widest: usize) -> Picture {
    let factor = factor(picture, widest);
    let mut small = Picture::new(Sampling::S420, picture.width() / factor, picture.height() / factor);
    for (index, plane) in small.as_mut().planes.iter_mut().enumerate() {
        reduce(picture, index, factor, plane, [0, 1]);
    }
    small
}

fn factor(picture: PictureRef<'_>, widest: usize) -> usize {
    picture.width().div_ceil(widest.max(1)).max(1)
}

/// Draws a reduced plane into one of `parts` equal parts of `into`, from top to bottom; what it does not reach is black.
fn reduce(picture: PictureRef<'_>, index: usize, factor: usize, into: &mut PlaneMut<'_>, [part, parts]: [usize; 2]) {
    let rows = into.height() / parts;
    let rows = part * rows..(part + 1) * rows;
    let black = if index == 0 { 16 } else { 128 };
    rows.clone().for_each(|row| into.row_mut(row).fill(black));
    let from = picture.planes[index];
    if from.width() > 0 {
        // How many chroma samples are averaged for one of 4:2:0.
        let (across, down) = match picture.sampling.shift() {
            Some((x, y)) if index > 0 => (2 >> x, 2 >> y),
            _ => (1, 1),
        };
        shrink::boxes(from, (factor * across, factor * down), into, rows);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grey(width: usize, height: usize, luma: u8) -> Picture {
        let mut picture = Picture::new(Sampling::S422, width, height);
        picture.as_mut().planes.iter_mut().zip([luma, 90, 160]).for_each(|(plane, value)| plane.fill(value));
        picture
    }

    #[test]
    fn the_output_stands_above_the_input() {
        let mut encoder = PairEncoder::new(960, 80).unwrap();
        let encoded = encoder.encode(grey(1280, 720, 60).as_ref(), grey(1281, 719, 200).as_ref()).unwrap();
        assert_eq!((encoded.size, encoded.input), ([640, 360], [1281, 719]));
        assert_eq!((encoder.pair.width(), encoder.pair.height()), (640, 720));
        let luma = encoder.pair.luma();
        assert_eq!((luma.at(5, 5), luma.at(639, 359), luma.at(5, 365), luma.at(639, 715)), (60, 60, 200, 200));
        assert_eq!((encoder.pair.as_ref().planes[1].at(3, 3), encoder.pair.as_ref().planes[2].at(300, 350)), (90, 160));
        assert!(encoder.encode(grey(1, 1, 60).as_ref(), grey(1, 1, 60).as_ref()).is_err());
    }

    #[test]
    fn a_picture_is_reduced_to_the_width_that_fits() {
        let small = reduced(grey(1920, 1080, 77).as_ref(), 720);
        assert_eq!((small.width(), small.height(), small.luma().at(639, 359)), (640, 360, 77));
        assert_eq!((small.as_ref().planes[1].at(319, 179), small.as_ref().planes[2].at(0, 0)), (90, 160));
        assert_eq!(reduced(grey(640, 480, 1).as_ref(), 720).width(), 640);
    }
}
