//! A pinhole camera that turns: how its pixels move.

use nalgebra::{Matrix3, Rotation3, Vector3};

use super::Homography;

/// Yaw, pitch, roll (radians) and log zoom, or a difference of such.
pub type Pose = [f64; 4];
/// Index of the yaw in a [`Pose`].
pub const YAW: usize = 0;
/// Index of the pitch.
pub const PITCH: usize = 1;
/// Index of the roll.
pub const ROLL: usize = 2;
/// Index of the logarithm of the zoom.
pub const ZOOM: usize = 3;

/// A pinhole camera: focal length and principal point in pixels.
///
/// Rays are (x, y, 1) with x right, y down, z forward. Yaw turns about y, pitch about x, roll about z, each by the right-hand
/// rule, from camera to scene: a camera that yaws by a positive angle looks further right, and its picture moves left.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pinhole {
    /// Focal length, pixels.
    pub focal: f64,
    /// Principal point (x, y), pixels.
    pub centre: [f64; 2],
}

/// What is believed of the camera, with standard deviations (0 where it was given).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Calibration {
    /// Time from the first row's exposure to the last one's, seconds; negative from bottom to top.
    pub readout_s: f64,
    /// Its standard deviation, seconds.
    pub readout_deviation_s: f64,
    /// Horizontal field of view, degrees.
    pub hfov_deg: f64,
    /// Its standard deviation, degrees.
    pub hfov_deviation_deg: f64,
}

impl Default for Pinhole {
    fn default() -> Self {
        Self { focal: 1.0, centre: [0.0; 2] }
    }
}

impl Pinhole {
    /// The camera whose pictures have `size` (width, height) and cover `hfov_deg` degrees horizontally.
    pub fn new(size: [usize; 2], hfov_deg: f64) -> Self {
        let [width, height] = size.map(|n| n as f64);
        let focal = 0.5 * width / (0.5 * hfov_deg.to_radians()).tan();
        Self { focal, centre: [(width - 1.0) / 2.0, (height - 1.0) / 2.0] }
    }

    /// Derivative of a pixel by the camera's pose: rows x and y, columns yaw, pitch, roll, log zoom (pixels per radian, pixels).
    #[inline]
    pub fn derivative(&self, [x, y]: [f64; 2]) -> [Pose; 2] {
        let (u, v, f) = (x - self.centre[0], y - self.centre[1], self.focal);
        let uv = u * v / f;
        [[-(f + u * u / f), uv, v, u], [-uv, f + v * v / f, -u, v]]
    }

    /// The homography that takes a pixel to where the same scene point is seen after the camera turned and zoomed by `turn`: the
    /// rotation of rotation vector (pitch, yaw, roll).
    pub fn turned(&self, turn: Pose) -> Homography {
        let [yaw, pitch, roll, zoom] = turn;
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
        let camera = Pinhole::new([640, 480], 49.0);
        for pixel in [[0.0, 0.0], [320.0, 240.0], [600.0, 31.0], [17.0, 470.0]] {
            let analytic = camera.derivative(pixel);
            for channel in 0..4 {
                let moved = |step: f64| {
                    let mut turn = [0.0; 4];
                    turn[channel] = step;
                    camera.turned(turn).apply(pixel)
                };
                let (plus, minus) = (moved(1e-5), moved(-1e-5));
                for axis in 0..2 {
                    let numeric = (plus[axis] - minus[axis]) / 2e-5;
                    assert!((numeric - analytic[axis][channel]).abs() < 1e-4, "{pixel:?} {channel} {axis}");
                }
            }
        }
    }
}
