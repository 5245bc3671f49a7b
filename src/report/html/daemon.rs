//! The page about a running daemon: the last minute, to be attached to a report of a fault. It says nothing of the user unless asked to: what
//! it shows is named here, one by one, and everything else stays out.

use maud::{Markup, html};

use super::picture::jpeg_url;
use super::plot::{Plot, Series};
use super::sections::{cost, fact, motion, page, path, remaining_shake, settings, trust};
use super::{Journal, Sample};
use crate::config::{Key, Kind, Settings, keys};
use crate::control::{CameraInfo, Found, FrameRecord, Status};
use crate::frame::{Outcome, PathParameters};
use crate::report::{EncodedPair, MotionNames, Stats};

/// Seconds that are shown.
const SHOWN_S: f64 = 60.0;
/// Two frames further apart than this (seconds) are not joined by a line: the camera was closed, or gave nothing.
const GAP_S: f64 = 1.0;
const UNKNOWN: PathParameters = PathParameters([f64::NAN; 4]);

/// What the page is made of.
#[derive(Clone, Copy, Debug)]
pub struct DaemonReport<'a> {
    /// The daemon's state.
    pub status: &'a Status,
    /// Its last frames, oldest first.
    pub frames: &'a [FrameRecord],
    /// Pictures of input and output.
    pub pictures: &'a [EncodedPair],
    /// Whether names and paths may be shown: of devices, and in settings.
    pub with_names: bool,
}

impl DaemonReport<'_> {
    /// The page.
    pub fn html(&self) -> String {
        let status = self.status;
        // Keys that this program does not know are of another version.
        let known = status.settings.iter().filter(|(name, _)| keys::find(name).is_some());
        let sets: Vec<String> = known.map(|(name, value)| format!("{name}={value}")).collect();
        let read = Settings::read(None, &sets).unwrap_or_default();
        let records = self.last_records();
        let journal = journal(&records, &read);
        let times: Vec<f64> = relative(&journal);
        let mut stats = Stats::default();
        records.iter().for_each(|record| stats.add_times(&record.spent_ms.map(|ms| (f64::from(ms) * 1e6) as u64)));
        let body = html! {
            (self.head(&records, &journal))
            (service(status, self.with_names))
            (pictures(self.pictures))
            @if !records.is_empty() {
                (motion(&journal, &times))
                (path(&journal, &times))
                (trust(&journal, &times))
                (age(&records, &times, &journal))
                (cost(&journal, &stats, &times))
            }
            (settings(&read, |key| self.with_names || !may_name(key)))
        };
        page("gimbald: report of a running service", &body)
    }

    /// The frames of the last minute before the newest one.
    fn last_records(&self) -> Vec<FrameRecord> {
        let newest = self.frames.last().map_or(0.0, |frame| frame.time_s);
        // A camera's clock may jump between streams.
        let is_shown = |frame: &&FrameRecord| (0.0..=SHOWN_S).contains(&(newest - frame.time_s));
        self.frames.iter().filter(is_shown).copied().collect()
    }

    fn head(&self, records: &[FrameRecord], journal: &Journal) -> Markup {
        let left_out = match (self.with_names, self.pictures.is_empty()) {
            (false, true) => "no names of programs or devices, no serial numbers, no paths and no pictures",
            (false, false) => "no names of programs or devices, no serial numbers and no paths, but pictures of the camera",
            (true, true) => "names and paths of devices, but no names of programs and no pictures",
            (true, false) => "names and paths of devices, and pictures of the camera",
        };
        html! {
            p { "Made by " code { "gimbald report" } " to be attached to a bug report. It contains " (left_out) "." }
            @if let (Some(first), Some(last)) = (records.first(), records.last()) {
                p {
                    "The " (records.len()) " frames of the last " (format!("{:.1}", last.time_s - first.time_s))
                    " s in which the camera was on, stabilized with the model " code { (journal.names.name) } "."
                }
                (facts(records, last, journal))
            } @else {
                p { "The service has processed no frames since it started." }
            }
        }
    }
}

/// The frames in a few numbers; `newest` is the last of them.
fn facts(records: &[FrameRecord], newest: &FrameRecord, journal: &Journal) -> Markup {
    let most = records.iter().map(|record| f64::from(record.crop_use)).fold(0.0, f64::max);
    let least = records.iter().map(|record| f64::from(record.trust)).fold(1.0, f64::min);
    let count = |wanted: fn(Outcome) -> bool| records.iter().filter(|record| wanted(record.outcome())).count();
    let [held, passed] = [count(|o| matches!(o, Outcome::Held(_))), count(|o| matches!(o, Outcome::PassedThrough(_)))];
    let stabilized = count(|o| o == Outcome::Stabilized);
    html! {
        dl.facts {
            (remaining_shake(journal))
            (fact("crop margin used", &format!("{:.0} %", 100.0 * most), "maximum; 100 % reaches the edge"))
            (fact("trust", &format!("{:.2}", newest.trust), &format!("newest; minimum {least:.2}")))
            (fact("frames stabilized", &stabilized.to_string(), &format!("{held} held, {passed} passed through")))
        }
    }
}

/// Whether the value of a key may name something of the user's: a device, a file, a group.
fn may_name(key: &Key) -> bool {
    matches!(key.kind, Kind::Text { .. } | Kind::Form { .. })
}

/// The frames as plots show them, with a gap where frames are missing for long.
fn journal(records: &[FrameRecord], settings: &Settings) -> Journal {
    let names = MotionNames::of(settings.pipeline.shutter.model);
    let mut samples: Vec<Sample> = Vec::with_capacity(records.len());
    let mut before: Option<(&FrameRecord, Sample)> = None;
    for record in records {
        let mut sample = sample(record);
        let held = matches!(sample.outcome, Outcome::Held(_));
        match before {
            Some((last, _)) if record.time_s - last.time_s > GAP_S => {
                let mut gap = sample;
                gap.time_ns = sample.time_ns - 1_000_000;
                for unknown in [&mut gap.path, &mut gap.smoothed, &mut gap.motion] {
                    *unknown = UNKNOWN;
                }
                gap.crop_shares = UNKNOWN.0;
                [gap.trust, gap.confidence, gap.crop_use, gap.spent_ms] = UNKNOWN.0;
                samples.push(gap);
                sample.motion = UNKNOWN;
            }
            Some((_, last)) if !held => {
                sample.steadied = names.steadied([last.path, sample.path], [last.smoothed, sample.smoothed]);
            }
            _ => sample.motion = UNKNOWN,
        }
        if held {
            // A picture shown again moved nothing and measured nothing.
            (sample.path, sample.smoothed, sample.motion) = (UNKNOWN, UNKNOWN, UNKNOWN);
        } else {
            before = Some((record, sample));
        }
        samples.push(sample);
    }
    Journal { names, samples }
}

fn sample(record: &FrameRecord) -> Sample {
    let four = |values: [f32; 4]| values.map(f64::from);
    Sample {
        time_ns: (record.time_s * 1e9) as i64,
        interval_s: f64::from(record.interval_s),
        outcome: record.outcome(),
        motion: PathParameters(four(record.motion)),
        steadied: UNKNOWN,
        path: PathParameters(four(record.path)),
        smoothed: PathParameters(four(record.smoothed)),
        sheared: [f64::NAN; 2],
        calibration: None,
        tracks: record.tracks as u32,
        inliers: record.inliers as u32,
        confidence: f64::from(record.confidence),
        trust: f64::from(record.trust),
        crop_use: f64::from(record.crop_use),
        crop_shares: four(record.crop_shares),
        spent_ms: f64::from(record.spent_ms.iter().sum::<f32>()),
    }
}

/// Seconds before the newest frame; never positive.
fn relative(journal: &Journal) -> Vec<f64> {
    let newest = journal.samples.last().map_or(0, |sample| sample.time_ns);
    journal.samples.iter().map(|sample| sample.time_ns.saturating_sub(newest) as f64 * 1e-9).collect()
}

/// The service in words: only what is named here.
fn service(status: &Status, with_names: bool) -> Markup {
    html! {
        h2 { "Service" }
        div.wide {
            table { @for (name, value) in rows(status, with_names) { tr { td { (name) } td { (value) } } } }
        }
    }
}

/// Its rows: a name, and what is to be said.
fn rows(status: &Status, with_names: bool) -> Vec<(&'static str, String)> {
    let mut rows = Vec::new();
    let mut row = |name: &'static str, value: String| rows.push((name, value));
    row("version", format!("{}, pixel loops {}", status.version, status.simd));
    let on = if status.enabled { "on" } else { "off" };
    row(
        "state",
        format!("{} for {:.0} s, stabilization {on}; running for {:.0} s", status.state, status.since_s, status.uptime_s),
    );
    let camera = |camera: &CameraInfo| {
        let CameraInfo { format, width, height, fps, .. } = camera;
        format!("{format} {width}x{height} at {fps:.3} fps")
    };
    row("camera", status.camera.as_ref().map_or("closed".into(), camera));
    let kind = |path: &str| if path == "PipeWire" { "PipeWire only" } else { "loopback" };
    let output = status.output.as_ref();
    row("output", output.map_or("not open".into(), |o| format!("{}, {} {}x{}", kind(&o.path), o.format, o.width, o.height)));
    if with_names {
        let camera = status.camera.as_ref().map(|c| format!("{} {} ({})", c.path, c.name, c.bus));
        let output = output.map(|output| output.path.clone());
        row("devices", [camera, output].into_iter().flatten().collect::<Vec<_>>().join(", "));
        row("activity", status.what.clone());
    }
    if let Some(readers) = status.watchers {
        row("readers of the loopback", readers.to_string());
    }
    if let Some(p) = status.pipewire {
        let text = format!(
            "{} companions, {} cameras in use, {} pages; {} frames sent, {} dropped",
            p.companions, p.watched, p.pages, p.sent, p.dropped
        );
        row("PipeWire", text);
    }
    let frames = status.frames;
    row("frame rate", format!("{:.2} fps", status.fps));
    row("frames since the start", format!("{} captured, {} sent", frames.captured, frames.sent));
    let text = format!("{} stabilized, {} repeated, {} uncorrected", frames.stabilized, frames.held, frames.passed_through);
    row("of which", text);
    row("problems since the start", status.drops.text());
    for (reason, count) in &status.unusable_frames {
        row("unusable frames", format!("{count}: {reason}"));
    }
    for left in &status.formats_left {
        row("rejected format", left.format.clone());
    }
    row("cameras opened", status.cameras_opened.to_string());
    if let Some(found) = status.found {
        row("calibration", calibration(&found));
    }
    if !status.restart.is_empty() {
        row("restart required for", status.restart.join(", "));
    }
    rows
}

fn calibration(found: &Found) -> String {
    let known = |value: f64, deviation: f64, digits: usize| match deviation {
        0.0 => format!("{value:.digits$} (configured)"),
        _ => format!("{value:.digits$} ± {deviation:.digits$}"),
    };
    format!(
        "readout {} ms, field of view {} degrees, lens k1 {}",
        known(found.readout_ms, found.readout_deviation_ms, 1),
        known(found.hfov_deg, found.hfov_deviation_deg, 1),
        known(found.lens_k1, found.lens_k1_deviation, 3)
    )
}

/// Input and output side by side. Each pair is in the page once: its second half is shown by reference.
fn pictures(pictures: &[EncodedPair]) -> Markup {
    html! {
        @if !pictures.is_empty() {
            h2 { "Pictures" }
            p { "Taken one second apart when this page was made." }
        }
        @for (index, EncodedPair { size: [width, height], jpeg, .. }) in pictures.iter().enumerate() {
            @let id = format!("pair{index}");
            figure {
                div.pair {
                    div {
                        svg viewBox=(format!("0 {height} {width} {height}")) role="img" aria-label="before" {
                            image id=(id) width=(width) height=(2 * height) href=(jpeg_url(jpeg)) {}
                        }
                        span { "before" }
                    }
                    div {
                        svg viewBox=(format!("0 0 {width} {height}")) role="img" aria-label="after" { use href=(format!("#{id}")) {} }
                        span { "after" }
                    }
                }
            }
        }
    }
}

/// Latency of each frame.
fn age(records: &[FrameRecord], times: &[f64], journal: &Journal) -> Markup {
    // The journal has gaps between the records.
    let mut ages = records.iter().map(|record| f64::from(record.age_ms));
    let values = journal.samples.iter().map(|s| if s.spent_ms.is_nan() { f64::NAN } else { ages.next().unwrap_or(f64::NAN) });
    let plot = Plot {
        title: "Age of frames when they were sent".into(),
        note: "since the exposure of the first row, as the driver reports it".into(),
        unit: "ms",
        times,
        series: vec![Series { label: "age".into(), class: "after", values: values.collect() }],
        limit: None,
        least: Some((0.0, 1.0)),
    };
    html! { h2 { "Latency" } (plot.figure()) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::{Drops, OutputInfo, RejectedFormat, Unusable};
    use crate::frame::Stage;

    fn record(number: u64, time_s: f64) -> FrameRecord {
        let part = number as f32;
        FrameRecord {
            number,
            time_s,
            path: [0.01 * part; 4],
            smoothed: [0.005 * part; 4],
            motion: [0.01 * (number % 2) as f32; 4],
            trust: 1.0,
            spent_ms: [0.5; Stage::ALL.len()],
            age_ms: 20.0,
            ..FrameRecord::default()
        }
    }

    /// A status in which every text that may name something has a mark of its own.
    fn marked() -> Status {
        let text = |mark: &str| format!("SECRET-{mark}");
        let camera = CameraInfo {
            path: text("by-id-serial"),
            name: text("camera"),
            bus: text("bus"),
            format: "MJPG".into(),
            ..CameraInfo::default()
        };
        let mut status = Status {
            what: text("what"),
            camera: Some(camera),
            output: Some(OutputInfo { path: text("loopback"), ..OutputInfo::default() }),
            open_in: vec![text("program")],
            unusable: Some(Unusable { what: text("unusable"), ..Unusable::default() }),
            formats_left: vec![RejectedFormat { camera: text("left"), what: text("why"), format: "YUYV".into() }],
            configuration: Some(text("file")),
            drops: Drops { damaged: 3, ..Drops::default() },
            pid: 987_654,
            ..Status::default()
        };
        let defaults = Settings::default();
        for key in keys::KEYS {
            status.settings.insert(key.name.into(), key.value_text(&defaults));
        }
        for name in ["camera.device", "output.device", "control.socket"] {
            status.settings.insert(name.into(), format!("\"/dev/{}\"", text(name)));
        }
        status.settings.insert("crop.zoom".into(), "1.25".into());
        status
    }

    #[test]
    fn nothing_that_names_the_user_is_in_it_unless_asked_for() {
        let (status, frames) = (marked(), [record(0, 5.0), record(1, 5.04)]);
        let page = |with_names| DaemonReport { status: &status, frames: &frames, pictures: &[], with_names }.html();
        let plain = page(false);
        assert!(!plain.contains("SECRET") && !plain.contains("987654"), "{plain}");
        for words in [
            "<code>camera.device</code></td><td>(left out)",
            "<code>crop.zoom</code></td><td>1.25",
            "MJPG",
            "YUYV",
            "3 damaged",
        ] {
            assert!(plain.contains(words), "{words} in {plain}");
        }
        let named = page(true);
        assert!(
            ["by-id-serial", "camera", "loopback", "camera.device"]
                .iter()
                .all(|mark| named.contains(&format!("SECRET-{mark}")))
        );
        assert!(!named.contains("SECRET-program"), "names of programs are never in it");
    }

    #[test]
    fn pictures_are_in_it_only_where_there_are_some() {
        let status = Status::default();
        let pair = EncodedPair { size: [4, 2], input: [4, 2], jpeg: vec![1, 2, 3] };
        let page = |pictures: &[EncodedPair]| DaemonReport { status: &status, frames: &[], pictures, with_names: false }.html();
        assert!(!page(&[]).contains("<image") && page(&[]).contains("no pictures"));
        let with = page(&[pair.clone(), pair]);
        assert_eq!((with.matches("<image id=\"pair").count(), with.matches("<use ").count()), (2, 2));
        assert!(
            with.matches("base64,AQID").count() == 2
                && with.contains("but pictures of the camera")
                && with.contains("has processed no frames")
        );
    }

    #[test]
    fn the_last_minute_is_shown_and_a_pause_is_a_gap() {
        let mut frames: Vec<FrameRecord> = (0..4000).map(|n| record(n, 100.0 + 0.0251 * n as f64)).collect();
        frames.drain(3000..3200);
        let status = Status::default();
        let report = DaemonReport { status: &status, frames: &frames, pictures: &[], with_names: false };
        let records = report.last_records();
        assert_eq!((records.len(), records[0].number), (2191, 1609));
        let journal = journal(&records, &Settings::default());
        assert_eq!(journal.samples.len(), 2192, "and a gap");
        assert_eq!(journal.samples.iter().filter(|sample| sample.path[0].is_nan()).count(), 1);
        let times = relative(&journal);
        assert!((times[0] + 59.989).abs() < 1e-6 && times[2191] == 0.0 && times.is_sorted());
        let html = report.html();
        assert!(html.contains("2191 frames of the last 60.0 s") && !html.contains("NaN"), "{html}");
        assert!(html.contains("remaining shake, yaw"), "{html}");
    }
}
