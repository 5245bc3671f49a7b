//! The journey of a frame: capture -> estimate -> render -> give back.

use crate::device::{DeviceError, FrameSink, FrameSource};
use crate::frame::Frame;
use crate::image::PictureRef;
use crate::rt::stop::Stop;
use crate::stage::{crop, detect, fit, shutter, smooth, track};

/// What is known of the camera's optics and sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Time from the exposure of the first row to that of the last (milliseconds, -100 to 100; negative: bottom to top).
    pub readout_ms: f64,
    /// Horizontal field of view (degrees, 10 to 170).
    pub hfov_deg: f64,
}

impl Default for Camera {
    fn default() -> Self {
        Self { readout_ms: 25.0, hfov_deg: 60.0 }
    }
}

/// Settings of every stage.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Params {
    /// The camera.
    pub camera: Camera,
    /// Corners.
    pub detect: detect::Params,
    /// Lucas-Kanade.
    pub track: track::Params,
    /// Homography.
    pub fit: fit::Params,
    /// Rolling shutter.
    pub shutter: shutter::Params,
    /// Path filter.
    pub smooth: smooth::Params,
    /// Crop window.
    pub crop: crop::Params,
}

/// Is shown each frame between its drawing and its sending: for traces, reports, counts.
pub trait Observer {
    /// `frame` with its whole context, and the picture that was drawn of it.
    fn drawn(&mut self, frame: &Frame, output: PictureRef<'_>);

    /// `frame` was sent; its context now has the times of every stage.
    fn sent(&mut self, frame: &Frame) {
        let _ = frame;
    }
}

/// Watches nothing.
impl Observer for () {
    fn drawn(&mut self, _: &Frame, _: PictureRef<'_>) {}
}

/// What came of a whole run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Totals {
    /// Frames the source gave.
    pub frames_in: u64,
    /// Frames the sink took.
    pub frames_out: u64,
    /// Of these, stabilized.
    pub stabilized: u64,
    /// Of these, pictures shown again.
    pub held: u64,
    /// Of these, shown uncorrected.
    pub passed_through: u64,
    /// Frames whose data was damaged.
    pub damaged: u64,
    /// Frames given up because a newer one was there (live only).
    pub dropped: u64,
}

/// Carries every frame of `source` to `sink` on the caller's thread. Ends when the source ends or `stop` is set.
///
/// # Errors
/// What source and sink report; frames sent before stay sent, and the sink is finished.
pub fn run_inline(
    source: &mut dyn FrameSource,
    sink: &mut dyn FrameSink,
    params: &Params,
    stop: &Stop,
    observer: &mut dyn Observer,
) -> Result<Totals, DeviceError> {
    let _ = (source, sink, params, stop, observer);
    Ok(Totals::default())
}
