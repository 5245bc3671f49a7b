//! The paper's model: zoom and translation at constant speed, decomposed in closed form.
//!
//! Pixels, origin at the centre of the top-left pixel, y down. The paper takes the readout to fill the
//! frame interval; where it takes the part r of it, H / r stands for the number of rows H in every equation ("rows" below). A
//! frame's reference time is that of its first row.

use nalgebra::Matrix3;

use super::Zoom;
use crate::frame::PathParameters;
use crate::geometry::{Homography, OutputMap, Pinhole, Pose, RowMotion, View};
use crate::stage::shutter::{Motion, Pair, Parameters, Prior, RowSpan};

/// The part of the frame interval that the readout is taken to fill, and the horizontal field of view (degrees), where nothing is
/// known of them: this model does not find them out.
const USUAL_READOUT: f64 = 0.85;
const USUAL_HFOV_DEG: f64 = 60.0;
/// A readout shorter than this part of the frame interval is a global shutter's.
const MIN_READOUT: f64 = 1e-6;

/// eq. (8): takes a captured pixel to the undistorted frame, `D^-1 = [[H, -c, 0], [0, H - d, 0], [0, a - 1, H]]`.
pub fn undistortion(motion: Zoom, rows: f64) -> Homography {
    let Zoom { a, c, d } = motion;
    Homography(Matrix3::new(rows, -c, 0.0, 0.0, rows - d, 0.0, 0.0, a - 1.0, rows)).scaled()
}

/// eq. (10): the homography between captured frames, `H_t = D_{t+1} T_t D_t^-1`. `None` where D_{t+1} cannot be inverted.
pub fn compose(now: Zoom, next: Zoom, rows: f64) -> Option<Homography> {
    let distortion = undistortion(next, rows).inverse()?;
    Some(Homography(distortion.0 * now.homography().0 * undistortion(now, rows).0).scaled())
}

/// eq. (11): the Time-t parameters, those of the frame that `h` starts from. Exact for a homography of the form of eq. (10).
pub fn time_t(h: &Homography, rows: f64) -> Option<Zoom> {
    let [h1, h2, h3, h5, h6, h8] = entries(h);
    let den = rows * (h5 - h6 * h8) + h1 * h6;
    let zoom = Zoom { a: h1 * (rows * h5 + h6) / den, c: rows * (h3 * h5 - h2 * h6) / den, d: rows * h1 * h6 / den };
    zoom.is_sane().then_some(zoom)
}

/// eq. (12): the Time-t+1 parameters, those of the frame that `h` leads to. As printed, the paper's `a'` lacks a factor H at
/// `h6 h8`; solving eq. (10) gives `a' = (H (h1 + h5 - 1 - H h8) + h6) / (H h5 + h6)`.
pub fn time_t1(h: &Homography, rows: f64) -> Option<Zoom> {
    let [h1, h2, h3, h5, h6, h8] = entries(h);
    let den = rows * h5 + h6;
    let zoom = Zoom {
        a: (rows * (h1 + h5 - 1.0 - rows * h8) + h6) / den,
        c: rows * (rows * h2 + h3) / den,
        d: (rows * rows * (h5 - h1) + rows * h6) / den,
    };
    zoom.is_sane().then_some(zoom)
}

/// h1, h2, h3, h5, h6, h8 of eq. (9).
fn entries(h: &Homography) -> [f64; 6] {
    let m = &h.0;
    [m[(0, 0)], m[(0, 1)], m[(0, 2)], m[(1, 1)], m[(1, 2)], m[(2, 1)]]
}

/// The model's state: the path so far and the last pair's motions.
#[derive(Debug)]
pub struct Cho2007 {
    parameters: Parameters,
    readout: Prior,
    hfov_deg: f64,
    height: f64,
    camera: Pinhole,
    /// Of the last pair's reference and newest frame.
    known: [Motion; 2],
}

impl Cho2007 {
    /// A model that has seen nothing.
    pub fn new(parameters: Parameters, readout: Prior, hfov: Prior) -> Self {
        let hfov_deg = hfov.or(USUAL_HFOV_DEG, 0.0).value;
        Self { parameters, readout, hfov_deg, height: 1.0, camera: Pinhole::default(), known: [rest(1e9); 2] }
    }

    /// As [`crate::stage::shutter::Shutter::frames_late`].
    pub fn frames_late(&self) -> usize {
        match self.parameters {
            Parameters::TimeT => 1,
            Parameters::TimeT1 => 0,
        }
    }

    /// As [`crate::stage::shutter::Shutter::begin`].
    pub fn begin(&mut self, size: [usize; 2]) {
        self.height = size[1] as f64;
        self.camera = Pinhole::new(size, self.hfov_deg);
        self.known = [rest(1e9); 2];
    }

    /// Decomposes the pair's homography. What is not believed counts as no motion.
    pub fn observe(&mut self, pair: &Pair<'_>) {
        let interval_s = pair.interval_s;
        let part = self.readout.or(USUAL_READOUT * interval_s, 0.0).value / interval_s;
        let rows = self.height / if part.abs() < MIN_READOUT { MIN_READOUT } else { part };
        let confidence = pair.fit.confidence;
        let believe = |zoom: Option<Zoom>| zoom.unwrap_or_default().part(confidence.sqrt());
        let motion = believe(time_t(&pair.fit.homography, rows));
        let next = believe(time_t1(&pair.fit.homography, rows));
        let mut reference = self.known[1];
        // with nothing seen of the frame after, eq. (12) of the pair before is the best that is known
        if confidence > 0.0 {
            reference.rows = RowMotion::Uniform { motion: motion.homography(), rows };
            reference.confidence = confidence;
        } else {
            reference.confidence = reference.confidence.min(0.5);
        }
        let path = motion.after(zoom(reference.path));
        let newest = Motion {
            rows: RowMotion::Uniform { motion: next.homography(), rows },
            motion: parameters(motion),
            path: parameters(path),
            confidence,
            ends: RowSpan { first: parameters(path), last: parameters(path), ..RowSpan::default() },
            agreement: 1.0,
        };
        self.known = [reference, newest];
    }

    /// As [`crate::stage::shutter::Shutter::newest`].
    pub fn newest(&self) -> Motion {
        self.known[1]
    }

    /// As [`crate::stage::shutter::Shutter::reference`].
    pub fn reference(&self) -> Motion {
        self.known[0]
    }

    /// As [`crate::stage::shutter::Shutter::pose`]: the pixel of the path's first frame that is at the centre now (x, y), 0, the log of a.
    pub fn pose(&self, path: PathParameters) -> Pose {
        let Zoom { a, c, d } = zoom(path);
        let [x, y] = self.camera.centre;
        Pose([(x - c) / a, (y - d) / a, 0.0, a.ln()])
    }

    /// As [`crate::stage::shutter::Shutter::path`].
    pub fn path(&self, Pose([x0, y0, _, log]): Pose) -> PathParameters {
        let a = log.exp();
        let [x, y] = self.camera.centre;
        PathParameters([a, x - a * x0, y - a * y0, 0.0])
    }

    /// As [`crate::stage::shutter::Shutter::map`]: output pixel -> virtual camera -> undistorted frame by `W^-1` -> captured frame by D (eq. 3).
    pub fn map(&self, motion: &Motion, smoothed: PathParameters, strength: f64, view: &View) -> OutputMap {
        let RowMotion::Uniform { motion: within, rows } = motion.rows else { return OutputMap::Projective(view.window) };
        let correction = correction(zoom(motion.path), zoom(smoothed), &self.camera);
        let distortion = undistortion(Zoom::of(&within).part(strength), rows).inverse().unwrap_or_default();
        OutputMap::Projective(Homography(distortion.0 * correction.0 * view.window.0).scaled())
    }
}

/// The motion of a camera at rest.
fn rest(rows: f64) -> Motion {
    let still = parameters(Zoom::IDENTITY);
    Motion {
        rows: RowMotion::Uniform { motion: Homography::IDENTITY, rows },
        motion: still,
        path: still,
        ends: RowSpan { first: still, last: still, ..RowSpan::default() },
        confidence: 1.0,
        agreement: 1.0,
    }
}

/// a, c, d as the four parameters that travel with a frame.
fn parameters(zoom: Zoom) -> PathParameters {
    PathParameters([zoom.a, zoom.c, zoom.d, 0.0])
}

fn zoom(PathParameters([a, c, d, _]): PathParameters) -> Zoom {
    Zoom { a, c, d }
}

/// `W^-1`, with `W = S U^-1` (eq. 13), as the turn and zoom of `camera` that does the same at the picture's centre.
///
/// The paper shifts the picture. A shift of some tens of pixels where the camera turned leaves a keystone behind, which at the
/// picture's sides is worse than what rolling shutter did; a turn leaves none. Both agree to first order in the angle.
fn correction(path: Zoom, smoothed: Zoom, camera: &Pinhole) -> Homography {
    let back = path.after(smoothed.inverse());
    let [x, y] = camera.centre;
    let moved = [back.a * x + back.c - x, back.a * y + back.d - y];
    camera.turned(Pose([-(moved[0] / camera.focal).atan(), (moved[1] / camera.focal).atan(), 0.0, back.a.max(1e-3).ln()]))
}

/// eq. (14): the motion that is left in the stabilized frames, `T^s_t = W_{t+1} T_t W_t^-1`, for frames whose paths are `u` and
/// smoothed paths `s`, before and now.
pub fn stabilized_motion(u: [PathParameters; 2], s: [PathParameters; 2]) -> PathParameters {
    let w = |i: usize| zoom(s[i]).after(zoom(u[i]).inverse());
    let t = zoom(u[1]).after(zoom(u[0]).inverse());
    parameters(w(1).after(t).after(w(0).inverse()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Congruential;

    #[test]
    fn the_decomposition_inverts_the_composition() {
        let mut generator = Congruential::new(7);
        let mut random = || generator.signed();
        for _ in 0..2000 {
            let mut motion = || Zoom { a: 1.0 + 0.1 * random(), c: 40.0 * random(), d: 40.0 * random() };
            let (now, next) = (motion(), motion());
            for rows in [240.0, 480.0 / 0.85, 1080.0 / 0.2, -480.0 / 0.7] {
                let h = compose(now, next, rows).unwrap();
                let (t, t1) = (time_t(&h, rows).unwrap(), time_t1(&h, rows).unwrap());
                for (found, true_) in [(t, now), (t1, next)] {
                    let off = (found.a - true_.a).abs() * 500.0 + (found.c - true_.c).abs() + (found.d - true_.d).abs();
                    assert!(off < 1e-6, "{rows}: {found:?} is not {true_:?}");
                }
            }
        }
    }

    #[test]
    fn eq_10_has_no_h4_and_no_h7() {
        let h = compose(Zoom { a: 1.05, c: 9.0, d: -7.0 }, Zoom { a: 0.97, c: -3.0, d: 12.0 }, 480.0).unwrap();
        assert_eq!((h.0[(1, 0)], h.0[(2, 0)]), (0.0, 0.0));
    }

    /// Fig. 7 (a): a picture of 320 x 240, the camera moves right (c = -20): the captured frame's bottom goes right to be
    /// undistorted, and vertical lines that were skewed come upright.
    #[test]
    fn fig_7_a_a_camera_that_moves_right() {
        let u = undistortion(Zoom { a: 1.0, c: -20.0, d: 0.0 }, 240.0);
        assert_eq!(u.apply([0.0, 0.0]), [0.0, 0.0]);
        assert_eq!(u.apply([320.0, 0.0]), [320.0, 0.0]);
        assert_eq!(u.apply([0.0, 240.0]), [20.0, 240.0]);
        assert_eq!(u.apply([320.0, 240.0]), [340.0, 240.0]);
    }

    /// Fig. 7 (b): a zoom in of 20 %: the undistorted frame is a trapezium, its bottom narrower by 1.2 and raised to 240 / 1.2.
    #[test]
    fn fig_7_b_a_zoom_in() {
        let u = undistortion(Zoom { a: 1.2, c: 0.0, d: 0.0 }, 240.0);
        assert_eq!(u.apply([320.0, 0.0]), [320.0, 0.0]);
        let [x, y] = u.apply([320.0, 240.0]);
        assert!((x - 320.0 / 1.2).abs() < 1e-9 && (y - 200.0).abs() < 1e-9, "{x} {y}");
    }

    /// eq. (7) says the same as eq. (5) with eq. (6): a point moves for as long as its row waits.
    #[test]
    fn the_distortion_is_motion_for_the_time_a_row_waits() {
        let (motion, rows) = (Zoom { a: 1.03, c: 11.0, d: -6.0 }, 480.0 / 0.8);
        let captured = [200.0, 333.0];
        let [x, y] = undistortion(motion, rows).apply(captured);
        let wait = captured[1] / rows;
        let moved = [x + ((motion.a - 1.0) * x + motion.c) * wait, y + ((motion.a - 1.0) * y + motion.d) * wait];
        assert!((moved[0] - captured[0]).abs() < 1e-9 && (moved[1] - captured[1]).abs() < 1e-9, "{moved:?}");
    }

    #[test]
    fn the_smoothed_motion_of_a_still_path_is_nothing() {
        let u = [[1.0, 3.0, 4.0, 0.0], [1.0, 5.0, 1.0, 0.0]].map(PathParameters);
        let s = [PathParameters([1.0, 2.0, 2.0, 0.0]); 2];
        let left = stabilized_motion(u, s);
        assert!((left[0] - 1.0).abs() < 1e-12 && left[1].abs() < 1e-12 && left[2].abs() < 1e-12, "{left:?}");
    }
}
