//! The page of a run: what is shown, in which order, with which words.

use std::fmt::Write as _;

use super::sections::{begin, cost, end, fact, motion, path, remaining_shake, settings, trust};
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
    let start = report.journal.samples.first().map_or(0, |sample| sample.time_ns);
    let times: Vec<f64> =
        report.journal.samples.iter().map(|sample| sample.time_ns.saturating_sub(start) as f64 / 1e9).collect();
    let title = format!("gimbald: {}", report.input);
    let mut html = begin(&title);
    head(&mut html, report, totals, stats, &times);
    html.push_str("<h2>Before and after</h2>\n");
    let player_at = html.len();
    let time_of = |index| times.get(index as usize).copied().unwrap_or(0.0);
    html.push_str(&report.stills.html(time_of));
    motion(&mut html, &report.journal, &times);
    inside::html(&mut html, report, &times);
    path(&mut html, &report.journal, &times);
    trust(&mut html, &report.journal, &times);
    cost(&mut html, &report.journal, stats, &times);
    settings(&mut html, &report.settings, |_| true);
    end(&mut html);
    html.insert_str(player_at, &report.clip.html(MAX_BYTES.saturating_sub(html.len() + PLAYER_BYTES), time_of));
    html
}

/// The run in a few numbers.
fn head(html: &mut String, report: &Report, totals: &Totals, stats: &Stats, times: &[f64]) {
    let format = &report.format;
    let _ = writeln!(
        html,
        "<p>{} frames of {}x{} ({}) in {:.2} s of video, stabilized with the model <code>{}</code> for {}, by gimbald {}. {}.</p>\n<dl class=facts>",
        totals.frames_out,
        format.width,
        format.height,
        format.pixel,
        times.last().copied().unwrap_or(0.0),
        report.journal.names.name,
        readout(report),
        env!("CARGO_PKG_VERSION"),
        latency(report),
    );
    remaining_shake(html, &report.journal);
    let mut fact = |name: &str, value: String, note: String| fact(html, name, &value, &note);
    let most =
        report.journal.samples.iter().map(|sample| sample.crop_use).filter(|share| share.is_finite()).fold(0.0, f64::max);
    fact("crop margin used", format!("{:.0} %", 100.0 * most), "maximum; 100 % reaches the edge".into());
    let rest = format!("{} held, {} passed through", totals.held, totals.passed_through);
    fact("frames stabilized", totals.stabilized.to_string(), rest);
    let total = stats.total();
    fact("processing time per frame", format!("{:.2} ms", total.median_ms), format!("median; p99 {:.2} ms", total.p99_ms));
    html.push_str(
        "</dl>\n<p>The remaining shake is measured by the model itself; motion that it does not model is not included.</p>\n",
    );
}
