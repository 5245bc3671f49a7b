//! The checks of the processor: its instruction set, and whether it is fast enough, as measured by the daemon or by a short benchmark.

use std::time::Duration;

use super::finding::Finding;
use crate::command::bench::measure;
use crate::config::Settings;
use crate::control::Status;
use crate::frame::Stage;
use crate::image::PixelFormat;
use crate::kernel::{LEVEL_VARIABLE, Level};
use crate::rt::stop::Stop;

/// What webcams give where nothing else is asked for.
const USUAL: ([u32; 2], f64) = ([1280, 720], 30.0);
/// Frames of a rehearsal, at most, and how long it may take.
const REHEARSAL: (u64, Duration) = (60, Duration::from_secs(1));
/// Up to one in so many frames may be dropped late without advice: other programs use the machine, too.
const FEW: u64 = 20;

/// What a frame costs.
#[derive(Clone, Debug, PartialEq)]
struct Cost {
    /// What the frames are, for people.
    frames: String,
    /// The wanted frame rate.
    fps: f64,
    /// Work on a frame, milliseconds of one core.
    work_ms: f64,
    /// Whether that is more than the machine can sustain.
    too_much: bool,
}

/// Looks at the processor: at what the daemon measures of its frames where it streams, else at a rehearsal of one second.
pub(super) fn looked_at(settings: &Settings, status: Option<&Status>) -> Finding {
    let (level, best) = (Level::detected(), Level::best());
    if level < best {
        let what = format!("{LEVEL_VARIABLE}={} disables {}", level.name(), best.name());
        return Finding::advice("processor", what, format!("unset {LEVEL_VARIABLE}"));
    }
    match status.and_then(at_work).or_else(|| rehearsed(settings)) {
        Some(cost) => speed_finding(level.name(), &cost),
        None => Finding::good("processor", format!("using {}", level.name())),
    }
}

fn speed_finding(level: &str, cost: &Cost) -> Finding {
    let Cost { frames, fps, work_ms, too_much } = cost;
    let what = format!("using {level}; {frames}: {work_ms:.1} ms per frame");
    if *too_much {
        let mend = "use a smaller size (camera.width = 640, camera.height = 480) or a lower rate (camera.fps); `gimbald bench` measures what is possible";
        return Finding::advice("processor", format!("{what}: too slow for {fps:.0} fps"), mend);
    }
    Finding::good("processor", format!("{what}, {:.0} % of a core at {fps:.0} fps", 0.1 * work_ms * fps))
}

/// What the daemon measures, where it streams and has said so.
fn at_work(status: &Status) -> Option<Cost> {
    let (camera, work) = (status.camera.as_ref()?, status.work_ms?);
    Some(Cost {
        frames: format!("{}x{} {} (measured by the daemon)", camera.width, camera.height, camera.format),
        fps: camera.fps,
        work_ms: work.p50,
        too_much: status.drops.behind.saturating_mul(FEW) > status.frames.captured,
    })
}

/// What a frame of the synthetic camera costs, as large and as often as the settings ask for. `None` where it cannot be had.
fn rehearsed(settings: &Settings) -> Option<Cost> {
    let asked = [settings.camera.width, settings.camera.height];
    let size = if asked.contains(&0) { USUAL.0 } else { asked };
    let fps = if settings.camera.fps > 0.0 { settings.camera.fps } else { USUAL.1 };
    let pixel = settings.camera.format.filter(|format| RAW.contains(format)).unwrap_or(PixelFormat::Mjpeg);
    let measured = measure(&settings.pipeline, size, pixel, REHEARSAL.0, Some(REHEARSAL.1), &Stop::default()).ok()?;
    let work_ms = measured.stats.total().median_ms;
    let unpack_ms = measured.stats.stage(Stage::Unpack).median_ms;
    Some(Cost {
        frames: format!("{}x{} {pixel} (benchmark)", size[0], size[1]),
        fps,
        work_ms,
        // unpacking has a thread of its own
        too_much: unpack_ms.max(work_ms - unpack_ms) * fps > 1000.0,
    })
}

/// Formats besides MJPEG that a rehearsal has.
const RAW: [PixelFormat; 4] = [PixelFormat::Yuyv, PixelFormat::Uyvy, PixelFormat::Nv12, PixelFormat::I420];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::command::doctor::finding::Severity;
    use crate::control::{CameraInfo, Drops, Frames, Spread};

    #[test]
    fn what_was_measured_is_judged_and_no_instruction_set() {
        let camera = CameraInfo { width: 1280, height: 720, format: "MJPG".into(), fps: 30.0, ..CameraInfo::default() };
        let at = |p50, behind| Status {
            camera: Some(camera.clone()),
            work_ms: Some(Spread { p50, p99: 99.0, max: 99.0 }),
            drops: Drops { behind, ..Drops::default() },
            frames: Frames { captured: 1000, ..Frames::default() },
            ..Status::default()
        };
        let good = speed_finding("neon", &at_work(&at(13.0, 3)).unwrap());
        assert_eq!(good.severity, Severity::Good);
        assert_eq!(
            good.what,
            "using neon; 1280x720 MJPG (measured by the daemon): 13.0 ms per frame, 39 % of a core at 30 fps"
        );
        let slow = speed_finding("scalar", &at_work(&at(51.0, 300)).unwrap());
        assert!(slow.severity == Severity::Advice && slow.mend.contains("camera.width"), "{slow}");
        assert!(slow.what.ends_with("51.0 ms per frame: too slow for 30 fps"), "{slow}");
        assert_eq!(at_work(&Status { camera: None, ..at(13.0, 0) }), None, "it does not stream");
    }

    #[test]
    fn a_rehearsal_is_as_large_as_the_settings_ask_for() {
        let mut settings = Settings::default();
        (settings.camera.width, settings.camera.height, settings.camera.fps) = (160, 120, 5.0);
        settings.camera.format = Some(PixelFormat::Yuyv);
        let cost = rehearsed(&settings).unwrap();
        assert_eq!((cost.frames.as_str(), cost.fps), ("160x120 YUYV (benchmark)", 5.0));
        assert!(cost.work_ms > 0.0);
    }
}
