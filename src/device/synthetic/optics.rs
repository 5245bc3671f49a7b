//! Which ray a pixel of the synthetic camera sees, and which pixel sees a ray.

use crate::geometry::Pose;

/// A pinhole camera that only turns and zooms.
#[derive(Clone, Copy, Debug)]
pub(super) struct Optics {
    /// Focal length at a log zoom of 0, pixels.
    pub(super) focal: f64,
    /// The pixel in the middle.
    pub(super) centre: [f64; 2],
}

/// `R = Rz(roll) Rx(pitch) Ry(yaw)`, row by row: takes camera rays to scene rays (x right, y down, z ahead).
pub(super) fn rotation([yaw, pitch, roll]: [f64; 3]) -> [[f64; 3]; 3] {
    let ((sy, cy), (sp, cp), (sr, cr)) = (yaw.sin_cos(), pitch.sin_cos(), roll.sin_cos());
    // Rx Ry, then Rz of it.
    let xy = [[cy, 0.0, sy], [sp * sy, cp, -sp * cy], [-cp * sy, sp, cp * cy]];
    let turn = |a: f64, b: f64| [0, 1, 2].map(|c: usize| a * xy[0][c] + b * xy[1][c]);
    [turn(cr, -sr), turn(sr, cr), xy[2]]
}

impl Optics {
    pub(super) fn new(width: u32, height: u32, hfov_deg: f64) -> Self {
        let focal = f64::from(width) / 2.0 / (hfov_deg.to_radians() / 2.0).tan();
        Self { focal, centre: [(f64::from(width) - 1.0) / 2.0, (f64::from(height) - 1.0) / 2.0] }
    }

    /// The scene ray (not normalized, ahead is z) that pixel `(x, y)` sees in `pose` (yaw, pitch, roll, log zoom), as a linear
    /// function: the ray of `(0, 0)`, and what each pixel to the right and down adds.
    pub(super) fn rays(&self, Pose([yaw, pitch, roll, zoom]): Pose) -> [[f64; 3]; 3] {
        let r = rotation([yaw, pitch, roll]);
        let focal = self.focal * zoom.exp();
        let right = r.map(|row| row[0] / focal);
        let down = r.map(|row| row[1] / focal);
        let origin = [0, 1, 2].map(|n: usize| r[n][2] - self.centre[0] * right[n] - self.centre[1] * down[n]);
        [origin, right, down]
    }

    /// The pixel that sees scene ray `ray` in `pose`; `None` where it lies behind the camera.
    pub(super) fn project(&self, ray: [f64; 3], Pose([yaw, pitch, roll, zoom]): Pose) -> Option<[f64; 2]> {
        let r = rotation([yaw, pitch, roll]);
        let [x, y, z] = [0, 1, 2].map(|c: usize| r[0][c] * ray[0] + r[1][c] * ray[1] + r[2][c] * ray[2]);
        let focal = self.focal * zoom.exp();
        (z > 1e-9).then(|| [focal * x / z + self.centre[0], focal * y / z + self.centre[1]])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ray_comes_back_to_its_pixel() {
        let optics = Optics::new(640, 480, 60.0);
        assert!((optics.focal - 320.0 * 3.0_f64.sqrt()).abs() < 1e-9);
        let pose = Pose([0.1, -0.07, 0.2, 0.05]);
        let [origin, right, down] = optics.rays(pose);
        for [x, y] in [[0.0, 0.0], [639.0, 479.0], [12.5, 300.25]] {
            let ray = [0, 1, 2].map(|n: usize| origin[n] + x * right[n] + y * down[n]);
            let [px, py] = optics.project(ray, pose).unwrap();
            assert!((px - x).abs() < 1e-9 && (py - y).abs() < 1e-9, "{px} {py}");
        }
        assert_eq!(optics.project([0.0, 0.0, -1.0], Pose::default()), None);
    }

    #[test]
    fn directions_are_as_agreed() {
        // Yaw takes the ray ahead to the right, pitch to the top; roll turns right to down.
        let ahead = |r: [[f64; 3]; 3]| r.map(|row| row[2]);
        assert!(ahead(rotation([0.1, 0.0, 0.0]))[0] > 0.09);
        assert!(ahead(rotation([0.0, 0.1, 0.0]))[1] < -0.09);
        let right = rotation([0.0, 0.0, 0.1]).map(|row| row[0]);
        assert!(right[1] > 0.09);
    }
}
