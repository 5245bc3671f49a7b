//! What the daemon says of its camera, its output and a stream: in the log and in the status.

use super::output::LiveOutput;
use crate::control::{CameraInfo, DaemonState, OutputInfo, PipewireInfo};
use crate::device::v4l2::Capture;
use crate::device::{FrameSink, FrameSource};
use crate::pipeline::Totals;
use crate::share::Companions;

/// A stream's frames as people say it: what did not happen is left out.
pub(super) fn in_words(totals: &Totals) -> String {
    let Totals { frames_in, frames_out, stabilized, held, passed_through, damaged, cut, dropped, ref unusable } = *totals;
    let mut words = format!("{frames_in} frames in, {frames_out} out");
    for (count, what) in [
        (stabilized, "stabilized"),
        (held, "repeated"),
        (passed_through, "uncorrected"),
        (damaged, "unusable"),
        (cut, "shown in part"),
        (dropped, "given up for a newer one"),
    ] {
        if count > 0 {
            words += &format!(", {count} {what}");
        }
    }
    unusable.in_words(frames_in).map_or(words.clone(), |why| format!("{words}; {why}"))
}

/// Says what is streamed where.
pub(super) fn told_stream(camera: &Capture, output: &LiveOutput) -> String {
    let format = camera.format();
    let (from, to) = (camera.path().display().to_string(), output.name());
    let mode = format!("{} {}x{}", format.pixel, format.width, format.height);
    tracing::info!(camera = %from, output = %to, %mode, "stabilizing");
    format!("{from} ({mode}) to {to}")
}

/// A camera as the status tells it.
pub(super) fn camera_now(camera: &Capture) -> CameraInfo {
    let format = camera.format();
    let (name, bus) = camera.name_and_bus();
    CameraInfo {
        path: camera.path().display().to_string(),
        name,
        bus,
        format: format.pixel.to_string(),
        width: format.width,
        height: format.height,
        fps: format.rate(),
    }
}

/// The output, and who watches it, for the status.
pub(super) fn tell_of(output: &LiveOutput, state: &DaemonState) {
    let format = output.format();
    let now = OutputInfo {
        path: output.loopback.as_ref().map_or_else(|| output.name(), |loopback| loopback.path().display().to_string()),
        format: format.pixel.to_string(),
        width: format.width,
        height: format.height,
    };
    let viewers = output.viewer_monitor.status().clone();
    let count: Box<dyn Fn() -> u32 + Send> = Box::new(move || viewers.at_loopback());
    state.metrics.set_output(now, output.loopback.is_some().then_some(count));
}

/// Companions, for the status.
pub(super) fn tell_of_companions(companions: &Companions, state: &DaemonState) {
    let companions = companions.clone();
    state.metrics.set_pipewire(Box::new(move || {
        let (sent, dropped) = companions.counts();
        PipewireInfo { companions: companions.connected(), watched: companions.watching(), sent, dropped }
    }));
}
