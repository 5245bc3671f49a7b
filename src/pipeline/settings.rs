//! The settings of all stages.

use crate::stage::paper::homography;
use crate::stage::shutter::Prior;
use crate::stage::{crop, detect, shutter, smooth, track, warp};

/// What is known of the camera's optics and sensor.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Camera {
    /// Time from the exposure of the first row to that of the last (milliseconds, -100 to 100; negative: bottom to top).
    pub readout_ms: Prior,
    /// Horizontal field of view (degrees, 10 to 170), as the focal length gives it where the lens does not bend.
    pub hfov_deg: Prior,
    /// The lens's radial distortion, k1 of [`crate::geometry::Pinhole`] (-0.35 to 0.35).
    pub lens_k1: Prior,
}

impl Camera {
    /// The same, as the shutter's models take it.
    pub fn optics(&self) -> shutter::Optics {
        shutter::Optics { readout_s: self.readout_ms.scaled(1e-3), hfov_deg: self.hfov_deg, lens_k1: self.lens_k1 }
    }
}

/// Settings of every stage.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Params {
    /// Whether the picture is stabilized; if false, it is only cropped.
    pub enabled: bool,
    /// Whether straight lines that the lens bends are drawn straight; costs some of the picture's sides.
    pub straighten: bool,
    /// The camera.
    pub camera: Camera,
    /// Corners.
    pub detect: detect::Params,
    /// Lucas-Kanade.
    pub track: track::Params,
    /// Homography.
    pub fit: homography::Params,
    /// Rolling shutter.
    pub shutter: shutter::Params,
    /// Path filter.
    pub smooth: smooth::Params,
    /// Crop window.
    pub crop: crop::Params,
    /// Drawing.
    pub warp: warp::Params,
}

impl Default for Params {
    fn default() -> Self {
        Self {
            enabled: true,
            straighten: false,
            camera: Camera::default(),
            detect: detect::Params::default(),
            track: track::Params::default(),
            fit: homography::Params::default(),
            shutter: shutter::Params::default(),
            smooth: smooth::Params::default(),
            crop: crop::Params::default(),
            warp: warp::Params::default(),
        }
    }
}
