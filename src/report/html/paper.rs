//! The page of `gimbald demo --paper`: the paper's Figs. 7 and 9 to 12 with gimbald's own pictures and figures, beside what the paper says.

use std::fmt::Write as _;

use super::Report;
use super::picture::Rgb;
use super::plot::{Plot, Series, escaped};
use super::sections::{begin, changes, end, motion_plots};
use crate::geometry::Zoom;
use crate::image::Picture;
use crate::report::{PatternFrame, PatternWatch, Shape};
use crate::stage::shutter::cho2007;

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
        let mut html = begin("gimbald: the paper, reproduced");
        let _ = writeln!(
            html,
            "<p>W. Cho, D. Kim, K. Hong, \"CMOS Digital Image Stabilization\", IEEE Transactions on Consumer Electronics 53 (2007): \
             its experiments, repeated with gimbald {}. {}</p>\n<p>Slant and height are measured in the pixels, each the mean of all \
             rectangles that are whole in a frame, as in the paper. The first second is left out.</p>",
            env!("CARGO_PKG_VERSION"),
            escaped(&self.camera)
        );
        self.table(&mut html);
        fig7(&mut html);
        self.fig9(&mut html);
        self.fig10(&mut html);
        self.fig11(&mut html);
        html.push_str(
            "<h2>Fig. 12: motion of a walk, before and after the low-pass filter</h2>\n<p>The camera's motion from frame to frame, and what is left of \
             it in the output. The number is the root mean square of its change from one frame to the next.</p>\n",
        );
        for (report, model) in self.walk.iter().zip(MODELS) {
            let _ = writeln!(html, "<h3>Model {model}</h3>");
            motion_plots(&mut html, &report.journal, &times_of(report));
        }
        end(&mut html);
        html
    }

    fn table(&self, html: &mut String) {
        html.push_str(
            "<h2>What the paper says, and what was measured</h2>\n<div class=wide><table class=claims>\n<tr><th>figure<th>the paper<th>measured\
             <th class=n>camera<th class=n>cho2007<th class=n>continuous<th class=n>no rolling shutter</tr>\n",
        );
        let mut row = |figure: &str, claim: &str, what: &str, values: [String; 4]| {
            let _ = write!(html, "<tr><td>{figure}<td>{claim}<td>{what}");
            values.iter().for_each(|value| {
                let _ = write!(html, "<td class=n>{value}");
            });
            html.push_str("</tr>\n");
        };
        let none = String::new;
        for (motion, entry, what, claim) in [
            (0, 0, "h2, left and right", "“the value of h2 runs from 0 to 0.08 experimentally”"),
            (1, 1, "h5, up and down", "“h5 ≈ 0.92 ~ 1.07”"),
        ] {
            let (low, high) = extremes(judged(&self.undistorted[motion][0].frames).map(|frame| frame.homography[entry]));
            row("III B", claim, what, [format!("{low:.3} to {high:.3}"), none(), none(), none()]);
        }
        for (figure, claim, motion, what, of) in [
            ("9, 10 (c)", "“constant around the upright angle of 90°”", 0, "slant, left and right", angle as Of),
            ("10 (b)", "(plotted, not commented on)", 0, "height, left and right", height),
            (
                "9, 10 (d)",
                "“its large fluctuation has been removed so that their average height appears regularly”",
                1,
                "height, up and down",
                height,
            ),
            ("10 (e)", "(plotted, not commented on)", 1, "slant, up and down", angle),
        ] {
            let runs = &self.undistorted[motion];
            let says = |watch: &PatternWatch, side| deviation(&watch.frames, side, of);
            row(figure, claim, what, [says(&runs[0], 0), says(&runs[0], 1), says(&runs[1], 1), says(&self.global[motion], 0)]);
        }
        let says = |watch: &PatternWatch, side| deviation(&watch.frames, side, angle);
        let only = &self.stabilized_only;
        let claim = "without a rolling-shutter model “there are no differences except that its motion is smoothed”";
        row("11, middle", claim, "slant, stabilized only", [says(&only[0], 0), says(&only[0], 1), says(&only[1], 1), none()]);
        let whole = &self.complete;
        let claim = "“the same patterns appear more uprightly than those in its original CMOS frames”";
        row("11, bottom", claim, "slant, stabilized", [says(&whole[0], 0), says(&whole[0], 1), says(&whole[1], 1), none()]);
        let left = |report: &Report| {
            let words = changes(&report.journal).map(|change| format!("{} {:.0} %", change.name, 100.0 * change.left()));
            words.collect::<Vec<_>>().join("<br>")
        };
        let claim = "motion “smoothed” by a second-order low-pass filter";
        row("12", claim, "what is left of the change of motion", [none(), left(&self.walk[0]), left(&self.walk[1]), none()]);
        html.push_str(
            "</table></div>\n<p>Slant: root mean square difference from 90°, and the largest. Height: standard deviation in percent of the mean, and the \
             range in pixels. The last column is the same motion filmed by a camera that exposes all rows at once: the perspective of a camera that \
             turns, and the error of the measurement.</p>\n",
        );
    }

    /// The four motions, one column each.
    fn fig9(&self, html: &mut String) {
        html.push_str(
            "<h2>Fig. 9: four motions, before and after</h2>\n<p>The frames in which the camera moves fastest to the right, left, down and up. Rolling \
             shutter is removed, and nothing is stabilized.</p>\n<figure><div class=grid4>\n",
        );
        let columns = ["right", "left", "down", "up"].into_iter().zip(self.fastest).enumerate();
        let columns: Vec<_> = columns.map(|(n, (name, frame))| (name, frame, &self.undistorted[n / 2])).collect();
        for (row, side) in [("camera", 0), ("cho2007", 1), ("continuous", 1)] {
            for (name, frame, runs) in &columns {
                let watch = &runs[usize::from(row == "continuous")];
                let shape = watch.frames.get(*frame as usize).and_then(|frame| frame.shapes[side]);
                cell(html, watch, *frame, side, &format!("{name}, {row}"), shape);
            }
        }
        html.push_str("</div></figure>\n");
    }

    /// Height and slant over time for both motions.
    fn fig10(&self, html: &mut String) {
        html.push_str("<h2>Fig. 10 (b) to (e): height and slant over time</h2>\n");
        for (part, title, motion, unit, of) in [
            ("b", "height, camera moves left and right", 0, "px", height as Of),
            ("c", "slant, camera moves left and right", 0, "deg", angle),
            ("d", "height, camera moves up and down", 1, "px", height),
            ("e", "slant, camera moves up and down", 1, "deg", angle),
        ] {
            let [cho, continuous] = &self.undistorted[motion];
            let line = |label: &str, class, watch: &PatternWatch, side: usize| Series {
                label: label.into(),
                class,
                values: judged(&watch.frames).map(|frame| frame.shapes[side].as_ref().map_or(f64::NAN, of)).collect(),
            };
            let times: Vec<f64> = judged(&cho.frames).map(|frame| frame.time_s).collect();
            let plot = Plot {
                title: format!("({part}) {title}"),
                note: String::new(),
                unit,
                times: &times,
                series: vec![
                    line("camera", "before dashed", cho, 0),
                    line("continuous", "third", continuous, 1),
                    line("cho2007", "after", cho, 1),
                ],
                limit: None,
                // The same range for both motions, so that one sees which of the two distorts what.
                least: Some(self.range(of)),
            };
            html.push_str(&plot.figure());
        }
    }

    /// The values that the cameras' frames have, of both motions.
    fn range(&self, of: Of) -> (f64, f64) {
        let frames = self.undistorted.iter().flat_map(|runs| judged(&runs[0].frames));
        extremes(frames.filter_map(|frame| frame.shapes[0].as_ref().map(of)))
    }

    /// A few frames one after the other: the camera's, stabilized only, with rolling shutter removed.
    fn fig11(&self, html: &mut String) {
        html.push_str(
            "<h2>Fig. 11: stabilization with and without a rolling-shutter model</h2>\n<p>Frames of a camera that moves fast left and right. Second row: \
             stabilized with the paper's model as if the camera had no rolling shutter.</p>\n<figure><div class=grid4>\n",
        );
        for (name, watch, side) in [
            ("camera", &self.complete[0], 0),
            ("stabilized only", &self.stabilized_only[0], 1),
            ("cho2007", &self.complete[0], 1),
            ("continuous", &self.complete[1], 1),
        ] {
            for frame in &self.sequence {
                let found = watch.frames.get(*frame as usize);
                let time_s = found.map_or(0.0, |frame| frame.time_s);
                cell(html, watch, *frame, side, &format!("{name}, {time_s:.2} s"), found.and_then(|frame| frame.shapes[side]));
            }
        }
        html.push_str("</div></figure>\n");
    }
}

/// A small picture with what was measured in it.
fn cell(html: &mut String, watch: &PatternWatch, frame: u64, side: usize, name: &str, shape: Option<Shape>) {
    let picture = watch.pictures.iter().find(|(number, _)| *number == frame);
    let image = picture.map_or(String::new(), |(_, pictures): &(u64, [Picture; 2])| Rgb::of(pictures[side].as_ref()).img(name));
    let measured = shape.map_or("no rectangle is whole".into(), |s| format!("{:.2}°, {:.1} px", s.angle_deg, s.height_px));
    let _ = writeln!(html, "<div>{image}<span>{name}<br>{measured}</span></div>");
}

/// The paper's simulation: a frame of 320x240 and where eq. (7) takes it.
fn fig7(html: &mut String) {
    const SIZE: [f64; 2] = [320.0, 240.0];
    html.push_str(
        "<h2>Fig. 7: a captured frame and its undistorted frame</h2>\n<p>Where eq. (7) takes the corners of a frame of 320x240. Dashed: as captured. \
         Solid: undistorted.</p>\n<figure><div class=pair>\n",
    );
    for (name, motion) in [
        ("(a) camera moves right, c = -20", Zoom { a: 1.0, c: -20.0, d: 0.0 }),
        ("(b) camera zooms in by 20 %", Zoom { a: 1.2, c: 0.0, d: 0.0 }),
    ] {
        let map = cho2007::undistortion(motion, SIZE[1]);
        let corners = [[0.0, 0.0], [SIZE[0], 0.0], SIZE, [0.0, SIZE[1]]].map(|corner| map.apply(corner));
        let path = corners.map(|[x, y]| format!("{x:.2} {y:.2}")).join("L");
        let _ = write!(
            html,
            "<div><svg viewBox=\"-40 -24 420 290\" role=img aria-label=\"{name}\"><path class=\"line before dashed\" d=\"M0 0H{}V{}H0Z\"/>\
             <path class=\"line after\" d=\"M{path}Z\"/>",
            SIZE[0], SIZE[1]
        );
        for ([x, y], (dx, dy)) in corners.into_iter().zip([(0.0, -6.0), (0.0, -6.0), (0.0, 16.0), (0.0, 16.0)]) {
            let _ = write!(html, "<text x={:.1} y={:.1} class=x>{x:.0}, {y:.0}</text>", x + dx, y + dy);
        }
        let _ = writeln!(html, "</svg><span>{name}</span></div>");
    }
    html.push_str("</div></figure>\n");
}

/// The frames that are judged.
fn judged(frames: &[PatternFrame]) -> impl Iterator<Item = &PatternFrame> {
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
fn deviation(frames: &[PatternFrame], side: usize, of: Of) -> String {
    let shapes: Vec<Shape> = judged(frames).filter_map(|frame| frame.shapes[side]).collect();
    let count = shapes.len() as f64;
    if shapes.is_empty() {
        return "-".into();
    }
    let squares = |from: f64| (shapes.iter().map(|shape| (of(shape) - from).powi(2)).sum::<f64>() / count).sqrt();
    let (low, high) = extremes(shapes.iter().map(of));
    // Slants are compared with the right angle, heights with their mean.
    if (of(&Shape { height_px: 0.0, angle_deg: 1.0 })) == 1.0 {
        format!("{:.2}°<br>max {:.2}°", squares(90.0), (low - 90.0).abs().max((high - 90.0).abs()))
    } else {
        let mean = shapes.iter().map(of).sum::<f64>() / count;
        format!("{:.2} %<br>{low:.1} to {high:.1} px", 100.0 * squares(mean) / mean)
    }
}
