//! A map as it is asked quickest at many points: what all of them share is worked out once.

use crate::geometry::{Homography, OutputMap, RowPoses};

/// Rounds in which the row is found that saw a point, as in [`OutputMap::apply`].
const ROUNDS: usize = 3;

/// Takes output pixels to input pixels as an [`OutputMap`] does, but for what single precision makes of the motion within a frame:
/// of a hundred pixels some hundred-thousandths.
#[derive(Debug)]
pub struct Quick {
    view: Homography,
    rows: Option<Rows>,
}

/// The motion of rows.
#[derive(Debug)]
struct Rows {
    /// Each sample's pose and what it grows by to the next.
    poses: [[[f32; 4]; 2]; RowPoses::SAMPLES - 1],
    /// Samples from one row to the next.
    per_row: f32,
    focal: f32,
    per_focal: f32,
    centre: [f32; 2],
}

impl Quick {
    /// The same map.
    pub fn of(map: &OutputMap) -> Self {
        match map {
            OutputMap::Projective(view) => Self { view: *view, rows: None },
            OutputMap::Rows { view, camera, rows } => {
                let samples = &rows.samples;
                let poses = std::array::from_fn(|i| {
                    let here = samples[i].map(|value| value as f32);
                    [here, std::array::from_fn(|c| (samples[i + 1][c] - samples[i][c]) as f32)]
                });
                let rows = Rows {
                    poses,
                    per_row: (1.0 / rows.spacing) as f32,
                    focal: camera.focal as f32,
                    per_focal: (1.0 / camera.focal) as f32,
                    centre: camera.centre.map(|c| c as f32),
                };
                Self { view: *view, rows: Some(rows) }
            }
        }
    }

    /// The input pixel (x, y) that the output pixel shows.
    #[inline]
    pub fn apply(&self, pixel: [f64; 2]) -> [f64; 2] {
        let at_reference = self.view.apply(pixel);
        let Some(rows) = &self.rows else { return at_reference };
        let moved = rows.motion(at_reference.map(|c| c as f32));
        [at_reference[0] + f64::from(moved[0]), at_reference[1] + f64::from(moved[1])]
    }
}

impl Rows {
    /// How far the row that saw a point moved it.
    #[inline]
    fn motion(&self, [x, y]: [f32; 2]) -> [f32; 2] {
        let mut moved = [0.0f32; 2];
        for _ in 0..ROUNDS {
            let place = ((y + moved[1]) * self.per_row).clamp(0.0, (RowPoses::SAMPLES - 1) as f32);
            let i = (place as usize).min(RowPoses::SAMPLES - 2);
            let part = place - i as f32;
            let [base, growth] = &self.poses[i];
            let mut pose = [0.0f32; 4];
            for c in 0..4 {
                pose[c] = base[c] + growth[c] * part;
            }
            // the derivative of a pixel by the pose, half way
            let (u, v) = (x + 0.5 * moved[0] - self.centre[0], y + 0.5 * moved[1] - self.centre[1]);
            let (a, b) = (u * self.per_focal, v * self.per_focal);
            moved = [
                -(self.focal + u * a) * pose[0] + u * b * pose[1] + v * pose[2] + u * pose[3],
                -(u * b) * pose[0] + (self.focal + v * b) * pose[1] - u * pose[2] + v * pose[3],
            ];
        }
        moved
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pinhole;

    #[test]
    fn it_is_the_same_map() {
        let camera = Pinhole::new([1920, 1080], 70.0);
        let samples = std::array::from_fn(|i| {
            let t = i as f64 / 24.0 - 0.5;
            [0.03 * t, -0.04 * t * t, 0.02 * t, 0.004 * t]
        });
        let view = camera.turned([0.02, -0.03, 0.05, 0.01]);
        let rows = RowPoses { samples, spacing: 1079.0 / 24.0 };
        for map in [OutputMap::Projective(view), OutputMap::Rows { view, camera, rows }] {
            let quick = Quick::of(&map);
            let mut most = 0.0f64;
            for (x, y) in (0..60).flat_map(|x| (0..40).map(move |y| (f64::from(x) * 32.0, f64::from(y) * 27.3))) {
                let (exact, found) = (map.apply([x, y]), quick.apply([x, y]));
                most = most.max((exact[0] - found[0]).hypot(exact[1] - found[1]));
            }
            assert!(most < 2e-4, "{most} px");
        }
    }
}
