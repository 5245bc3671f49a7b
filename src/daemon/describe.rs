//! Texts and numbers about the camera, the outputs and a stream, for the log and the status.

use super::devices::{LiveCamera, Output};
use crate::control::{CameraInfo, DaemonState, PipewireInfo};
use crate::pipeline::Totals;
use crate::share::Companions;

/// A stream's frame counts; zero counts are left out.
pub(super) fn totals(totals: &Totals) -> String {
    let Totals { frames_in, frames_out, stabilized, held, passed_through, damaged, cut, dropped, ref unusable } = *totals;
    let mut words = format!("{frames_in} frames in, {frames_out} out");
    for (count, what) in [
        (stabilized, "stabilized"),
        (held, "repeated"),
        (passed_through, "uncorrected"),
        (damaged, "unusable"),
        (cut, "partly shown"),
        (dropped, "dropped (late)"),
    ] {
        if count > 0 {
            words += &format!(", {count} {what}");
        }
    }
    unusable.in_words(frames_in).map_or(words.clone(), |why| format!("{words}; {why}"))
}

/// Logs that a stream starts, from where to where, and returns the same for the status.
pub(super) fn stream_started(camera: &dyn LiveCamera, output: &dyn Output) -> String {
    let format = camera.format();
    let (from, to) = (camera.path().display().to_string(), output.name());
    let mode = format!("{} {}x{}", format.pixel, format.width, format.height);
    tracing::info!(camera = %from, output = %to, %mode, "stabilizing");
    format!("{from} ({mode}) to {to}")
}

/// A camera as the status shows it.
pub(super) fn camera_info(camera: &dyn LiveCamera) -> CameraInfo {
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

/// Has the status count the PipeWire companions.
pub(super) fn companions(companions: &Companions, state: &DaemonState) {
    let companions = companions.clone();
    state.metrics.set_pipewire(Box::new(move || {
        let (sent, dropped) = companions.counts();
        let pages = companions.pages();
        PipewireInfo {
            companions: companions.connected().saturating_sub(pages),
            watched: companions.watching().saturating_sub(pages),
            pages,
            sent,
            dropped,
        }
    }));
}
