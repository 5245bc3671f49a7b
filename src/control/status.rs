//! The status of a daemon, as JSON and as text.

use std::collections::BTreeMap;
use std::fmt;

use serde::{Deserialize, Serialize};

/// Everything that a daemon tells of itself. Times in seconds or milliseconds, as the names say.
#[derive(Clone, Debug, Default, Deserialize, PartialEq, Serialize)]
#[serde(default)]
pub struct Status {
    /// Version of the program.
    pub version: String,
    /// The instruction set of its pixel loops: `scalar`, `avx2` or `neon`.
    pub simd: String,
    /// Its process.
    pub pid: u32,
    /// What it is at, one of the names of [`super::Phase`].
    pub state: String,
    /// The same for people.
    pub what: String,
    /// For how long it has been at that.
    pub since_s: f64,
    /// For how long it runs.
    pub uptime_s: f64,
    /// Whether stabilization is enabled.
    pub enabled: bool,
    /// The camera that is open.
    pub camera: Option<CameraInfo>,
    /// Where the picture goes: the loopback, or PipeWire alone.
    pub output: Option<OutputInfo>,
    /// Whether a program watches the loopback or a PipeWire camera; `None` where there is no output.
    pub watched: Option<bool>,
    /// Readers of the loopback; `None` where there is none. v4l2loopback reports its reader since 0.13, 0 or 1. For older versions this is
    /// how often any loopback device is open beside the daemon, an upper bound.
    pub watchers: Option<u32>,
    /// PipeWire companions; `None` where none may connect.
    pub pipewire: Option<PipewireInfo>,
    /// Programs that hold the loopback open, as far as the asking process may look: a daemon without rights does not know, and tells none.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub open_in: Vec<String>,
    /// Frames sent a second, of late.
    pub fps: f64,
    /// Age of frames when they were sent, of late.
    pub latency_ms: Option<Spread>,
    /// Part of that in which they were worked on.
    pub work_ms: Option<Spread>,
    /// Frames, since the daemon began.
    pub frames: Frames,
    /// Frames that were not shown as they should have been, since the daemon began.
    pub drops: Drops,
    /// Frames of these that could not be used, by the names of [`crate::pipeline::Reason`], since the daemon began; only reasons that
    /// occurred.
    pub unusable_frames: BTreeMap<String, u64>,
    /// Why, for the present stream or, where the camera is closed, the last one; `None` where all its frames could be used.
    pub unusable: Option<Unusable>,
    /// Formats of cameras that gave no usable frame and were left for another, since the daemon began.
    pub formats_left: Vec<RejectedFormat>,
    /// Times a camera was opened.
    pub cameras_opened: u64,
    /// Share of the crop window that corrections used, of late (0 to 1).
    pub crop_use: Option<Spread>,
    /// Points that agreed with the camera's motion in the newest frame ...
    pub inliers: u64,
    /// ... of so many that were followed.
    pub tracks: u64,
    /// How far the newest frame's motion is believed (0 to 1).
    pub confidence: f64,
    /// How far corrections are believed (0 to 1); moves slowly.
    pub trust: f64,
    /// Calibration of the camera.
    pub found: Option<Found>,
    /// The configuration file, where it was started with one.
    pub configuration: Option<String>,
    /// Every setting, by key, as TOML writes its value.
    pub settings: BTreeMap<String, String>,
    /// Keys that have another value in the configuration, and wait for a restart.
    pub restart: Vec<String>,
}

/// An open camera.
#[derive(Clone, Debug, Default, Deserialize, PartialEq, Serialize)]
#[serde(default)]
pub struct CameraInfo {
    /// Its node.
    pub path: String,
    /// Its name.
    pub name: String,
    /// Where it is plugged in.
    pub bus: String,
    /// Pixel format.
    pub format: String,
    /// Pixels.
    pub width: u32,
    /// Pixels.
    pub height: u32,
    /// Frames a second that were agreed upon.
    pub fps: f64,
}

/// An open output.
#[derive(Clone, Debug, Default, Deserialize, PartialEq, Serialize)]
#[serde(default)]
pub struct OutputInfo {
    /// The loopback's node, or "PipeWire".
    pub path: String,
    /// Pixel format.
    pub format: String,
    /// Pixels.
    pub width: u32,
    /// Pixels.
    pub height: u32,
}

/// PipeWire companions, and the pictures they got.
#[derive(Clone, Copy, Debug, Default, Deserialize, PartialEq, Eq, Serialize)]
#[serde(default)]
pub struct PipewireInfo {
    /// Companions that are connected: one in each user's session.
    pub companions: u32,
    /// Companions whose camera is watched, each by any number of programs.
    pub watched: u32,
    /// Open pages of `gimbald view`.
    #[serde(default)]
    pub pages: u32,
    /// Pictures sent to companions, since the daemon began.
    pub sent: u64,
    /// Pictures that a companion missed because it had no memory free, since the daemon began.
    pub dropped: u64,
}

/// How values of late are spread.
#[derive(Clone, Copy, Debug, Default, Deserialize, PartialEq, Serialize)]
pub struct Spread {
    /// Median.
    pub p50: f64,
    /// 99th percentile.
    pub p99: f64,
    /// Largest.
    pub max: f64,
}

/// Frames, by what became of them.
#[derive(Clone, Copy, Debug, Default, Deserialize, PartialEq, Eq, Serialize)]
#[serde(default)]
pub struct Frames {
    /// Frames that cameras gave.
    pub captured: u64,
    /// Frames that were sent.
    pub sent: u64,
    /// Of these, stabilized.
    pub stabilized: u64,
    /// Of these, the picture before once more.
    pub held: u64,
    /// Of these, shown uncorrected.
    pub passed_through: u64,
}

/// Frames that were not shown as they should have been, by cause.
#[derive(Clone, Copy, Debug, Default, Deserialize, PartialEq, Eq, Serialize)]
#[serde(default)]
pub struct Drops {
    /// The camera counted them but did not give them.
    pub camera_missing: u64,
    /// The camera had a newer one when they were asked for.
    pub camera_stale: u64,
    /// They could not be used; [`Status::unusable_frames`] has them by reason.
    pub damaged: u64,
    /// Their end was missing, and the picture's before was shown in its place.
    pub cut: u64,
    /// A newer one was there before they could be worked on.
    pub behind: u64,
    /// Not frames, but transfers from the camera that failed: the driver gave all its buffers back empty. What frames were lost by
    /// one is not known.
    pub failed_transfers: u64,
    /// Not frames, but times a stream was stopped and started because it failed, gave nothing or nothing usable.
    pub restarts: u64,
}

/// Frames of a stream that could not be used.
#[derive(Clone, Debug, Default, Deserialize, PartialEq, Eq, Serialize)]
#[serde(default)]
pub struct Unusable {
    /// So many ...
    pub frames: u64,
    /// ... of so many.
    pub of: u64,
    /// The most frequent reason, one of the names of [`crate::pipeline::Reason`].
    pub reason: String,
    /// All of it in words.
    pub what: String,
}

/// A format of a camera that gave no usable frame.
#[derive(Clone, Debug, Default, Deserialize, PartialEq, Eq, Serialize)]
#[serde(default)]
pub struct RejectedFormat {
    /// The camera's name.
    pub camera: String,
    /// Its pixel format.
    pub format: String,
    /// Why, in words.
    pub what: String,
}

/// Calibration of the camera; a deviation of 0 means that the value was configured.
#[derive(Clone, Copy, Debug, Default, Deserialize, PartialEq, Serialize)]
#[serde(default)]
pub struct Found {
    /// From the exposure of the first row to that of the last.
    pub readout_ms: f64,
    /// Its standard deviation.
    pub readout_deviation_ms: f64,
    /// Horizontal field of view, degrees.
    pub hfov_deg: f64,
    /// Its standard deviation.
    pub hfov_deviation_deg: f64,
    /// The lens's radial distortion k1.
    pub lens_k1: f64,
    /// Its standard deviation.
    pub lens_k1_deviation: f64,
}

/// A length of time as people say it.
fn lasting(seconds: f64) -> String {
    let whole = seconds.max(0.0) as u64;
    match whole {
        0..60 => format!("{whole} s"),
        60..3600 => format!("{} min {} s", whole / 60, whole % 60),
        3600..86_400 => format!("{} h {} min", whole / 3600, whole % 3600 / 60),
        _ => format!("{} d {} h", whole / 86_400, whole % 86_400 / 3600),
    }
}

/// Text from a device may hold anything; a terminal gets no control characters.
fn plain(text: &str) -> String {
    text.chars().map(|c| if c.is_control() { ' ' } else { c }).collect()
}

/// A line of the text: its label, and what it says.
type Line = (&'static str, String);

impl Status {
    /// State, devices and viewers.
    fn device_lines(&self) -> Vec<Line> {
        let on = if self.enabled { "" } else { "; stabilization is off, enable it with `gimbald on`" };
        let camera = self.camera.as_ref().map_or_else(
            || "closed".into(),
            |camera| {
                let CameraInfo { path, name, bus, format, width, height, fps } = camera;
                format!("{path}  {name} ({bus}), {format} {width}x{height} at {fps:.3} fps")
            },
        );
        let output = self.output.as_ref().map_or_else(
            || "not open".into(),
            |output| {
                let OutputInfo { path, format, width, height } = output;
                format!("{path}  {format} {width}x{height}")
            },
        );
        let mut lines = vec![
            ("state", format!("{} for {}{on}", self.state, lasting(self.since_s))),
            ("", self.what.clone()),
            ("camera", camera),
            ("output", output),
        ];
        if let Some(watched) = self.watched {
            lines.push(("viewers", self.viewers(watched)));
        }
        if let Some(PipewireInfo { companions, sent, dropped, .. }) = self.pipewire {
            let connected = match companions {
                0 => "no companions".to_owned(),
                1 => "1 companion".to_owned(),
                count => format!("{count} companions"),
            };
            lines.push(("pipewire", format!("{connected}; {sent} frames sent, {dropped} dropped")));
        }
        lines
    }

    /// The viewers of each output, and the programs that have the loopback open.
    fn viewers(&self, watched: bool) -> String {
        let mut viewers = Vec::new();
        match self.watchers {
            None | Some(0) => {}
            Some(1) => viewers.push("loopback: 1 program".to_owned()),
            Some(count) => viewers.push(format!("loopback: up to {count} programs")),
        }
        match self.pipewire.map_or(0, |pipewire| pipewire.watched) {
            0 => {}
            1 => viewers.push("1 PipeWire camera".to_owned()),
            count => viewers.push(format!("{count} PipeWire cameras")),
        }
        match self.pipewire.map_or(0, |pipewire| pipewire.pages) {
            0 => {}
            1 => viewers.push("1 page of `gimbald view`".to_owned()),
            count => viewers.push(format!("{count} pages of `gimbald view`")),
        }
        let text = if viewers.is_empty() { if watched { "yes" } else { "none" }.to_owned() } else { viewers.join(", ") };
        if self.open_in.is_empty() { text } else { format!("{text}; open in {}", self.open_in.join(", ")) }
    }

    /// Frame rate, times, counts, and what went wrong.
    fn frame_lines(&self) -> Vec<Line> {
        let times = |spread: Spread| {
            let Spread { p50, p99, max } = spread;
            format!("median {p50:.1} ms, p99 {p99:.1} ms, max {max:.1} ms")
        };
        let mut lines = vec![("frame rate", format!("{:.2} fps", self.fps))];
        lines.extend(self.latency_ms.map(|spread| ("latency", times(spread))));
        lines.extend(self.work_ms.map(|spread| ("  processing", times(spread))));
        let Frames { captured, sent, stabilized, held, passed_through } = self.frames;
        lines.push(("frames", format!("{captured} captured, {sent} sent")));
        lines.push(("  of which", format!("{stabilized} stabilized, {held} repeated, {passed_through} uncorrected")));
        lines.push(("problems", self.drops.text()));
        lines.extend(self.unusable.iter().map(|unusable| ("unusable", unusable.what.clone())));
        let rejected = |left: &RejectedFormat| ("rejected", format!("{} of {}: {}", left.format, left.camera, left.what));
        lines.extend(self.formats_left.iter().map(rejected));
        lines
    }

    /// Motion, calibration, and the process.
    fn motion_lines(&self) -> Vec<Line> {
        let mut lines = Vec::new();
        if let Some(Spread { p50, max, .. }) = self.crop_use {
            lines.push(("crop margin", format!("median {:.0} % used, max {:.0} %", 100.0 * p50, 100.0 * max)));
        }
        let Self { inliers, tracks, confidence, trust, .. } = self;
        let motion = format!("{inliers} of {tracks} points are inliers, confidence {confidence:.2}, trust {trust:.2}");
        lines.push(("motion", motion));
        if let Some(Found { readout_ms, readout_deviation_ms, hfov_deg, hfov_deviation_deg, lens_k1, lens_k1_deviation }) =
            self.found
        {
            let known = |value: f64, deviation: f64, unit: &str| match deviation {
                0.0 => format!("{value:.1} {unit} (configured)"),
                _ => format!("{value:.1} ± {deviation:.1} {unit}"),
            };
            let (readout, hfov) =
                (known(readout_ms, readout_deviation_ms, "ms"), known(hfov_deg, hfov_deviation_deg, "degrees"));
            let lens = match lens_k1_deviation {
                0.0 => format!("{lens_k1:.3} (configured)"),
                _ => format!("{lens_k1:.3} ± {lens_k1_deviation:.3}"),
            };
            lines.push(("calibration", format!("readout {readout}, field of view {hfov}, lens k1 {lens}")));
        }
        if !self.restart.is_empty() {
            lines.push(("restart", format!("required to apply {}", self.restart.join(", "))));
        }
        let simd = if self.simd.is_empty() { String::new() } else { format!(", pixel loops {}", self.simd) };
        let uptime = lasting(self.uptime_s);
        lines.push(("process", format!("{}, version {}{simd}, running for {uptime}", self.pid, self.version)));
        lines
    }
}

impl Drops {
    /// The counts that are not zero; "none" where all are.
    pub fn text(&self) -> String {
        let Self { camera_missing, camera_stale, damaged, cut, behind, failed_transfers, restarts } = *self;
        let counts = [
            (camera_missing, "missing from the camera"),
            (camera_stale, "dropped at the camera (late)"),
            (damaged, "damaged"),
            (cut, "partly shown"),
            (behind, "dropped (late)"),
            (failed_transfers, if failed_transfers == 1 { "failed transfer" } else { "failed transfers" }),
            (restarts, if restarts == 1 { "restart of the stream" } else { "restarts of the stream" }),
        ];
        let counts = counts.into_iter().filter(|(count, _)| *count > 0).map(|(count, what)| format!("{count} {what}"));
        let text = counts.collect::<Vec<_>>().join(", ");
        if text.is_empty() { "none".into() } else { text }
    }
}

impl fmt::Display for Status {
    /// Some twenty lines for people.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let lines = [self.device_lines(), self.frame_lines(), self.motion_lines()];
        lines.into_iter().flatten().try_for_each(|(label, text)| writeln!(f, "{label:<15}{}", plain(&text)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn people_read_it_and_programs_too() {
        let status = Status {
            state: "streaming".into(),
            version: "1.2".into(),
            simd: "neon".into(),
            since_s: 3725.0,
            camera: Some(CameraInfo { name: "Evil\u{1b}[2J\nname".into(), ..CameraInfo::default() }),
            latency_ms: Some(Spread { p50: 12.0, p99: 18.5, max: 40.0 }),
            drops: Drops { behind: 3, damaged: 1, failed_transfers: 1, ..Drops::default() },
            unusable: Some(Unusable {
                frames: 1,
                of: 9,
                what: "1 of 9 frames cannot be decoded: x\u{1b}".into(),
                ..Unusable::default()
            }),
            formats_left: vec![RejectedFormat { camera: "C".into(), format: "MJPG".into(), what: "nothing came".into() }],
            restart: vec!["camera.device".into()],
            watched: Some(true),
            watchers: Some(1),
            pipewire: Some(PipewireInfo { companions: 3, watched: 2, pages: 1, sent: 70, dropped: 1 }),
            open_in: vec!["zoom (12)".into()],
            ..Status::default()
        };
        let text = status.to_string();
        for part in [
            "streaming for 1 h 2 min; stabilization is off",
            "Evil [2J name",
            "p99 18.5 ms",
            "1 damaged, 3 dropped (late), 1 failed transfer\n",
            "unusable       1 of 9 frames cannot be decoded: x \n",
            "rejected       MJPG of C: nothing came\n",
            "camera.device",
            "viewers        loopback: 1 program, 2 PipeWire cameras, 1 page of `gimbald view`; open in zoom (12)\n",
            "pipewire       3 companions; 70 frames sent, 1 dropped\n",
            "version 1.2, pixel loops neon, running for",
        ] {
            assert!(text.contains(part), "{part} in\n{text}");
        }
        assert!(!text.contains('\u{1b}'));
        let idle = Status { watched: Some(false), pipewire: Some(PipewireInfo::default()), ..Status::default() }.to_string();
        assert!(idle.contains("viewers        none\npipewire       no companions;"), "{idle}");
        let json = serde_json::to_string(&status).unwrap();
        assert_eq!(serde_json::from_str::<Status>(&json).unwrap(), status);
        // a newer or older daemon's answer is read as far as it goes
        let other: Status = serde_json::from_str("{\"state\":\"idle\",\"new\":1}").unwrap();
        assert_eq!(other.state, "idle");
    }
}
