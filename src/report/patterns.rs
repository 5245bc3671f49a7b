//! Slant and height of dark upright rectangles on a light ground, as Fig. 10 (a) of the paper has them, measured in the pixels alone.
//!
//! A rectangle is what is connected and darker than [`LEVEL`], of some size, and whole in the picture. Its edges are where the luma passes that
//! level, found to a fraction of a pixel between two samples. The slant is that of the lines that fit its left and right edge best, the
//! height is the mean distance of its top and bottom edge; both are taken away from the corners.

use super::pair::reduced;
use crate::frame::Frame;
use crate::image::{Picture, PictureRef, PlaneRef};
use crate::pipeline::Observer;

/// Luma midway between rectangles and ground.
const LEVEL: u8 = 125;
/// Least width and height (pixels).
const MIN: usize = 16;
/// Part of an edge next to a corner that is not measured.
const CORNER: f64 = 0.15;
/// Maximum width of a kept picture (pixels).
const WIDEST: usize = 320;

/// A rectangle, or the mean of several.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shape {
    /// Pixels.
    pub height_px: f64,
    /// Angle between its left and right edges and the horizontal, degrees: 90 is upright, more leans to the left.
    pub angle_deg: f64,
}

/// The extent of a connected dark part, ends included.
#[derive(Clone, Copy, Debug)]
struct Extent {
    left: usize,
    right: usize,
    top: usize,
    bottom: usize,
}

/// The mean of all rectangles in a picture; `None` where there is none.
pub fn measure(luma: PlaneRef<'_>) -> Option<Shape> {
    let shapes: Vec<Shape> = parts(luma).into_iter().filter_map(|part| shape(luma, part)).collect();
    let mean = |of: fn(&Shape) -> f64| shapes.iter().map(of).sum::<f64>() / shapes.len() as f64;
    (!shapes.is_empty()).then(|| Shape { height_px: mean(|s| s.height_px), angle_deg: mean(|s| s.angle_deg) })
}

/// The connected dark parts that are large enough and do not touch the picture's edge.
fn parts(luma: PlaneRef<'_>) -> Vec<Extent> {
    let (width, height) = (luma.width(), luma.height());
    let mut seen = vec![false; width * height];
    let mut parts = Vec::new();
    let mut open = Vec::new();
    for start in 0..width * height {
        if seen[start] || luma.at(start % width, start / width) >= LEVEL {
            continue;
        }
        seen[start] = true;
        open.push(start);
        let (x, y) = (start % width, start / width);
        let mut extent = Extent { left: x, right: x, top: y, bottom: y };
        while let Some(at) = open.pop() {
            let (x, y) = (at % width, at / width);
            (extent.left, extent.right) = (extent.left.min(x), extent.right.max(x));
            (extent.top, extent.bottom) = (extent.top.min(y), extent.bottom.max(y));
            let left = (x > 0).then(|| at - 1);
            let right = (x + 1 < width).then(|| at + 1);
            let above = (y > 0).then(|| at - width);
            let below = (y + 1 < height).then(|| at + width);
            for next in [left, right, above, below].into_iter().flatten() {
                if !seen[next] && luma.at(next % width, next / width) < LEVEL {
                    seen[next] = true;
                    open.push(next);
                }
            }
        }
        let Extent { left, right, top, bottom } = extent;
        let is_whole = left > 0 && top > 0 && right + 1 < width && bottom + 1 < height;
        if is_whole && right - left >= MIN && bottom - top >= MIN {
            parts.push(extent);
        }
    }
    parts
}

/// Measures a rectangle; `None` where it has no such edges.
fn shape(luma: PlaneRef<'_>, Extent { left, right, top, bottom }: Extent) -> Option<Shape> {
    let [middle_x, middle_y] = [(left + right) / 2, (top + bottom) / 2];
    let inner = |low: usize, high: usize| {
        let skipped = (CORNER * (high - low) as f64).ceil() as usize;
        low + skipped..=high - skipped
    };
    let mut slopes = 0.0;
    for step in [-1, 1] {
        let edge: Option<Vec<[f64; 2]>> =
            inner(top, bottom).map(|y| Some([y as f64, crossing(middle_x, luma.width(), step, |x| luma.at(x, y))?])).collect();
        slopes += slope(&edge?)? / 2.0;
    }
    // A column that is slanted as the rectangle is stays away from its corners.
    let mut heights = Vec::new();
    for x in inner(left, right) {
        let [up, down] = [-1, 1].map(|step| crossing(middle_y, luma.height(), step, |y| luma.at(x, y)));
        heights.push(down? - up?);
    }
    let height_px = heights.iter().sum::<f64>() / heights.len() as f64;
    Some(Shape { height_px, angle_deg: 90.0 + slopes.atan().to_degrees() })
}

/// Where the luma passes the level, from sample `start` in steps of `step`; `None` where it is not dark there, or nowhere light.
fn crossing(start: usize, count: usize, step: isize, luma: impl Fn(usize) -> u8) -> Option<f64> {
    let (mut at, mut here) = (start, luma(start));
    if here >= LEVEL {
        return None;
    }
    loop {
        let next = at.checked_add_signed(step).filter(|next| *next < count)?;
        let there = luma(next);
        if there >= LEVEL {
            let part = f64::from(LEVEL - here) / f64::from(there - here);
            return Some(at as f64 + step as f64 * part);
        }
        (at, here) = (next, there);
    }
}

/// The slope of the straight line through points (place, value) by least squares.
fn slope(points: &[[f64; 2]]) -> Option<f64> {
    let count = points.len() as f64;
    let mean = |i: usize| points.iter().map(|point| point[i]).sum::<f64>() / count;
    let [place, value] = [mean(0), mean(1)];
    let (mut along, mut across) = (0.0, 0.0);
    for point in points {
        along += (point[0] - place).powi(2);
        across += (point[0] - place) * (point[1] - value);
    }
    (along > 0.0).then(|| across / along)
}

/// What was measured in a frame.
#[derive(Clone, Copy, Debug)]
pub struct PatternFrame {
    /// When its first row was taken, seconds after the first frame's.
    pub time_s: f64,
    /// In the camera's picture and in the output.
    pub shapes: [Option<Shape>; 2],
    /// h2 and h5 of the homography from the frame before (eq. 9).
    pub homography: [f64; 2],
}

/// Measures every frame of a run, and keeps small pictures of some.
#[derive(Debug, Default)]
pub struct PatternWatch {
    wanted: Vec<u64>,
    /// In the order of the run.
    pub frames: Vec<PatternFrame>,
    /// Input and output of the wanted frames that came.
    pub pictures: Vec<(u64, [Picture; 2])>,
}

impl PatternWatch {
    /// Keeps the pictures of the frames with these numbers, counted from 0.
    pub fn new(wanted: &[u64]) -> Self {
        Self { wanted: wanted.to_vec(), ..Self::default() }
    }
}

impl Observer for PatternWatch {
    fn drawn(&mut self, frame: &Frame, output: PictureRef<'_>) {
        let number = self.frames.len() as u64;
        let pictures = [frame.picture.as_ref(), output];
        if self.wanted.contains(&number) {
            self.pictures.push((number, pictures.map(|picture| reduced(picture, WIDEST))));
        }
        let h = &frame.context.fit.homography.0;
        let scale = h[(2, 2)];
        self.frames.push(PatternFrame {
            time_s: frame.stamp.time_ns as f64 * 1e-9,
            shapes: pictures.map(|picture| measure(picture.planes[0])),
            homography: [h[(0, 1)] / scale, h[(1, 1)] / scale],
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Plane;

    /// A plane with rectangles whose left edge goes through `x` at their top and moves right by `lean` a row. Their sides are soft, as a
    /// lens makes them: two pixels wide.
    fn drawn(rectangles: &[(f64, usize)], width_px: f64, height: usize, lean: f64) -> Plane {
        let mut plane: Plane = Plane::new(200, 120);
        plane.as_mut().fill(225);
        for (x, top) in rectangles {
            for row in 0..height {
                let left = x + lean * row as f64;
                let line = plane.row_mut(top + row);
                for (at, sample) in line.iter_mut().enumerate() {
                    let inside = |distance: f64| (0.5 + distance / 2.0).clamp(0.0, 1.0);
                    let cover = inside(at as f64 - left).min(inside(left + width_px - at as f64));
                    *sample = (*sample).min((225.0 - 200.0 * cover).round() as u8);
                }
            }
        }
        plane
    }

    #[test]
    fn slant_and_height_of_known_rectangles() {
        for lean in [-0.08, -0.013, 0.0, 0.02, 0.07] {
            for height in [40, 61] {
                let plane = drawn(&[(40.25, 20), (110.6, 30)], 36.0, height, lean);
                let shape = measure(plane.as_ref()).unwrap();
                let angle_deg = 90.0 + f64::atan(lean).to_degrees();
                assert!((shape.angle_deg - angle_deg).abs() < 0.03, "{shape:?}, {lean}");
                // The level lies midway, and so do edges that fall between two rows.
                assert!((shape.height_px - height as f64).abs() < 0.02, "{shape:?}, {height}");
            }
        }
    }

    #[test]
    fn what_is_cut_off_small_or_not_there_is_not_measured() {
        assert_eq!(measure(Plane::new(64, 64).as_ref()), None, "all dark, to the edge");
        assert_eq!(measure(drawn(&[], 0.0, 0, 0.0).as_ref()), None);
        assert_eq!(measure(drawn(&[(-5.0, 20)], 36.0, 40, 0.0).as_ref()), None, "it touches the edge");
        assert_eq!(measure(drawn(&[(50.0, 20)], 9.0, 40, 0.0).as_ref()), None);
        assert_eq!(measure(Plane::new(0, 0).as_ref()), None);
        let whole = measure(drawn(&[(-5.0, 20), (90.0, 20)], 36.0, 40, 0.05).as_ref()).unwrap();
        assert!(whole.angle_deg > 92.0, "{whole:?}");
    }
}
