//! The page of `gimbald demo --paper`: the paper's Figs. 7 and 9 to 12 with gimbald's own pictures and figures, beside what the paper says.

use maud::{Markup, html};

use super::Report;
use super::picture::Rgb;
use super::plot::{Plot, Series};
use super::sections::{changes, motion_plots, page};
use super::svg::{Line, label};
use crate::report::{PatternFrame, PatternWatch, Shape};
use crate::stage::paper::{Zoom, undistortion};

/// Frames at the beginning that are not judged: the first second of the paper's camera.
const SKIPPED: usize = 15;
const MODELS: [&str; 2] = ["cho2007", "continuous"];

/// Runs of one clip, with the model `cho2007` and with `continuous`.
pub type Both<T> = [T; 2];

/// What the page is made of.
#[derive(Debug)]
pub struct Paper {
    /// What camera the clips are of, in words.
    pub camera: String,
    /// Rolling shutter removed and nothing else, for a camera that moves left and right, and up and down.
    pub undistorted: [Both<PatternWatch>; 2],
    /// The same motions, seen by a camera without rolling shutter.
    pub global: [PatternWatch; 2],
    /// Left and right: stabilized as if there were no rolling shutter.
    pub stabilized_only: Both<PatternWatch>,
    /// Left and right: stabilized, and rolling shutter removed.
    pub complete: Both<PatternWatch>,
    /// A walk, stabilized with the low-pass filter.
    pub walk: Both<Report>,
    /// Frames in which the camera moves fastest: right, left, down, up.
    pub fastest: [u64; 4],
    /// Frames of Fig. 11.
    pub sequence: Vec<u64>,
}

/// Which of a shape's measures is meant.
type Of = fn(&Shape) -> f64;

fn height(shape: &Shape) -> f64 {
    shape.height_px
}

fn angle(shape: &Shape) -> f64 {
    shape.angle_deg
}

impl Paper {
    /// The page.
    pub fn html(&self) -> String {
        let body = html! {
            p {
                "W. Cho, D. Kim, K. Hong, \"CMOS Digital Image Stabilization\", IEEE Transactions on Consumer Electronics 53 (2007): its \
                 experiments, repeated with gimbald " (env!("CARGO_PKG_VERSION")) ". " (self.camera)
            }
            p {
                "Slant and height are measured in the pixels, each the mean of all rectangles that are whole in a frame, as in the paper. The \
                 first second is left out."
            }
            (self.table())
            (fig7())
            (self.fig9())
            (self.fig10())
            (self.fig11())
            h2 { "Fig. 12: motion of a walk, before and after the low-pass filter" }
            p {
                "The camera's motion from frame to frame, and what is left of it in the output. The number is the root mean square of its \
                 change from one frame to the next."
            }
            @for (report, model) in self.walk.iter().zip(MODELS) {
                h3 { "Model " (model) }
                (motion_plots(&report.journal, &times_of(report)))
            }
        };
        page("gimbald: the paper, reproduced", &body)
    }

    fn table(&self) -> Markup {
        html! {
            h2 { "What the paper says, and what was measured" }
            div.wide {
                table.claims {
                    tr {
                        th { "figure" } th { "the paper" } th { "measured" }
                        @for head in ["camera", "cho2007", "continuous", "no rolling shutter"] { th.n { (head) } }
                    }
                    @for Row { figure, claim, what, values } in self.rows() {
                        tr {
                            td { (figure) } td { (claim) } td { (what) }
                            @for value in values { td.n { (value) } }
                        }
                    }
                }
            }
            p {
                "Slant: root mean square difference from 90°, and the largest. Height: standard deviation in percent of the mean, and the range \
                 in pixels. The last column is the same motion filmed by a camera that exposes all rows at once: the perspective of a camera \
                 that turns, and the error of the measurement."
            }
        }
    }

    /// The table's rows.
    fn rows(&self) -> Vec<Row> {
        let none = Markup::default;
        let h = |motion: usize, entry: usize| {
            let (low, high) = extremes(measured(&self.undistorted[motion][0].frames).map(|frame| frame.homography[entry]));
            [html! { (format!("{low:.3} to {high:.3}")) }, none(), none(), none()]
        };
        let shapes = |motion: usize, of: Of| {
            let (runs, global) = (&self.undistorted[motion], &self.global[motion]);
            let columns = [(&runs[0], 0), (&runs[0], 1), (&runs[1], 1), (global, 0)];
            columns.map(|(watch, side)| deviation(&watch.frames, side, of))
        };
        let slants = |runs: &Both<PatternWatch>| {
            let [before, cho, continuous] =
                [(&runs[0], 0), (&runs[0], 1), (&runs[1], 1)].map(|(watch, side)| deviation(&watch.frames, side, angle));
            [before, cho, continuous, none()]
        };
        let left = |report: &Report| {
            html! {
                @for (i, change) in changes(&report.journal).enumerate() {
                    @if i > 0 { br; }
                    (change.name) " " (format!("{:.0}", 100.0 * change.left())) " %"
                }
            }
        };
        let row = |figure, claim, what, values| Row { figure, claim, what, values };
        let plotted = "(plotted, not commented on)";
        let upright = "“constant around the upright angle of 90°”";
        let regular = "“its large fluctuation has been removed so that their average height appears regularly”";
        let only = "without a rolling-shutter model “there are no differences except that its motion is smoothed”";
        let whole = "“the same patterns appear more uprightly than those in its original CMOS frames”";
        let smoothed = "motion “smoothed” by a second-order low-pass filter";
        vec![
            row("III B", "“the value of h2 runs from 0 to 0.08 experimentally”", "h2, left and right", h(0, 0)),
            row("III B", "“h5 ≈ 0.92 ~ 1.07”", "h5, up and down", h(1, 1)),
            row("9, 10 (c)", upright, "slant, left and right", shapes(0, angle)),
            row("10 (b)", plotted, "height, left and right", shapes(0, height)),
            row("9, 10 (d)", regular, "height, up and down", shapes(1, height)),
            row("10 (e)", plotted, "slant, up and down", shapes(1, angle)),
            row("11, middle", only, "slant, stabilized only", slants(&self.stabilized_only)),
            row("11, bottom", whole, "slant, stabilized", slants(&self.complete)),
            row(
                "12",
                smoothed,
                "what is left of the change of motion",
                [none(), left(&self.walk[0]), left(&self.walk[1]), none()],
            ),
        ]
    }

    /// The four motions, one column each.
    fn fig9(&self) -> Markup {
        let columns = ["right", "left", "down", "up"].into_iter().zip(self.fastest).enumerate();
        let columns: Vec<_> = columns.map(|(n, (name, frame))| (name, frame, &self.undistorted[n / 2])).collect();
        let shown = |row: &str, side: usize, (name, frame, runs): &(&str, u64, &Both<PatternWatch>)| {
            let watch = &runs[usize::from(row == "continuous")];
            let shape = watch.frames.get(*frame as usize).and_then(|frame| frame.shapes[side]);
            cell(watch, *frame, side, &format!("{name}, {row}"), shape)
        };
        html! {
            h2 { "Fig. 9: four motions, before and after" }
            p {
                "The frames in which the camera moves fastest to the right, left, down and up. Rolling shutter is removed, and nothing is \
                 stabilized."
            }
            figure {
                div.grid4 {
                    @for (row, side) in [("camera", 0), ("cho2007", 1), ("continuous", 1)] {
                        @for column in &columns { (shown(row, side, column)) }
                    }
                }
            }
        }
    }

    /// Height and slant over time for both motions.
    fn fig10(&self) -> Markup {
        let parts = [
            ("b", "height, camera moves left and right", 0, "px", height as Of),
            ("c", "slant, camera moves left and right", 0, "deg", angle),
            ("d", "height, camera moves up and down", 1, "px", height),
            ("e", "slant, camera moves up and down", 1, "deg", angle),
        ];
        let figure = |(part, title, motion, unit, of): (&str, &str, usize, &str, Of)| {
            let [cho, continuous] = &self.undistorted[motion];
            let line = |label: &str, class, watch: &PatternWatch, side: usize| Series {
                label: label.into(),
                class,
                values: measured(&watch.frames).map(|frame| frame.shapes[side].as_ref().map_or(f64::NAN, of)).collect(),
            };
            let times: Vec<f64> = measured(&cho.frames).map(|frame| frame.time_s).collect();
            let series = vec![
                line("camera", "before dashed", cho, 0),
                line("continuous", "third", continuous, 1),
                line("cho2007", "after", cho, 1),
            ];
            // The same range for both motions, so that one sees which of the two distorts what.
            let least = Some(self.range(of));
            Plot { title: format!("({part}) {title}"), note: String::new(), unit, times: &times, series, limit: None, least }
                .figure()
        };
        html! {
            h2 { "Fig. 10 (b) to (e): height and slant over time" }
            @for part in parts { (figure(part)) }
        }
    }

    /// The values that the cameras' frames have, of both motions.
    fn range(&self, of: Of) -> (f64, f64) {
        let frames = self.undistorted.iter().flat_map(|runs| measured(&runs[0].frames));
        extremes(frames.filter_map(|frame| frame.shapes[0].as_ref().map(of)))
    }

    /// A few frames one after the other: the camera's, stabilized only, with rolling shutter removed.
    fn fig11(&self) -> Markup {
        let rows = [
            ("camera", &self.complete[0], 0),
            ("stabilized only", &self.stabilized_only[0], 1),
            ("cho2007", &self.complete[0], 1),
            ("continuous", &self.complete[1], 1),
        ];
        let shown = |name: &str, watch: &PatternWatch, side: usize, frame: u64| {
            let found = watch.frames.get(frame as usize);
            let time_s = found.map_or(0.0, |frame| frame.time_s);
            cell(watch, frame, side, &format!("{name}, {time_s:.2} s"), found.and_then(|frame| frame.shapes[side]))
        };
        html! {
            h2 { "Fig. 11: stabilization with and without a rolling-shutter model" }
            p {
                "Frames of a camera that moves fast left and right. Second row: stabilized with the paper's model as if the camera had no \
                 rolling shutter."
            }
            figure {
                div.grid4 {
                    @for (name, watch, side) in rows {
                        @for frame in &self.sequence { (shown(name, watch, side, *frame)) }
                    }
                }
            }
        }
    }
}

/// A row of the table: camera, cho2007, continuous, a camera without rolling shutter.
struct Row {
    figure: &'static str,
    claim: &'static str,
    what: &'static str,
    values: [Markup; 4],
}

/// A small picture with what was measured in it.
fn cell(watch: &PatternWatch, frame: u64, side: usize, name: &str, shape: Option<Shape>) -> Markup {
    let picture = watch.pictures.iter().find(|(number, _)| *number == frame);
    let measured = shape.map_or("no rectangle is whole".into(), |s| format!("{:.2}°, {:.1} px", s.angle_deg, s.height_px));
    html! {
        div {
            @if let Some((_, pictures)) = picture { (Rgb::of(pictures[side].as_ref()).img(name)) }
            span { (name) br; (measured) }
        }
    }
}

/// The paper's simulation: a frame of 320x240 and where eq. (7) takes it.
fn fig7() -> Markup {
    let motions = [
        ("(a) camera moves right, c = -20", Zoom { a: 1.0, c: -20.0, d: 0.0 }),
        ("(b) camera zooms in by 20 %", Zoom { a: 1.2, c: 0.0, d: 0.0 }),
    ];
    html! {
        h2 { "Fig. 7: a captured frame and its undistorted frame" }
        p { "Where eq. (7) takes the corners of a frame of 320x240. Dashed: as captured. Solid: undistorted." }
        figure { div.pair { @for (name, motion) in motions { (undistorted(name, motion)) } } }
    }
}

/// The frame and where a motion takes it.
fn undistorted(name: &str, motion: Zoom) -> Markup {
    const SIZE: [f64; 2] = [320.0, 240.0];
    let captured = [[0.0, 0.0], [SIZE[0], 0.0], SIZE, [0.0, SIZE[1]]];
    let map = undistortion(motion, SIZE[1]);
    let corners = captured.map(|corner| map.apply(corner));
    let text = |[x, y]: [f64; 2], above: bool| label([x, y + if above { -6.0 } else { 16.0 }], "x", format!("{x:.0}, {y:.0}"));
    html! {
        div {
            svg viewBox="-40 -24 420 290" role="img" aria-label=(name) {
                (Line::through(captured).close().drawn("line before dashed"))
                (Line::through(corners).close().drawn("line after"))
                @for (i, corner) in corners.into_iter().enumerate() { (text(corner, i < 2)) }
            }
            span { (name) }
        }
    }
}

/// The frames that are judged.
fn measured(frames: &[PatternFrame]) -> impl Iterator<Item = &PatternFrame> {
    frames.iter().skip(SKIPPED)
}

fn times_of(report: &Report) -> Vec<f64> {
    let start = report.journal.samples.first().map_or(0, |sample| sample.time_ns);
    report.journal.samples.iter().map(|sample| (sample.time_ns - start) as f64 * 1e-9).collect()
}

/// The lowest and the highest; both 0 where there is none.
fn extremes(values: impl Iterator<Item = f64>) -> (f64, f64) {
    values
        .fold(None, |range, v| range.map_or(Some((v, v)), |(low, high): (f64, f64)| Some((low.min(v), high.max(v)))))
        .unwrap_or_default()
}

/// How far slants are from upright, or how much heights vary, in words for a cell of the table.
fn deviation(frames: &[PatternFrame], side: usize, of: Of) -> Markup {
    let shapes: Vec<Shape> = measured(frames).filter_map(|frame| frame.shapes[side]).collect();
    let count = shapes.len() as f64;
    if shapes.is_empty() {
        return html! { "-" };
    }
    let squares = |from: f64| (shapes.iter().map(|shape| (of(shape) - from).powi(2)).sum::<f64>() / count).sqrt();
    let (low, high) = extremes(shapes.iter().map(of));
    // Slants are compared with the right angle, heights with their mean.
    let is_slant = of(&Shape { height_px: 0.0, angle_deg: 1.0 }) == 1.0;
    let mean = shapes.iter().map(of).sum::<f64>() / count;
    let (off, range) = match is_slant {
        true => {
            let worst = (low - 90.0).abs().max((high - 90.0).abs());
            (format!("{:.2}°", squares(90.0)), format!("max {worst:.2}°"))
        }
        false => (format!("{:.2} %", 100.0 * squares(mean) / mean), format!("{low:.1} to {high:.1} px")),
    };
    html! { (off) br; (range) }
}
