//! Line plots over time as inline SVG, coloured by the page's style sheet.

use maud::{Markup, html};

use super::svg::{Line, TIME_AXIS, label};

const WIDTH: f64 = 860.0;
const HEIGHT: f64 = 190.0;
const LEFT: f64 = TIME_AXIS.0;
const RIGHT: f64 = WIDTH - LEFT - TIME_AXIS.1;
const TOP: f64 = 8.0;
const BOTTOM: f64 = 26.0;
/// A time's label nearer than this to the right edge would be drawn over the unit, and is written with it.
const UNIT: f64 = 26.0;
/// Points along the time axis beyond which a line is drawn by the extremes of each step, so that no peak is lost.
const FINEST: usize = 1200;

/// A line.
#[derive(Clone, Debug)]
pub(super) struct Series {
    /// Its name in the legend.
    pub(super) label: String,
    /// The style sheet's class for it.
    pub(super) class: &'static str,
    /// A value a frame; gaps where not finite.
    pub(super) values: Vec<f64>,
}

/// Lines over a common time axis.
#[derive(Clone, Debug)]
pub(super) struct Plot<'a> {
    /// Heading.
    pub(super) title: String,
    /// What can be read from it, in words.
    pub(super) note: String,
    /// Unit of the values; empty for a ratio.
    pub(super) unit: &'a str,
    /// Seconds, one a frame, rising.
    pub(super) times: &'a [f64],
    /// The lines, drawn in order.
    pub(super) series: Vec<Series>,
    /// A level that should not be crossed, with its name.
    pub(super) limit: Option<(f64, &'static str)>,
    /// Values that the axis shows at least.
    pub(super) least: Option<(f64, f64)>,
}

impl Plot<'_> {
    /// The plot as an HTML figure.
    pub(super) fn figure(&self) -> Markup {
        html! {
            figure {
                figcaption {
                    b { (self.title) } " " (self.note)
                    span.legend {
                        @for series in self.series.iter().filter(|series| !series.label.is_empty()) {
                            span { i class=(series.class) {} (series.label) }
                        }
                    }
                }
                (self.svg())
            }
        }
    }

    fn svg(&self) -> Markup {
        let (low, high) = self.range();
        let (start, end) = (self.times.first().copied().unwrap_or(0.0), self.times.last().copied().unwrap_or(0.0));
        let end = if end > start { end } else { start + 1.0 };
        let x = |time: f64| LEFT + (time - start) / (end - start) * (WIDTH - LEFT - RIGHT);
        let y = |value: f64| TOP + (high - value) / (high - low) * (HEIGHT - TOP - BOTTOM);
        let across = |value: f64| Line::through([[LEFT, y(value)], [WIDTH - RIGHT, y(value)]]);
        // What the script needs to read values off the lines.
        let time_axis = format!("{start:.4} {end:.4} {LEFT} {}", WIDTH - RIGHT);
        let value_axis = format!("{low:.9} {high:.9} {TOP} {}", HEIGHT - BOTTOM);
        let size = format!("0 0 {WIDTH} {HEIGHT}");
        html! {
            svg viewBox=(size) role="img" aria-label=(self.title) data-time=(time_axis) data-value=(value_axis) {
                @for (tick, text) in ticks(low, high, 5) {
                    (across(tick).drawn("grid"))
                    (label([LEFT - 6.0, y(tick) + 4.0], "y", text))
                }
                (time_labels(start, end, x))
                @if !self.unit.is_empty() { (label([4.0, TOP + 10.0], "unit", self.unit)) }
                @if let Some((level, name)) = self.limit {
                    (across(level).drawn("limit"))
                    (label([WIDTH - RIGHT - 4.0, y(level) - 4.0], "unit end", name))
                }
                @for Series { label, class, values } in &self.series {
                    path class={ "line " (class) } data-name=(label) d=(path(self.times, values, x, y).data()) {}
                }
            }
        }
    }

    /// Lowest and highest value that the axis shows; never equal.
    fn range(&self) -> (f64, f64) {
        let values = self.series.iter().flat_map(|series| &series.values).copied().filter(|value| value.is_finite());
        let known = self.least.into_iter().flat_map(|(low, high)| [low, high]).chain(self.limit.map(|(level, _)| level));
        let (mut low, mut high) =
            values.chain(known).fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
        if low > high {
            (low, high) = (0.0, 1.0);
        }
        let pad = ((high - low) * 0.06).max(high.abs().max(low.abs()) * 1e-6).max(1e-9);
        (low - pad, high + pad)
    }
}

/// The labels of the time axis, and its unit.
fn time_labels(start: f64, end: f64, x: impl Fn(f64) -> f64) -> Markup {
    let at = HEIGHT - 8.0;
    let (near, labels): (Vec<_>, Vec<_>) = ticks(start, end, 10).into_iter().partition(|(tick, _)| x(*tick) > WIDTH - UNIT);
    let unit = near.last().map_or("s".to_owned(), |(_, label)| format!("{label} s"));
    html! {
        @for (tick, text) in labels { (label([x(tick), at], "x", text)) }
        (label([WIDTH - 2.0, at], "unit end", unit))
    }
}

/// A line of values. Very long ones go from the lowest to the highest value of each step.
fn path(times: &[f64], values: &[f64], x: impl Fn(f64) -> f64, y: impl Fn(f64) -> f64) -> Line {
    let step = values.len().div_ceil(FINEST).max(1);
    let mut line = Line::default();
    for (times, values) in times.chunks(step).zip(values.chunks(step)) {
        let known = values.iter().copied().filter(|value| value.is_finite());
        let (low, high) = known.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
        if low > high {
            line.gap();
            continue;
        }
        line.to([x(times[0]), y(low)]);
        if high > low {
            line.vertical_to(y(high));
        }
    }
    line
}

/// About `count` round values between `low` and `high`, each with its label.
fn ticks(low: f64, high: f64, count: usize) -> Vec<(f64, String)> {
    let rough = (high - low) / count as f64;
    let power = 10f64.powf(rough.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].into_iter().map(|n| n * power).find(|step| *step >= rough).unwrap_or(rough);
    if !(step.is_finite() && step > 0.0) {
        return Vec::new();
    }
    let digits = (-step.log10().floor()).clamp(0.0, 9.0) as usize;
    let first = (low / step).ceil();
    (0..=2 * count)
        .map(|i| (first + i as f64) * step)
        .take_while(|tick| *tick <= high)
        // "-0" is what rounding makes of a tick just below 0
        .map(|tick| (tick, format!("{:.digits$}", if tick.abs() < step / 2.0 { 0.0 } else { tick })))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plot<'a>(times: &'a [f64], values: Vec<f64>) -> Plot<'a> {
        let series = vec![Series { label: "a<b".into(), class: "before", values }];
        Plot { title: "T".into(), note: String::new(), unit: "px", times, series, limit: None, least: None }
    }

    #[test]
    fn ticks_are_round_and_inside() {
        let labels = |low, high, count| ticks(low, high, count).into_iter().map(|(_, label)| label).collect::<Vec<_>>();
        assert_eq!(labels(-0.3, 1.05, 5), ["0.0", "0.5", "1.0"]);
        assert_eq!(labels(0.0, 10.0, 5), ["0", "2", "4", "6", "8", "10"]);
        assert_eq!(labels(0.9996, 1.0004, 4), ["0.9996", "0.9998", "1.0000", "1.0002", "1.0004"]);
        assert!(labels(f64::NAN, 1.0, 5).is_empty());
    }

    #[test]
    fn the_last_time_and_the_unit_do_not_overlap() {
        let (before, until) = (plot(&[-2.0, 0.0], vec![1.0, 2.0]).figure().0, plot(&[0.0, 1.97], vec![1.0, 2.0]).figure().0);
        assert!(before.contains(">0.0 s</text>") && !before.contains(">0.0</text>"), "{before}");
        assert!(until.contains(">s</text>") && until.contains(">1.8</text>"), "{until}");
    }

    #[test]
    fn gaps_lift_the_pen_and_peaks_of_long_lines_stay() {
        let times: Vec<f64> = (0..5).map(f64::from).collect();
        let line = path(&times, &[0.0, 1.0, f64::NAN, 3.0, 4.0], |x| x, |y| y);
        assert_eq!(line.data(), "M0.0 0.0L1.0 1.0M3.0 3.0L4.0 4.0");
        let times: Vec<f64> = (0..50_000).map(f64::from).collect();
        let mut values = vec![0.0; 50_000];
        values[33_333] = 99.0;
        let line = path(&times, &values, |x| x, |y| y);
        let data = line.data();
        assert!(data.contains("V99.0") && data.len() < 60_000, "{}", data.len());
    }

    #[test]
    fn nothing_finite_and_nothing_at_all_are_drawn_as_empty_axes() {
        for (times, values) in [(vec![], vec![]), (vec![0.0], vec![f64::NAN]), (vec![0.0, 0.0], vec![7.0, 7.0])] {
            let figure = plot(&times, values).figure().0;
            assert!(figure.contains("a&lt;b") && !figure.contains("NaN") && !figure.contains("inf"), "{figure}");
        }
    }
}
