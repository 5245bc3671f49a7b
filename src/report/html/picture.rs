//! Pictures inside the page: to RGB, to JPEG, to text.

use image::codecs::jpeg::JpegEncoder;
use image::{ExtendedColorType, ImageEncoder};
use maud::{Markup, html};

use crate::image::{BLACK, PictureRef, PlaneRef, rgb};

const QUALITY: u8 = 85;
const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";

/// A picture as packed RGB, rows from top to bottom.
#[derive(Clone, Debug)]
pub(super) struct Rgb {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) samples: Vec<u8>,
}

impl Rgb {
    /// Takes over a picture.
    pub(super) fn of(picture: PictureRef<'_>) -> Self {
        let (width, height) = (picture.width(), picture.height());
        let shift = picture.sampling.shift();
        let mut samples = Vec::with_capacity(width * height * 3);
        for y in 0..height {
            for x in 0..width {
                let chroma = |plane: usize| match shift {
                    Some((right, down)) => picture.planes[plane].at(x >> right, y >> down),
                    None => BLACK[1],
                };
                samples.extend(rgb([picture.planes[0].at(x, y), chroma(1), chroma(2)]));
            }
        }
        Self { width, height, samples }
    }

    /// The picture as an `<img>` with the data inside; nothing where it has no pixels.
    pub(super) fn img(&self, alt: &str) -> Markup {
        img(&self.samples, self.width, self.height, ExtendedColorType::Rgb8, alt)
    }
}

/// A luma plane as an `<img>`.
pub(super) fn grey_img(plane: PlaneRef<'_>, alt: &str) -> Markup {
    let samples: Vec<u8> = (0..plane.height()).flat_map(|y| plane.row(y).iter().copied()).collect();
    img(&samples, plane.width(), plane.height(), ExtendedColorType::L8, alt)
}

fn img(samples: &[u8], width: usize, height: usize, colour: ExtendedColorType, alt: &str) -> Markup {
    let mut jpeg = Vec::new();
    let size = (u32::try_from(width).unwrap_or(0), u32::try_from(height).unwrap_or(0));
    let encoded = JpegEncoder::new_with_quality(&mut jpeg, QUALITY).write_image(samples, size.0, size.1, colour);
    html! {
        @match encoded {
            Ok(()) => { img width=(width) height=(height) alt=(alt) src=(jpeg_url(&jpeg)); }
            Err(error) => { p { "(no picture: " (error) ")" } }
        }
    }
}

/// A JPEG picture as a URL that contains it.
pub(super) fn jpeg_url(jpeg: &[u8]) -> String {
    format!("data:image/jpeg;base64,{}", base64(jpeg))
}

/// Bytes as RFC 4648 text.
pub(super) fn base64(bytes: &[u8]) -> String {
    let mut text = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for chunk in bytes.chunks(3) {
        let word = (0..3).fold(0u32, |word, i| word << 8 | u32::from(chunk.get(i).copied().unwrap_or(0)));
        for i in 0..4 {
            let digit = DIGITS[(word >> (18 - 6 * i) & 63) as usize];
            text.push(if i <= chunk.len() { char::from(digit) } else { '=' });
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::{Picture, Sampling};

    #[test]
    fn base64_has_the_rfcs_examples() {
        for (bytes, text) in
            [("", ""), ("f", "Zg=="), ("fo", "Zm8="), ("foo", "Zm9v"), ("foob", "Zm9vYg=="), ("foobar", "Zm9vYmFy")]
        {
            assert_eq!(base64(bytes.as_bytes()), text);
        }
        assert_eq!(base64(&[255, 239, 190]), "/+++");
    }

    #[test]
    fn white_black_and_red() {
        let mut picture = Picture::new(Sampling::S420, 3, 1);
        picture.as_mut().planes[0].row_mut(0).copy_from_slice(&[16, 235, 81]);
        picture.as_mut().planes[1].row_mut(0).copy_from_slice(&[128, 90]);
        picture.as_mut().planes[2].row_mut(0).copy_from_slice(&[128, 240]);
        let shown = Rgb::of(picture.as_ref());
        assert_eq!(shown.samples[..6], [0, 0, 0, 255, 255, 255]);
        assert!(shown.samples[6] > 250 && shown.samples[7] < 5 && shown.samples[8] < 5, "{:?}", shown.samples);
        let grey = Rgb::of(Picture::new(Sampling::Mono, 1, 1).as_ref());
        assert_eq!(grey.samples, [0, 0, 0]);
    }
}
