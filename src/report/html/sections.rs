//! The sections that pages have in common: motion, path, trust, times, settings.

use maud::{DOCTYPE, Markup, PreEscaped, html};

use super::plot::{Plot, Series};
use super::svg::{TIME_AXIS, rounded};
use super::{Journal, Sample};
use crate::config::{Key, Settings, keys};
use crate::frame::{Outcome, PathParameters, Stage};
use crate::geometry::{PITCH, ROLL, YAW};
use crate::report::Stats;
use crate::report::names::{Axis, outcome_name};
use crate::stage::shutter::Model;

/// Which four parameters of a frame a line shows.
type Of = fn(&Sample) -> PathParameters;

const STYLE: &str = include_str!("style.css");
const SCRIPT: &str = include_str!("player.js");
/// The page loads nothing.
const POLICY: &str = include_str!("policy.txt");

/// Bytes of a page without its body, about.
pub(super) const FRAME_BYTES: usize = STYLE.len() + SCRIPT.len() + POLICY.len() + 500;

/// A whole page, with its heading and the script that plots and player need.
pub(super) fn page(title: &str, body: &Markup) -> String {
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                meta http-equiv="Content-Security-Policy" content=(POLICY);
                title { (title) }
                style { (PreEscaped(STYLE)) }
            }
            body {
                h1 { (title) }
                (body)
                script { (PreEscaped(SCRIPT)) }
            }
        }
    };
    page.into_string()
}

/// A number in a box, within `dl.facts`.
pub(super) fn fact(name: &str, value: &str, note: &str) -> Markup {
    html! { div { dt { (name) } dd { (value) } small { (note) } } }
}

/// How much a parameter changes from frame to frame (root mean square), in the camera's motion and in the output's.
pub(super) struct Change {
    /// A word for the parameter.
    pub(super) name: &'static str,
    unit: &'static str,
    before: f64,
    after: f64,
}

impl Change {
    /// The share that is left in the output.
    pub(super) fn left(&self) -> f64 {
        self.after / self.before
    }
}

/// The changes of the parameters that change.
pub(super) fn changes(journal: &Journal) -> impl Iterator<Item = Change> {
    journal.names.axes.iter().enumerate().filter_map(|(axis, names)| {
        let [before, after] = jerkinesses(journal, axis);
        // A letter says nothing by itself; a word says more than a phrase.
        let name = if names.name.len() > 1 { names.name } else { names.meaning };
        (before > 0.0 && after.is_finite()).then_some(Change { name, unit: names.unit, before, after })
    })
}

/// The same as numbers in boxes.
pub(super) fn remaining_shake(journal: &Journal) -> Markup {
    let shown = |change: Change| {
        let note = format!("{} to {} {}", number(change.before), number(change.after), change.unit);
        fact(&format!("remaining shake, {}", change.name), &format!("{:.0} %", 100.0 * change.left()), &note)
    };
    html! { @for change in changes(journal) { (shown(change)) } }
}

/// The change of a parameter from frame to frame, of the camera and of the output.
fn jerkinesses(journal: &Journal, axis: usize) -> [f64; 2] {
    [|s: &Sample| s.motion, |s: &Sample| s.steadied].map(|of| jerkiness(journal, axis, of))
}

/// The plots of the paper's Fig. 12.
pub(super) fn motion(journal: &Journal, times: &[f64]) -> Markup {
    let between = match journal.names.model {
        Model::Cho2007 => "As in Fig. 12 of the paper",
        Model::Continuous => "From one frame's middle row to the next one's, as the paper's Fig. 12 has it for its model",
    };
    html! {
        h2 { "Motion from frame to frame" }
        p {
            (between) ": the camera's own motion, and what is left of it in the output. The number is the root mean square of its change \
             from one frame to the next, which is what the eye sees as shake."
        }
        (motion_plots(journal, times))
    }
}

/// The same without heading and explanation.
pub(super) fn motion_plots(journal: &Journal, times: &[f64]) -> Markup {
    let plot = |(axis, names): (usize, &Axis)| {
        let series = [("camera, T", "before", (|s: &Sample| s.motion) as Of), ("output, Tˢ", "after", |s: &Sample| s.steadied)];
        let [before, after] = jerkinesses(journal, axis);
        let note = format!("{} → {} {}", number(before), number(after), names.unit);
        let series = series.map(|(label, class, of)| (label.into(), class, of));
        axis_plot(journal, (axis, names), note, times, &series).figure()
    };
    html! { @for axis in journal.names.axes.iter().enumerate() { (plot(axis)) } }
}

/// The camera's way and the virtual camera's.
pub(super) fn path(journal: &Journal, times: &[f64]) -> Markup {
    let names = journal.names;
    let series = [
        (format!("camera, {}", names.path), "before", (|s: &Sample| s.path) as Of),
        (format!("virtual camera, {}", names.smoothed), "after", |s: &Sample| s.smoothed),
    ];
    html! {
        h2 { "Path" }
        p { "The sum of the motions: the path of the camera (" (names.path) "), and of the virtual camera (" (names.smoothed) ")." }
        @for axis in names.axes.iter().enumerate() { (axis_plot(journal, axis, String::new(), times, &series).figure()) }
    }
}

/// A plot of one of the model's parameters.
fn axis_plot<'a>(
    journal: &Journal,
    (axis, names): (usize, &Axis),
    note: String,
    times: &'a [f64],
    series: &[(String, &'static str, Of)],
) -> Plot<'a> {
    let title = format!("{}: {}", names.name, names.meaning);
    Plot { title, note, unit: names.unit, times, series: lines(journal, axis, series), limit: None, least: None }
}

/// How much of the crop window was used, and how far the motion was believed.
pub(super) fn trust(journal: &Journal, times: &[f64]) -> Markup {
    let one = |label: &str, class: &'static str, of: fn(&Sample) -> f64| Series {
        label: label.into(),
        class,
        values: journal.samples.iter().map(of).collect(),
    };
    let figure = |title: &str, note: &str, series, limit| {
        let (title, note) = (title.into(), note.into());
        Plot { title, note, unit: "", times, series, limit, least: Some((0.0, 1.0)) }.figure()
    };
    let crop = vec![one("used", "after", |s| s.crop_use)];
    let shares = vec![
        one("yaw", "before", |s| s.crop_shares[YAW]),
        one("pitch", "third", |s| s.crop_shares[PITCH]),
        one("roll", "after", |s| s.crop_shares[ROLL]),
    ];
    let by_rotation = "what each rotation takes of the margin where least of it is left; below 0 it makes room";
    let points = vec![one("tracked", "third", |s| f64::from(s.tracks)), one("inliers", "after", |s| f64::from(s.inliers))];
    let belief = vec![one("confidence", "third", |s| s.confidence), one("trust", "after", |s| s.trust)];
    html! {
        h2 { "Crop margin and trust" }
        (figure("Crop window", "share of the margin that the correction uses", crop, Some((1.0, "edge of the picture"))))
        (figure("Crop margin by rotation", by_rotation, shares, None))
        (figure("Points", "tracked from the previous frame, and inliers of the motion", points, None))
        (figure("Confidence", "confidence in each frame's motion, and the weight of the correction", belief, None))
        (strip(journal, times))
    }
}

/// Frames in a row with the same outcome: the first and the one behind the last.
type Run = (Outcome, std::ops::Range<usize>);

/// What became of each frame, as a strip.
fn strip(journal: &Journal, times: &[f64]) -> Markup {
    let (left, length) = TIME_AXIS;
    let (from, to) = (times.first().copied().unwrap_or(0.0), times.last().copied().unwrap_or(0.0));
    let to = if to > from { to } else { from + 1.0 };
    let place = |index: usize| left + (times.get(index).copied().unwrap_or(to) - from) / (to - from) * length;
    let mut start = 0;
    let runs = journal.samples.chunk_by(|a, b| a.outcome == b.outcome).map(|run| {
        start += run.len();
        (run[0].outcome, start - run.len()..start)
    });
    let runs: Vec<Run> = runs.collect();
    let mut counts: Vec<(Outcome, usize)> = Vec::new();
    for (outcome, run) in &runs {
        match counts.iter_mut().find(|(counted, _)| counted == outcome) {
            Some((_, frames)) => *frames += run.len(),
            None => counts.push((*outcome, run.len())),
        }
    }
    let words: Vec<String> = counts.iter().map(|(outcome, frames)| format!("{} {frames}", outcome_name(*outcome))).collect();
    let class = |outcome: &Outcome| match outcome {
        Outcome::Stabilized => "stabilized",
        Outcome::Held(_) => "held",
        Outcome::PassedThrough(_) | Outcome::Pending => "passed",
    };
    html! {
        figure {
            figcaption { b { "Outcome of each frame" } " " (words.join(", ")) }
            svg.strip viewBox="0 0 860 26" data-time=(format!("{from:.4} {to:.4} {left} {}", left + length)) {
                @for (outcome, run) in &runs {
                    @let (x, width) = (place(run.start), (place(run.end) - place(run.start)).max(1.0));
                    rect class=(class(outcome)) x=(rounded(x)) y="4" width=(rounded(width)) height="18" {
                        title { (outcome_name(*outcome)) " from " (format!("{:.2}", times[run.start])) " s" }
                    }
                }
            }
        }
    }
}

/// What it cost.
pub(super) fn cost(journal: &Journal, stats: &Stats, times: &[f64]) -> Markup {
    let values = journal.samples.iter().map(|sample| sample.spent_ms).collect();
    let plot = Plot {
        title: "Time per frame".into(),
        note: "sum of all stages".into(),
        unit: "ms",
        times,
        series: vec![Series { label: "time".into(), class: "after", values }],
        limit: None,
        least: Some((0.0, 1.0)),
    };
    let stages = Stage::ALL.map(|stage| (stage.name(), stats.stage(stage)));
    let widest = stages.iter().map(|(_, times)| times.median_ms).fold(1e-9, f64::max);
    html! {
        h2 { "Processing time" }
        (plot.figure())
        div.wide {
            table {
                tr { th { "stage" } th.n { "frames" } th.n { "median ms" } th.n { "p99 ms" } th.n { "max ms" } th { "median" } }
                @for (name, times) in stages.into_iter().chain([("total", stats.total())]) {
                    @let share = if name == "total" { 0.0 } else { 100.0 * times.median_ms / widest };
                    tr {
                        td { (name) }
                        td.n { (times.count) }
                        @for ms in [times.median_ms, times.p99_ms, times.max_ms] { td.n { (format!("{ms:.3}")) } }
                        td style="width:40%" { div.bar style=(format!("width:{share:.1}%")) {} }
                    }
                }
            }
        }
    }
}

/// Every setting, those that are not the default in bold. Of a key that is not to be shown, only whether it has its default.
pub(super) fn settings(settings: &Settings, is_shown: impl Fn(&Key) -> bool) -> Markup {
    let defaults = Settings::default();
    html! {
        h2 { "Settings" }
        p { "Values that differ from the default are bold." }
        div.wide {
            table {
                tr { th { "key" } th { "value" } th { "default" } th { "unit" } }
                @for key in keys::KEYS {
                    @let (value, default) = (key.value_text(settings), key.value_text(&defaults));
                    @let is_changed = value != default;
                    tr.changed[is_changed] {
                        td { code { (key.name) } }
                        td { @if is_changed && !is_shown(key) { "(left out)" } @else { (value) } }
                        td { (default) }
                        td { (key.unit) }
                    }
                }
            }
        }
    }
}

/// A line for each of `series`: its label, its class, and which of a frame's parameters it shows.
fn lines(journal: &Journal, axis: usize, series: &[(String, &'static str, Of)]) -> Vec<Series> {
    let line = |(label, class, of): &(String, &'static str, Of)| Series {
        label: label.clone(),
        class,
        values: journal.samples.iter().map(|sample| of(sample)[axis]).collect(),
    };
    series.iter().map(line).collect()
}

/// Root mean square of the change of a motion from one frame to the next; not finite where there are no two frames.
pub(super) fn jerkiness(journal: &Journal, axis: usize, of: impl Fn(&Sample) -> PathParameters) -> f64 {
    let changes =
        journal.samples.windows(2).map(|pair| of(&pair[1])[axis] - of(&pair[0])[axis]).filter(|change| change.is_finite());
    let (sum, count) = changes.fold((0.0, 0u64), |(sum, count), change| (sum + change * change, count + 1));
    (sum / count as f64).sqrt()
}

/// A number with three digits that matter.
pub(super) fn number(value: f64) -> String {
    if !value.is_finite() {
        return "-".into();
    }
    let digits = (2.0 - value.abs().max(1e-12).log10().floor()).clamp(0.0, 6.0) as usize;
    format!("{value:.digits$}")
}
