//! A camera that turns, with a lens that may bend straight lines: how its pixels move.

use nalgebra::{Matrix3, Rotation3, Vector3};

use super::{Homography, PerChannel, Pose, hypot};

/// A camera: focal length, principal point (pixels), and what its lens does.
///
/// Rays are (x, y, 1) with x right, y down, z forward. Yaw turns about y, pitch about x, roll about z, each by the right-hand
/// rule, from camera to scene: a camera that yaws by a positive angle looks further right, and its picture moves left.
///
/// The lens follows the division model (A. Fitzgibbon, "Simultaneous linear estimation of multiple view geometry and lens distortion",
/// CVPR 2001): what a pinhole would show at `s` from the principal point is seen at `p`, with `s = p / (1 + k1 |p|^2)` and p in half
/// widths of the picture. Negative k1 is barrel distortion, positive k1 pincushion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pinhole {
    /// Focal length, pixels.
    pub focal: f64,
    /// Principal point (x, y), pixels.
    pub centre: [f64; 2],
    /// What the lens bends: k1 for p in pixels, 1 / pixels^2.
    pub bend: f64,
}

/// A value, and how uncertain it is.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Estimate {
    /// The value.
    pub value: f64,
    /// Its standard deviation, in the same unit; 0 where the value was given.
    pub sigma: f64,
}

impl Estimate {
    /// A value that was given.
    pub fn exact(value: f64) -> Self {
        Self { value, sigma: 0.0 }
    }

    /// Whether it was given, not estimated.
    pub fn is_exact(&self) -> bool {
        self.sigma == 0.0
    }

    /// The same in another unit.
    pub fn scaled(self, factor: f64) -> Self {
        Self { value: factor * self.value, sigma: factor.abs() * self.sigma }
    }
}

/// What is believed of the camera.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Calibration {
    /// Readout time, seconds; negative from bottom to top.
    pub readout_s: Estimate,
    /// Horizontal field of view, degrees.
    pub hfov_deg: Estimate,
    /// The lens's k1 ([`Pinhole`]).
    pub lens_k1: Estimate,
}

/// A pixel and what the lens does to it.
#[derive(Clone, Copy, Debug)]
struct Seen {
    bent: [f64; 2],
    straight: [f64; 2],
    /// Squared distance of `bent`.
    square: f64,
    /// `bent` over `straight`, and the inverse.
    drawn_in: f64,
    scale: f64,
}

impl Default for Pinhole {
    fn default() -> Self {
        Self { focal: 1.0, centre: [0.0; 2], bend: 0.0 }
    }
}

impl Pinhole {
    /// The camera whose pictures have `size` (width, height) and would cover `hfov_deg` degrees horizontally if the lens did not bend.
    pub fn new(size: [usize; 2], hfov_deg: f64) -> Self {
        let [width, height] = size.map(|n| n as f64);
        let focal = 0.5 * width / (0.5 * hfov_deg.to_radians()).tan();
        Self { focal, centre: [(width - 1.0) / 2.0, (height - 1.0) / 2.0], bend: 0.0 }
    }

    /// The same with a lens of the given k1, for pictures `width` pixels wide.
    pub fn with_lens(self, k1: f64, width: usize) -> Self {
        let half = 0.5 * width as f64;
        Self { bend: k1 / (half * half), ..self }
    }

    /// Where a pinhole would show what the lens shows at a pixel.
    #[inline]
    pub fn straight(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let (u, v) = (x - self.centre[0], y - self.centre[1]);
        let scale = 1.0 / (1.0 + self.bend * (u * u + v * v));
        [self.centre[0] + scale * u, self.centre[1] + scale * v]
    }

    /// Where the lens shows what a pinhole would show at a pixel. What a lens of positive k1 shows nowhere is taken to its furthest circle.
    #[inline]
    pub fn bent(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let (u, v) = (x - self.centre[0], y - self.centre[1]);
        let root = (1.0 - 4.0 * self.bend * (u * u + v * v)).max(0.0).sqrt();
        let scale = 2.0 / (1.0 + root);
        [self.centre[0] + scale * u, self.centre[1] + scale * v]
    }

    /// The same camera with a lens that bends by `bend` ([`Pinhole::bend`]).
    pub fn with_bend(self, bend: f64) -> Self {
        Self { bend, ..self }
    }

    /// The scale (1 is none) at which this camera's picture, drawn with a lens that bends by `bend` instead, shows nothing beyond its edges: a pixel
    /// of the redrawn picture, scaled from the principal point, is one of this picture. It keeps as much as there is room for.
    pub fn fill(&self, bend: f64) -> f64 {
        let drawn = self.with_bend(bend);
        let [cx, cy] = self.centre;
        // how far a point is moved grows or falls with its distance, so that the nearest or the furthest of the outline decides
        let scales = [[0.0, cy], [cx, 0.0], [0.0, 0.0]].map(|edge| {
            let to = drawn.bent(self.straight(edge));
            hypot(to[0] - cx, to[1] - cy) / hypot(edge[0] - cx, edge[1] - cy)
        });
        scales.into_iter().fold(f64::INFINITY, f64::min)
    }

    /// Derivative of a pixel by the camera's pose: rows x and y, columns yaw, pitch, roll, log zoom (pixels per radian, pixels).
    #[inline]
    pub fn derivative(&self, pixel: [f64; 2]) -> [PerChannel; 2] {
        let seen = self.seen(pixel);
        let ([u, v], f) = (seen.straight, self.focal);
        let uv = u * v / f;
        self.through_lens(&seen, [[-(f + u * u / f), uv, v, u], [-uv, f + v * v / f, -u, v]])
    }

    /// How far a pixel moves with a small change of the camera's pose: [`Pinhole::derivative`] times the change, pixels.
    #[inline]
    pub fn moved(&self, pixel: [f64; 2], change: &Pose) -> [f64; 2] {
        let seen = self.seen(pixel);
        let ([u, v], f) = (seen.straight, self.focal);
        let uv = u * v / f;
        let [dx, dy] = [[-(f + u * u / f), uv, v, u], [-uv, f + v * v / f, -u, v]];
        self.through_lens(&seen, [[change.dot(&dx)], [change.dot(&dy)]]).map(|[moved]| moved)
    }

    /// How [`Pinhole::derivative`], which is given, changes with the logarithm of the focal length, and with k1 in pictures `width` pixels wide.
    pub fn effects(&self, pixel: [f64; 2], derivative: &[PerChannel; 2], width: usize) -> [[PerChannel; 2]; 2] {
        const STEP: f64 = 1e-5;
        let seen = self.seen(pixel);
        let ([u, v], f) = (seen.straight, self.focal);
        let uv = u * v / f;
        // the terms with 1 / f change their sign; roll and zoom do not depend on f
        let by_focal = self.through_lens(&seen, [[-(f - u * u / f), -uv, 0.0, 0.0], [uv, f - v * v / f, 0.0, 0.0]]);
        let half = 0.5 * width as f64;
        let more = Self { bend: self.bend + STEP / (half * half), ..*self }.derivative(pixel);
        let by_lens = std::array::from_fn(|axis| std::array::from_fn(|c| (more[axis][c] - derivative[axis][c]) * (1.0 / STEP)));
        [by_focal, by_lens]
    }

    /// A pixel as the lens shows it and as a pinhole would, both from the principal point.
    #[inline]
    fn seen(&self, [x, y]: [f64; 2]) -> Seen {
        let [u, v] = [x - self.centre[0], y - self.centre[1]];
        let square = u * u + v * v;
        let drawn_in = 1.0 + self.bend * square;
        let scale = 1.0 / drawn_in;
        Seen { bent: [u, v], straight: [scale * u, scale * v], square, drawn_in, scale }
    }

    /// How a point moves through the lens, where without it it would move by `rows` (x and y).
    #[inline]
    fn through_lens<const N: usize>(&self, seen: &Seen, rows: [[f64; N]; 2]) -> [[f64; N]; 2] {
        if self.bend == 0.0 {
            return rows;
        }
        // the inverse of the derivative of `straight`, scale (I - slope p p'), by Sherman and Morrison
        let slope = 2.0 * self.bend * seen.scale;
        let outward = slope / (1.0 - slope * seen.square);
        let ([u, v], [dx, dy]) = (seen.bent, rows);
        let along: [f64; N] = std::array::from_fn(|c| outward * (u * dx[c] + v * dy[c]));
        let through = |d: [f64; N], p: f64| std::array::from_fn(|c| (d[c] + p * along[c]) * seen.drawn_in);
        [through(dx, u), through(dy, v)]
    }

    /// The homography that takes a pixel to where the same scene point is seen after the camera turned and zoomed by `turn`: the
    /// rotation of rotation vector (pitch, yaw, roll). Both pixels are a pinhole's ([`Pinhole::straight`]).
    pub fn turned(&self, turn: Pose) -> Homography {
        let Pose([yaw, pitch, roll, zoom]) = turn;
        let rotation = Rotation3::from_scaled_axis(Vector3::new(pitch, yaw, roll));
        let [cx, cy] = self.centre;
        let f = self.focal;
        let inner = Matrix3::new(1.0 / f, 0.0, -cx / f, 0.0, 1.0 / f, -cy / f, 0.0, 0.0, 1.0);
        let magnified = f * zoom.exp();
        let outer = Matrix3::new(magnified, 0.0, cx, 0.0, magnified, cy, 0.0, 0.0, 1.0);
        Homography(outer * rotation.matrix().transpose() * inner).scaled()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_derivative_is_that_of_the_exact_motion() {
        for (pixel, k1) in [[0.0, 0.0], [320.0, 240.0], [600.0, 31.0], [17.0, 470.0]]
            .into_iter()
            .flat_map(|pixel| [0.0, -0.2, 0.1].map(|k1| (pixel, k1)))
        {
            let camera = Pinhole::new([640, 480], 49.0).with_lens(k1, 640);
            let analytic = camera.derivative(pixel);
            for channel in 0..4 {
                let moved = |step: f64| {
                    let mut turn = Pose::default();
                    turn[channel] = step;
                    camera.bent(camera.turned(turn).apply(camera.straight(pixel)))
                };
                let (plus, minus) = (moved(1e-5), moved(-1e-5));
                for axis in 0..2 {
                    let numeric = (plus[axis] - minus[axis]) / 2e-5;
                    assert!((numeric - analytic[axis][channel]).abs() < 1e-4, "{pixel:?} {channel} {axis}");
                }
            }
        }
    }

    #[test]
    fn bending_undoes_straightening() {
        for k1 in [0.0, -0.3, -0.05, 0.1] {
            let camera = Pinhole::new([640, 480], 70.0).with_lens(k1, 640);
            for pixel in [[0.0, 0.0], [319.5, 239.5], [600.0, 31.0], [-20.0, 470.0]] {
                let back = camera.bent(camera.straight(pixel));
                assert!((0..2).all(|i| (back[i] - pixel[i]).abs() < 1e-9), "{k1} {pixel:?}: {back:?}");
            }
        }
        let barrel = Pinhole::new([640, 480], 70.0).with_lens(-0.1, 640);
        assert!(barrel.straight([639.0, 239.5])[0] > 670.0, "barrel distortion draws corners in");
        let furthest = Pinhole::new([640, 480], 70.0).with_lens(0.3, 640).bent([1e4, 239.5]);
        assert!(furthest[0].is_finite());
    }

    #[test]
    fn effects_of_focal_length_and_lens_are_those_of_the_derivative() {
        let camera = Pinhole::new([640, 480], 80.0).with_lens(-0.12, 640);
        let longer = |share: f64| Pinhole { focal: camera.focal * share.exp(), ..camera };
        let lens = |more: f64| Pinhole::new([640, 480], 80.0).with_lens(-0.12 + more, 640);
        for pixel in [[0.0, 0.0], [600.0, 31.0], [320.0, 400.0]] {
            let [by_focal, by_lens] = camera.effects(pixel, &camera.derivative(pixel), 640);
            for (found, changed) in [(by_focal, &longer as &dyn Fn(f64) -> Pinhole), (by_lens, &lens)] {
                let (plus, minus) = (changed(1e-5).derivative(pixel), changed(-1e-5).derivative(pixel));
                for axis in 0..2 {
                    for c in 0..4 {
                        let numeric = (plus[axis][c] - minus[axis][c]) / 2e-5;
                        assert!((numeric - found[axis][c]).abs() < 1e-3 * numeric.abs().max(1.0), "{pixel:?} {axis} {c}");
                    }
                }
            }
        }
    }
}
