//! Where output pixels come from: the one thing that every shutter model gives to the warp.

use nalgebra::Matrix3;

use super::{Homography, Pinhole, Pose};

/// Motion of a frame's rows against the frame's reference time.
#[expect(clippy::large_enum_variant, reason = "one to a frame, kept in the frame: boxing it would allocate on the frame path")]
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RowMotion {
    /// One motion for the whole frame interval, at constant speed.
    Uniform {
        /// Takes a pixel to where it is one frame interval later.
        motion: Homography,
        /// Rows that are read in one frame interval: the picture's rows / the part of the interval that the readout takes;
        /// negative where the sensor reads from bottom to top.
        rows: f64,
    },
    /// Each row has a pose of its own.
    Poses {
        /// The camera.
        camera: Pinhole,
        /// Pose of each row less that of the reference time.
        rows: RowPoses,
    },
}

impl Default for RowMotion {
    fn default() -> Self {
        Self::Uniform { motion: Homography::IDENTITY, rows: 1e9 }
    }
}

/// The poses of a frame's rows: samples at even distances from the first row to the last, straight lines between.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RowPoses {
    /// Poses less that of the reference time.
    pub samples: [Pose; Self::SAMPLES],
    /// Rows from one sample to the next.
    pub spacing: f64,
}

impl RowPoses {
    /// How many samples there are.
    pub const SAMPLES: usize = 25;

    /// The pose of row `y`; rows outside the picture take the nearest's.
    #[inline]
    pub fn at(&self, y: f64) -> Pose {
        let place = (y / self.spacing).clamp(0.0, (Self::SAMPLES - 1) as f64);
        let i = (place as usize).min(Self::SAMPLES - 2);
        let part = place - i as f64;
        let (a, b) = (self.samples[i], self.samples[i + 1]);
        a + (b - a) * part
    }

    /// The part `share` (0 to 1) of each pose.
    pub fn part(self, share: f64) -> Self {
        Self { samples: self.samples.map(|pose| pose * share), ..self }
    }
}

/// Takes output pixels to input pixels.
#[expect(clippy::large_enum_variant, reason = "one to a frame, kept in the frame: boxing it would allocate on the frame path")]
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum OutputMap {
    /// One homography for the whole frame.
    Projective(Homography),
    /// A homography to the frame as it would be had all rows the pose of the reference time, then each row's own motion.
    Rows {
        /// Where the lens bends: output pixel to the virtual camera's picture, which is bent by `kept`. Not used otherwise.
        window: Homography,
        /// From there to the frame at its reference time, both as a pinhole would show them ([`Pinhole::straight`]). Where the lens bends
        /// nothing, from the output pixel.
        view: Homography,
        /// The camera.
        camera: Pinhole,
        /// What the virtual camera's lens bends ([`Pinhole::bend`]): as much as the camera's, unless straight lines are drawn straight.
        kept: f64,
        /// Each row's pose.
        rows: RowPoses,
    },
}

/// What the output shows of the virtual camera's picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// Output pixel to the virtual camera's picture: crop and scale.
    pub window: Homography,
    /// The part (0 to 1) of the lens's distortion that is removed.
    pub straighten: f64,
}

impl From<Homography> for View {
    /// With the lens as it is.
    fn from(window: Homography) -> Self {
        Self { window, straighten: 0.0 }
    }
}

impl View {
    /// Window and bend of the virtual camera's picture, where the lens of `camera` bends.
    pub fn through(&self, camera: &Pinhole) -> (Homography, f64) {
        if self.straighten == 0.0 {
            return (self.window, camera.bend);
        }
        let kept = camera.bend * (1.0 - self.straighten);
        let scale = camera.fill(kept);
        let [x, y] = camera.centre.map(|centre| centre * (1.0 - scale));
        let fill = Matrix3::new(scale, 0.0, x, 0.0, scale, y, 0.0, 0.0, 1.0);
        (Homography(fill * self.window.0).scaled(), kept)
    }
}

impl Default for OutputMap {
    fn default() -> Self {
        Self::Projective(Homography::IDENTITY)
    }
}

/// Rounds in which the row is found that saw a point; each shrinks the error to what the picture moves in as many rows, a few
/// hundredths. [`OutputMap::apply`] goes through them in double precision for a single point, [`crate::kernel::warp::nodes`] in single
/// precision for sixteen at a time; a test in `stage::warp` compares the two.
pub const ROW_ROUNDS: usize = 3;

impl OutputMap {
    /// The input pixel (x, y) that the output pixel shows.
    #[inline]
    pub fn apply(&self, pixel: [f64; 2]) -> [f64; 2] {
        match self {
            Self::Projective(h) => h.apply(pixel),
            Self::Rows { window, view, camera, kept, rows } => {
                let at_reference = match camera.bend == 0.0 {
                    true => view.apply(pixel),
                    false => camera.bent(view.apply(camera.with_bend(*kept).straight(window.apply(pixel)))),
                };
                let mut seen = at_reference;
                for _ in 0..ROW_ROUNDS {
                    let pose = rows.at(seen[1]);
                    let middle = [0.5 * (at_reference[0] + seen[0]), 0.5 * (at_reference[1] + seen[1])];
                    let moved = camera.moved(middle, &pose);
                    seen = [at_reference[0] + moved[0], at_reference[1] + moved[1]];
                }
                seen
            }
        }
    }

    /// The input pixel that the output pixel would show if the map corrected nothing. `view` is what the map was made for.
    #[inline]
    pub fn at_rest(&self, pixel: [f64; 2], view: &View) -> [f64; 2] {
        match self {
            Self::Rows { window, camera, kept, .. } if *kept != camera.bend => {
                camera.bent(camera.with_bend(*kept).straight(window.apply(pixel)))
            }
            _ => view.window.apply(pixel),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_row_that_saw_a_point_is_found() {
        let mut rows = RowPoses { samples: [Pose::default(); RowPoses::SAMPLES], spacing: 479.0 / 24.0 };
        for (i, pose) in rows.samples.iter_mut().enumerate() {
            let t = i as f64 / 24.0 - 0.5;
            *pose = Pose([0.02 * t, 0.015 * t * t, 0.01 * t, 0.003 * t]);
        }
        for k1 in [0.0, -0.15] {
            let camera = Pinhole::new([640, 480], 49.0).with_lens(k1, 640);
            let map =
                OutputMap::Rows { window: Homography::IDENTITY, view: Homography::IDENTITY, camera, kept: camera.bend, rows };
            for y in (0..480).step_by(53) {
                for x in (0..640).step_by(71) {
                    let pixel = [f64::from(x), f64::from(y)];
                    let seen = map.apply(pixel);
                    // the exact motion of that row leads from the pixel to where it was seen
                    let exact = camera.bent(camera.turned(rows.at(seen[1])).apply(camera.straight(pixel)));
                    let off = (exact[0] - seen[0]).hypot(exact[1] - seen[1]);
                    assert!(off < 0.02, "{k1} {pixel:?}: {off} px");
                }
            }
        }
    }

    /// Lines of the scene come out straight, as far as they are to; nothing beyond the picture is shown, and its height or width is.
    #[test]
    fn straightened_lines_are_straight_and_the_picture_is_filled() {
        let size = [640.0, 480.0];
        let rows = RowPoses { samples: [Pose::default(); RowPoses::SAMPLES], spacing: 479.0 / 24.0 };
        for (k1, straighten) in [-0.3, -0.06, 0.1].into_iter().flat_map(|k1| [0.0, 0.5, 1.0].map(|part| (k1, part))) {
            let camera = Pinhole::new([640, 480], 78.0).with_lens(k1, 640);
            let view = View { window: Homography::IDENTITY, straighten };
            let (window, kept) = view.through(&camera);
            let map = OutputMap::Rows { window, view: Homography::IDENTITY, camera, kept, rows };
            let edge =
                |i: usize| (0..=48).map(move |k| [[f64::from(k) * 639.0 / 48.0, 0.0], [0.0, f64::from(k) * 479.0 / 48.0]][i]);
            let seen: Vec<_> = edge(0).chain(edge(1)).map(|pixel| map.apply(pixel)).collect();
            let outside = seen.iter().flatten().fold(0.0, |most: f64, at| most.max(-at));
            let inside = seen.iter().map(|at| at[0].min(at[1])).fold(f64::INFINITY, |least, at| least.min(at.abs()));
            assert!(outside < 1e-9 && inside < 1e-9, "{k1} {straighten}: {outside} px outside, {inside} px inside");
            // where the top row of the output lies in the scene, as a pinhole would show it: a straight line if all of it was removed
            let top: Vec<_> = edge(0).map(|pixel| camera.straight(map.apply(pixel))[1]).collect();
            let sag = (top[24] - top[0]) / size[1];
            let bent = (camera.straight([319.5, 0.0])[1] - camera.straight([0.0, 0.0])[1]) / size[1];
            match straighten {
                0.0 => assert!((sag - bent).abs() < 1e-9, "{k1}: {sag} of {bent}"),
                1.0 => assert!(sag.abs() < 1e-9, "{k1}: {sag}"),
                _ => assert!(sag.abs() < 0.7 * bent.abs() && sag * bent > 0.0, "{k1}: {sag} of {bent}"),
            }
            let pixel = [100.0, 37.0];
            let off = [0, 1].map(|i| map.apply(pixel)[i] - map.at_rest(pixel, &view)[i]);
            assert!(off.iter().all(|off| off.abs() < 1e-9), "{off:?}");
        }
    }
}
