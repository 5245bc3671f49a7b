//! The page of a run: its sections and their texts.

use maud::{Markup, html};

use super::sections::{FRAME_BYTES, cost, fact, motion, page, path, remaining_shake, settings, trust};
use super::{MAX_BYTES, Report, inside};
use crate::pipeline::{Params, Totals};
use crate::report::Stats;
use crate::stage::shutter::{Model, Parameters, Prior};

/// Bytes of the player without its pictures.
const PLAYER_BYTES: usize = 2000;

/// What is known of the readout time, for a sentence.
fn readout(report: &Report) -> String {
    let found = report.journal.samples.iter().rev().find_map(|sample| sample.calibration);
    match (report.settings.pipeline.camera.readout_ms, found) {
        (Prior::Fixed(ms), _) => format!("a readout of {ms} ms"),
        (_, Some(camera)) => format!("an estimated readout of {:.1} ms", 1e3 * camera.readout_s.value),
        (_, None) => "an unknown readout".into(),
    }
}

/// When the model knows a frame's motion, and how long it is kept beyond that.
fn latency(report: &Report) -> String {
    let Params { shutter, smooth, .. } = &report.settings.pipeline;
    let model = match (shutter.model, shutter.parameters) {
        (Model::Cho2007, Parameters::TimeT) => "A frame's motion is known when the next one is there: one frame late",
        (Model::Cho2007, Parameters::TimeT1) | (Model::Continuous, _) => "A frame's motion is known at once: no latency",
    };
    match 1e3 * smooth.lookahead_s() {
        late_ms if late_ms > 0.0 => format!("{model}. Look-ahead adds up to {late_ms:.0} ms"),
        _ => model.into(),
    }
}

/// The whole page.
pub(super) fn html(report: &Report, totals: &Totals, stats: &Stats) -> String {
    let journal = &report.journal;
    let start = journal.samples.first().map_or(0, |sample| sample.time_ns);
    let times: Vec<f64> = journal.samples.iter().map(|sample| sample.time_ns.saturating_sub(start) as f64 / 1e9).collect();
    let time_of = |index| times.get(index as usize).copied().unwrap_or(0.0);
    let above = html! {
        (head(report, totals, stats, &times))
        h2 { "Before and after" }
    };
    let below = html! {
        (report.stills.html(time_of))
        (motion(journal, &times))
        (inside::html(report, &times))
        (path(journal, &times))
        (trust(journal, &times))
        (cost(journal, stats, &times))
        (settings(&report.settings, |_| true))
    };
    let taken = above.0.len() + below.0.len() + FRAME_BYTES + PLAYER_BYTES;
    let player = report.clip.html(MAX_BYTES.saturating_sub(taken), time_of);
    page(&format!("gimbald: {}", report.input), &html! { (above) (player) (below) })
}

/// The run in a few numbers.
fn head(report: &Report, totals: &Totals, stats: &Stats, times: &[f64]) -> Markup {
    let format = &report.format;
    let length_s = times.last().copied().unwrap_or(0.0);
    let used = report.journal.samples.iter().map(|sample| sample.crop_use).filter(|share| share.is_finite());
    let most = used.fold(0.0, f64::max);
    let rest = format!("{} held, {} passed through", totals.held, totals.passed_through);
    let total = stats.total();
    let p99 = format!("median; p99 {:.2} ms", total.p99_ms);
    html! {
        p {
            (totals.frames_out) " frames of " (format.width) "x" (format.height) " (" (format.pixel.to_string()) ") in "
            (format!("{length_s:.2}")) " s of video, stabilized with the model " code { (report.journal.names.name) } " for "
            (readout(report)) ", by gimbald " (env!("CARGO_PKG_VERSION")) ". " (latency(report)) "."
        }
        dl.facts {
            (remaining_shake(&report.journal))
            (fact("crop margin used", &format!("{:.0} %", 100.0 * most), "maximum; 100 % reaches the edge"))
            (fact("frames stabilized", &totals.stabilized.to_string(), &rest))
            (fact("processing time per frame", &format!("{:.2} ms", total.median_ms), &p99))
        }
        p { "The remaining shake is measured by the model itself; motion that it does not model is not included." }
    }
}
