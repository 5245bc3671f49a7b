//! The sections that pages have in common: motion, path, trust, times, settings.

use std::fmt::Write as _;

use super::plot::{Plot, Series, escaped};
use super::{Journal, Sample};
use crate::config::{Key, Settings, keys};
use crate::frame::{Outcome, Stage};
use crate::geometry::{PITCH, ROLL, YAW};
use crate::report::{Stats, outcome_name};
use crate::stage::shutter::Model;

/// Which four parameters of a frame a line shows.
type Of = fn(&Sample) -> [f64; 4];

const STYLE: &str = include_str!("style.css");
const SCRIPT: &str = include_str!("player.js");
/// The page loads nothing.
const POLICY: &str = include_str!("policy.txt");

/// The beginning of a page, with its heading.
pub(super) fn begin(title: &str) -> String {
    let title = escaped(title);
    format!(
        "<!doctype html>\n<html lang=en><meta charset=utf-8><meta name=viewport content=\"width=device-width, initial-scale=1\">\
         <meta http-equiv=Content-Security-Policy content=\"{POLICY}\"><title>{title}</title>\n<style>\n{STYLE}</style>\n<h1>{title}</h1>\n"
    )
}

/// The end of a page: the script that plots and player need.
pub(super) fn end(html: &mut String) {
    let _ = write!(html, "<script>\n{SCRIPT}</script>\n</html>\n");
}

/// A number in a box, within `<dl class=facts>`.
pub(super) fn fact(html: &mut String, name: &str, value: &str, note: &str) {
    let _ = writeln!(html, "<div><dt>{name}</dt><dd>{value}</dd><small>{note}</small></div>");
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
pub(super) fn remaining_shake(html: &mut String, journal: &Journal) {
    for change in changes(journal) {
        let note = format!("{} to {} {}", number(change.before), number(change.after), change.unit);
        fact(html, &format!("remaining shake, {}", change.name), &format!("{:.0} %", 100.0 * change.left()), &note);
    }
}

/// The change of a parameter from frame to frame, of the camera and of the output.
fn jerkinesses(journal: &Journal, axis: usize) -> [f64; 2] {
    [|s: &Sample| s.motion, |s: &Sample| s.steadied].map(|of| jerkiness(journal, axis, of))
}

/// The plots of the paper's Fig. 12.
pub(super) fn motion(html: &mut String, journal: &Journal, times: &[f64]) {
    let between = match journal.names.model {
        Model::Cho2007 => "As in Fig. 12 of the paper",
        Model::Continuous => "From one frame's middle row to the next one's, as the paper's Fig. 12 has it for its model",
    };
    let _ = write!(
        html,
        "<h2>Motion from frame to frame</h2>\n<p>{between}: the camera's own motion, and what is left of it in \
         the output. The number is the root mean square of its change from one frame to the next, which is what the eye sees as \
         shake.</p>\n",
    );
    motion_plots(html, journal, times);
}

/// The same without heading and explanation.
pub(super) fn motion_plots(html: &mut String, journal: &Journal, times: &[f64]) {
    for (axis, names) in journal.names.axes.iter().enumerate() {
        let series = [("camera, T", "before", (|s: &Sample| s.motion) as Of), ("output, Tˢ", "after", |s: &Sample| s.steadied)];
        let [before, after] = jerkinesses(journal, axis);
        let plot = Plot {
            title: format!("{}: {}", names.name, names.meaning),
            note: format!("{} → {} {}", number(before), number(after), names.unit),
            unit: names.unit,
            times,
            series: lines(journal, axis, &series.map(|(label, class, of)| (label.into(), class, of))),
            limit: None,
            least: None,
        };
        html.push_str(&plot.figure());
    }
}

/// The camera's way and the virtual camera's.
pub(super) fn path(html: &mut String, journal: &Journal, times: &[f64]) {
    let names = journal.names;
    let _ = writeln!(
        html,
        "<h2>Path</h2>\n<p>The sum of the motions: the path of the camera ({}), and of the virtual camera ({}).</p>",
        names.path, names.smoothed
    );
    for (axis, axis_names) in names.axes.iter().enumerate() {
        let series = [
            (format!("camera, {}", names.path), "before", (|s: &Sample| s.path) as Of),
            (format!("virtual camera, {}", names.smoothed), "after", |s: &Sample| s.smoothed),
        ];
        let plot = Plot {
            title: format!("{}: {}", axis_names.name, axis_names.meaning),
            note: String::new(),
            unit: axis_names.unit,
            times,
            series: lines(journal, axis, &series),
            limit: None,
            least: None,
        };
        html.push_str(&plot.figure());
    }
}

/// How much of the crop window was used, and how far the motion was believed.
pub(super) fn trust(html: &mut String, journal: &Journal, times: &[f64]) {
    html.push_str("<h2>Crop margin and trust</h2>\n");
    let one = |label: &str, class: &'static str, of: fn(&Sample) -> f64| Series {
        label: label.into(),
        class,
        values: journal.samples.iter().map(of).collect(),
    };
    let plot = |title: &str, note: &str, series, limit, least| Plot {
        title: title.into(),
        note: note.into(),
        unit: "",
        times,
        series,
        limit,
        least: Some(least),
    };
    let crop = vec![one("used", "after", |s| s.crop_use)];
    let note = "share of the margin that the correction uses";
    html.push_str(&plot("Crop window", note, crop, Some((1.0, "edge of the picture")), (0.0, 1.0)).figure());
    let shares = vec![
        one("yaw", "before", |s| s.crop_shares[YAW]),
        one("pitch", "third", |s| s.crop_shares[PITCH]),
        one("roll", "after", |s| s.crop_shares[ROLL]),
    ];
    let note = "what each rotation takes of the margin where least of it is left; below 0 it makes room";
    html.push_str(&plot("Crop margin by rotation", note, shares, None, (0.0, 1.0)).figure());
    let points = vec![one("tracked", "third", |s| f64::from(s.tracks)), one("inliers", "after", |s| f64::from(s.inliers))];
    html.push_str(
        &plot("Points", "tracked from the previous frame, and inliers of the motion", points, None, (0.0, 1.0)).figure(),
    );
    let belief = vec![one("confidence", "third", |s| s.confidence), one("trust", "after", |s| s.trust)];
    let note = "confidence in each frame's motion, and the weight of the correction";
    html.push_str(&plot("Confidence", note, belief, None, (0.0, 1.0)).figure());
    strip(html, journal, times);
}

/// What became of each frame, as a strip.
fn strip(html: &mut String, journal: &Journal, times: &[f64]) {
    const LEFT: f64 = 62.0;
    const LENGTH: f64 = 786.0;
    let mut kinds: Vec<(Outcome, u64)> = Vec::new();
    let mut rects = String::new();
    let (from, to) = (times.first().copied().unwrap_or(0.0), times.last().copied().unwrap_or(0.0));
    let to = if to > from { to } else { from + 1.0 };
    let place = |index: usize| LEFT + (times.get(index).copied().unwrap_or(to) - from) / (to - from) * LENGTH;
    let mut start = 0;
    for (index, sample) in journal.samples.iter().enumerate() {
        match kinds.iter_mut().find(|(outcome, _)| *outcome == sample.outcome) {
            Some((_, frames)) => *frames += 1,
            None => kinds.push((sample.outcome, 1)),
        }
        if journal.samples.get(index + 1).is_none_or(|next| next.outcome != sample.outcome) {
            let class = match sample.outcome {
                Outcome::Stabilized => "stabilized",
                Outcome::Held(_) => "held",
                Outcome::PassedThrough(_) | Outcome::Pending => "passed",
            };
            let (x, width) = (place(start), (place(index + 1) - place(start)).max(1.0));
            let _ = write!(
                rects,
                "<rect class={class} x={x:.1} y=4 width={width:.1} height=18><title>{} from {:.2} s</title></rect>",
                outcome_name(sample.outcome),
                times[start]
            );
            start = index + 1;
        }
    }
    let words: Vec<String> = kinds.iter().map(|(outcome, frames)| format!("{} {frames}", outcome_name(*outcome))).collect();
    let _ = writeln!(
        html,
        "<figure><figcaption><b>Outcome of each frame</b> {}</figcaption><svg class=strip viewBox=\"0 0 860 26\" data-time=\"{from:.4} {to:.4} {LEFT} {}\">{rects}</svg></figure>",
        words.join(", "),
        LEFT + LENGTH,
    );
}

/// What it cost.
pub(super) fn cost(html: &mut String, journal: &Journal, stats: &Stats, times: &[f64]) {
    html.push_str("<h2>Processing time</h2>\n");
    let plot = Plot {
        title: "Time per frame".into(),
        note: "sum of all stages".into(),
        unit: "ms",
        times,
        series: vec![Series {
            label: "time".into(),
            class: "after",
            values: journal.samples.iter().map(|sample| sample.spent_ms).collect(),
        }],
        limit: None,
        least: Some((0.0, 1.0)),
    };
    html.push_str(&plot.figure());
    html.push_str(
        "<div class=wide><table><tr><th>stage<th class=n>frames<th class=n>median ms<th class=n>p99 ms<th class=n>max ms<th>median</tr>\n",
    );
    let stages = Stage::ALL.map(|stage| (stage.name(), stats.stage(stage)));
    let widest = stages.iter().map(|(_, times)| times.median_ms).fold(1e-9, f64::max);
    for (name, times) in stages.into_iter().chain([("total", stats.total())]) {
        let share = if name == "total" { 0.0 } else { 100.0 * times.median_ms / widest };
        let _ = writeln!(
            html,
            "<tr><td>{name}<td class=n>{}<td class=n>{:.3}<td class=n>{:.3}<td class=n>{:.3}<td style=\"width:40%\">\
             <div class=bar style=\"width:{share:.1}%\"></div></tr>",
            times.count, times.median_ms, times.p99_ms, times.max_ms
        );
    }
    html.push_str("</table></div>\n");
}

/// Every setting, those that are not the default in bold. Of a key that is not to be shown, only whether it has its default.
pub(super) fn settings(html: &mut String, settings: &Settings, is_shown: impl Fn(&Key) -> bool) {
    let defaults = Settings::default();
    html.push_str("<h2>Settings</h2>\n<p>Values that differ from the default are bold.</p>\n<div class=wide><table>\n");
    html.push_str("<tr><th>key<th>value<th>default<th>unit</tr>\n");
    for key in keys::KEYS {
        let (value, default) = (key.shown(settings), key.shown(&defaults));
        let hidden = value != default && !is_shown(key);
        let class = if value == default { "" } else { " class=changed" };
        let value = if hidden { "(left out)".to_owned() } else { escaped(&value) };
        let default = escaped(&default);
        let _ = writeln!(html, "<tr{class}><td><code>{}</code><td>{value}<td>{default}<td>{}</tr>", key.name, key.unit);
    }
    html.push_str("</table></div>\n");
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
pub(super) fn jerkiness(journal: &Journal, axis: usize, of: impl Fn(&Sample) -> [f64; 4]) -> f64 {
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
