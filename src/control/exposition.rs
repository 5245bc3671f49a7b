//! The status in Prometheus' text format, version 0.0.4.

use std::fmt::Write as _;

use super::metrics::{AGE_BOUNDS_MS, Metrics, Phase};
use super::{Drops, Found, Frames, PipewireInfo, Status};
use crate::pipeline::Reason;

/// Writes metrics one by one.
struct Text(String);

impl Text {
    fn family(&mut self, name: &str, kind: &str, help: &str) {
        let _ = writeln!(self.0, "# HELP gimbald_{name} {help}\n# TYPE gimbald_{name} {kind}");
    }

    fn value(&mut self, name: &str, labels: &[(&str, &str)], value: f64) {
        let labels: Vec<String> = labels.iter().map(|(label, text)| format!("{label}=\"{}\"", escaped(text))).collect();
        let labels = if labels.is_empty() { String::new() } else { format!("{{{}}}", labels.join(",")) };
        let _ = writeln!(self.0, "gimbald_{name}{labels} {value}");
    }

    fn gauge(&mut self, name: &str, help: &str, value: f64) {
        self.family(name, "gauge", help);
        self.value(name, &[], value);
    }

    fn count(&mut self, name: &str, help: &str, count: u64) {
        self.family(name, "counter", help);
        self.value(name, &[], count as f64);
    }

    /// A count for each value of one label.
    fn counts(&mut self, name: &str, help: &str, label: &str, counts: &[(&str, u64)]) {
        self.family(name, "counter", help);
        counts.iter().for_each(|(which, count)| self.value(name, &[(label, which)], *count as f64));
    }

    /// Frames that were lost or unusable, failed transfers, restarts.
    fn problems(&mut self, status: &Status) {
        let Drops { camera_missing, camera_stale, damaged, cut, behind, failed_transfers, restarts } = status.drops;
        let causes = [
            ("camera_missing", camera_missing),
            ("camera_stale", camera_stale),
            ("damaged", damaged),
            ("cut", cut),
            ("behind", behind),
        ];
        self.counts("lost_frames_total", "Frames that were not shown, or only in part, by cause.", "cause", &causes);
        let reasons = Reason::ALL.map(Reason::name).map(|name| (name, status.unusable_frames.get(name).copied().unwrap_or(0)));
        self.counts("unusable_frames_total", "Unusable frames, by reason.", "reason", &reasons);
        self.count("failed_transfers_total", "Failed transfers from cameras.", failed_transfers);
        self.count("stream_restarts_total", "Restarts of camera streams after failures.", restarts);
    }

    /// The histogram of the time from capture to output.
    fn latency(&mut self, metrics: &Metrics) {
        self.family("latency_seconds", "histogram", "Time from capture to output.");
        let (ages, sum_s) = metrics.ages();
        let mut below = 0;
        for (count, bound_ms) in ages.iter().zip(AGE_BOUNDS_MS) {
            below += count;
            self.value("latency_seconds_bucket", &[("le", &(bound_ms / 1e3).to_string())], below as f64);
        }
        let all: u64 = ages.iter().sum();
        self.value("latency_seconds_bucket", &[("le", "+Inf")], all as f64);
        self.value("latency_seconds_sum", &[], sum_s);
        self.value("latency_seconds_count", &[], all as f64);
    }
}

/// A label's value as the format wants it.
fn escaped(text: &str) -> String {
    text.replace('\\', "\\\\").replace('"', "\\\"").replace('\n', "\\n")
}

/// All metrics of a daemon.
pub(super) fn text(status: &Status, metrics: &Metrics) -> String {
    let mut text = Text(String::new());
    text.family("info", "gauge", "Version, and the devices that are open.");
    let (camera, output) = (status.camera.clone().unwrap_or_default(), status.output.clone().unwrap_or_default());
    let labels =
        [("version", &status.version), ("camera", &camera.path), ("camera_name", &camera.name), ("output", &output.path)];
    text.value("info", &labels.map(|(label, value)| (label, value.as_str())), 1.0);
    text.family("state", "gauge", "1 for the present state.");
    for state in Phase::ALL {
        text.value("state", &[("state", state.name())], f64::from(u8::from(state.name() == status.state)));
    }
    text.gauge("state_seconds", "Seconds in the present state.", status.since_s);
    text.gauge("uptime_seconds", "Seconds since the daemon started.", status.uptime_s);
    text.gauge("enabled", "Whether stabilization is enabled.", f64::from(u8::from(status.enabled)));
    if let Some(watched) = status.watched {
        text.gauge(
            "watched",
            "Whether the loopback, a PipeWire camera or a page of gimbald view has viewers.",
            f64::from(u8::from(watched)),
        );
    }
    if let Some(watchers) = status.watchers {
        text.gauge("watchers", "Viewers of the loopback, as reported by v4l2loopback.", f64::from(watchers));
    }
    if let Some(PipewireInfo { companions, watched, pages, sent, dropped }) = status.pipewire {
        text.gauge("pipewire_companions", "Connected PipeWire companions.", f64::from(companions));
        text.gauge("pipewire_watched", "PipeWire companions whose camera has viewers.", f64::from(watched));
        text.gauge("pages", "Open pages of gimbald view, which count as viewers.", f64::from(pages));
        text.count("pipewire_sent_frames_total", "Frames sent to PipeWire companions.", sent);
        text.count(
            "pipewire_dropped_frames_total",
            "Frames that a PipeWire companion missed because it had no free memory.",
            dropped,
        );
    }
    text.gauge("frames_per_second", "Recent frame rate of the output.", status.fps);
    let Frames { captured, sent: _, stabilized, held, passed_through } = status.frames;
    text.count("captured_frames_total", "Frames captured.", captured);
    let outcomes = [("stabilized", stabilized), ("repeated", held), ("uncorrected", passed_through)];
    text.counts("sent_frames_total", "Frames sent, by outcome.", "outcome", &outcomes);
    text.problems(status);
    text.count("cameras_opened_total", "Number of times a camera was opened.", status.cameras_opened);
    text.latency(metrics);
    if let Some(spread) = status.crop_use {
        text.gauge("crop_use_ratio", "Share of the crop margin used by corrections, recent median.", spread.p50);
        text.gauge("crop_use_max_ratio", "Share of the crop margin used by corrections, recent maximum.", spread.max);
    }
    text.gauge("inliers", "Inliers among the tracked points in the newest frame.", status.inliers as f64);
    text.gauge("tracks", "Tracked points in the newest frame.", status.tracks as f64);
    text.gauge("confidence_ratio", "Confidence in the motion of the newest frame, 0 to 1.", status.confidence);
    text.gauge("trust_ratio", "Weight of the correction, 0 to 1; changes slowly.", status.trust);
    if let Some(Found { readout_ms, hfov_deg, lens_k1, .. }) = status.found {
        text.gauge("readout_seconds", "Estimated or configured readout time of the camera.", readout_ms / 1e3);
        text.gauge("field_of_view_degrees", "Estimated or configured horizontal field of view of the camera.", hfov_deg);
        text.gauge("lens_k1", "Estimated or configured radial distortion of the lens, k1 of the division model.", lens_k1);
    }
    text.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::CameraInfo;
    use crate::frame::Frame;
    use crate::rt::clock::monotonic_ns;

    #[test]
    fn every_line_is_help_type_or_a_number_of_a_family_that_was_told() {
        let metrics = Metrics::default();
        let mut frame = Frame::default();
        for age_ms in [5, 20, 20, 5000] {
            frame.stamp.time_ns = monotonic_ns() - age_ms * 1_000_000;
            metrics.sent(&frame);
        }
        metrics.set_camera(CameraInfo { name: "a \"b\"\\\nc".into(), ..CameraInfo::default() });
        let mut status = Status::default();
        metrics.fill(&mut status);
        status.unusable_frames.insert("damaged".into(), 7);
        status.pipewire = Some(PipewireInfo { companions: 2, watched: 1, pages: 3, sent: 30, dropped: 4 });
        let text = text(&status, &metrics);
        let mut family = "";
        for line in text.lines() {
            if let Some(rest) = line.strip_prefix("# TYPE ") {
                family = rest.split(' ').next().unwrap();
            } else if !line.starts_with("# HELP gimbald_") {
                let (name, value) = line.rsplit_once(' ').unwrap();
                assert!(!family.is_empty() && name.starts_with(family), "{line}");
                assert!(value.parse::<f64>().is_ok_and(f64::is_finite), "{line}");
            }
        }
        for line in [
            "gimbald_latency_seconds_bucket{le=\"1\"} 3\n",
            "gimbald_latency_seconds_bucket{le=\"+Inf\"} 4\n",
            "gimbald_latency_seconds_count 4\n",
            "gimbald_pages 3\n",
            "gimbald_pipewire_companions 2\n",
            "gimbald_pipewire_dropped_frames_total 4\n",
            "camera_name=\"a \\\"b\\\"\\\\\\nc\"",
            "gimbald_state{state=\"starting\"} 1\n",
            "gimbald_state{state=\"idle\"} 0\n",
            "gimbald_unusable_frames_total{reason=\"damaged\"} 7\n",
            "gimbald_unusable_frames_total{reason=\"empty\"} 0\n",
            "gimbald_failed_transfers_total 0\n",
        ] {
            assert!(text.contains(line), "{line} in\n{text}");
        }
        let buckets: Vec<f64> = text
            .lines()
            .filter(|line| line.starts_with("gimbald_latency_seconds_bucket"))
            .map(|line| line.rsplit_once(' ').unwrap().1.parse().unwrap())
            .collect();
        assert!(buckets.windows(2).all(|pair| pair[0] <= pair[1]) && buckets.len() == AGE_BOUNDS_MS.len() + 1);
    }
}
