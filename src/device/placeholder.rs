//! The picture that viewers see while there is none from the camera: a dark background with a small symbol, without text.

use crate::image::PictureMut;

/// Luma of the ground, at the middle and in the corners, and of the mark.
const GROUND: [f32; 2] = [38.0, 24.0];
const MARK: f32 = 104.0;
/// Colour of everything: a breath of blue.
const CHROMA: [u8; 2] = [131, 126];

/// Radius of the mark, of the shorter side; widths and lengths inside it, of its radius.
const RADIUS: f32 = 0.11;
const WIDTH: f32 = 0.055;
const POINT: f32 = 0.13;
/// The inner ring, seen at a slant: half its axes, and the sine and cosine of its tilt (25 degrees).
const RING: [f32; 2] = [0.70, 0.28];
const TILT: [f32; 2] = [0.422_618_26, 0.906_307_8];

/// Draws it.
pub fn draw(canvas: &mut PictureMut<'_>) {
    let (width, height) = (canvas.width() as f32, canvas.height() as f32);
    let radius = RADIUS * width.min(height);
    let corner = 0.25 * (width * width + height * height);
    for y in 0..canvas.height() {
        let dy = y as f32 + 0.5 - 0.5 * height;
        for (x, sample) in canvas.planes[0].row_mut(y).iter_mut().enumerate() {
            let dx = x as f32 + 0.5 - 0.5 * width;
            let ground = GROUND[0] + (GROUND[1] - GROUND[0]) * (dx * dx + dy * dy) / corner;
            // Whole numbers alone would draw rings: the fraction decides by place.
            let dither = ((37 * x + 61 * y) % 97) as f32 / 97.0;
            *sample = (ground + (MARK - ground) * coverage(dx / radius, dy / radius, radius) + dither) as u8;
        }
    }
    for (plane, chroma) in canvas.planes[1..].iter_mut().zip(CHROMA) {
        for y in 0..plane.height() {
            plane.row_mut(y).fill(chroma);
        }
    }
}

/// How much of the pixel at (x, y), in radii from the middle, the mark covers; a radius has `pixels`.
fn coverage(x: f32, y: f32, pixels: f32) -> f32 {
    let from_middle = (x * x + y * y).sqrt();
    if from_middle > 1.0 + WIDTH + 2.0 / pixels {
        return 0.0;
    }
    let (u, v) = (TILT[1] * x - TILT[0] * y, TILT[0] * x + TILT[1] * y);
    let [a, b] = RING;
    let level = ((u / a).powi(2) + (v / b).powi(2)).sqrt();
    // The distance from an ellipse to first order: its level over the level's slope.
    let slope = ((u / (a * a)).powi(2) + (v / (b * b)).powi(2)).sqrt() / level.max(1e-6);
    let ring = ((level - 1.0) / slope.max(1e-6)).abs() - 0.5 * WIDTH;
    let circle = (from_middle - 1.0).abs() - 0.5 * WIDTH;
    let nearest = circle.min(ring).min(from_middle - POINT);
    (0.5 - nearest * pixels).clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::{Picture, Sampling};

    #[test]
    fn it_is_dark_with_a_mark_in_the_middle_at_any_size() {
        for (width, height) in [(1280, 720), (640, 480), (322, 180), (2, 2)] {
            let mut picture = Picture::new(Sampling::S420, width, height);
            draw(&mut picture.as_mut());
            let luma = picture.luma();
            let at = |x: usize, y: usize| f32::from(luma.at(x, y));
            let bright = (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).filter(|&(x, y)| at(x, y) > 60.0).count();
            if width > 2 {
                let middle = at(width / 2, height / 2);
                assert!(at(0, 0) < GROUND[1] + 1.0, "{width}x{height}");
                assert!((middle - MARK).abs() < 8.0, "{width}x{height}: {middle}");
                assert!((10..width * height / 50).contains(&bright), "{width}x{height}: {bright}");
            }
            assert!(picture.as_ref().planes[1].at(0, 0) == CHROMA[0] && picture.as_ref().planes[2].at(0, 0) == CHROMA[1]);
        }
    }
}
