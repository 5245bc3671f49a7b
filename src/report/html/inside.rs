//! The motion inside frames: what the rows did while the frame was read, and what is believed of the camera.

use maud::{Markup, html};

use super::plot::{Plot, Series};
use super::svg::{Line, label};
use super::{Report, Sample};
use crate::frame::Frame;
use crate::geometry::{Calibration, RowMotion, RowPoses};
use crate::stage::shutter::certainty::{self, LIMIT, Stated};

/// Frames whose rows are drawn, and how many frames lie between two of them at least.
const CURVES: usize = 6;
const APART: u64 = 8;
/// Uncertainties are drawn from where they are at most so many times those at which a value counts as known.
const DRAWN: f64 = 3.0;
/// Width of a frame's box, and height of the figure.
const SIDE: f64 = 140.0;
const HEIGHT: f64 = 176.0;

/// How far the rows of a frame are from where the middle row's time would show them, x and y, pixels, in the picture's middle
/// column: evenly from the first row to the last.
type Rows = [[f64; 2]; RowPoses::SAMPLES];

/// The rows of a frame that moved in another way than at one speed.
#[derive(Clone, Debug)]
struct Curve {
    index: u64,
    rows: Rows,
    /// The same at the speed that the camera had on average since the frame before, as the paper's model has it.
    straight: Rows,
    bend: f64,
}

/// Keeps the frames whose rows bend most.
#[derive(Clone, Debug, Default)]
pub(super) struct Inside {
    curves: Vec<Curve>,
    seen: u64,
}

/// What `frame`'s last row moved against its first (x, y, pixels); not finite where unknown.
pub(super) fn sheared(frame: &Frame) -> [f64; 2] {
    match frame.context.rows {
        RowMotion::Uniform { motion, rows } => {
            let part = frame.picture.height() as f64 / rows;
            [motion.0[(0, 2)] * part, motion.0[(1, 2)] * part]
        }
        RowMotion::Poses { .. } => match in_pixels(&frame.context.rows) {
            Some(rows) => [0, 1].map(|axis: usize| rows[RowPoses::SAMPLES - 1][axis] - rows[0][axis]),
            None => [f64::NAN; 2],
        },
    }
}

fn in_pixels(motion: &RowMotion) -> Option<Rows> {
    let RowMotion::Poses { camera, rows } = motion else { return None };
    Some(rows.samples.map(|pose| [-camera.focal * pose[0], camera.focal * pose[1]]))
}

impl Inside {
    /// Looks at a frame's rows.
    pub(super) fn add(&mut self, frame: &Frame) {
        let index = self.seen;
        self.seen += 1;
        let context = &frame.context;
        let (Some(rows), RowMotion::Poses { camera, .. }) = (in_pixels(&context.rows), context.rows) else { return };
        let readout_s = context.calibration.map_or(0.0, |camera| camera.readout_s.value);
        if context.interval_s <= 0.0 || context.repeat || !frame.intact {
            return;
        }
        let speed = [-camera.focal * context.motion[0], camera.focal * context.motion[1]].map(|px| px / context.interval_s);
        let straight: Rows = std::array::from_fn(|i| {
            let time_s = readout_s * (i as f64 / (RowPoses::SAMPLES - 1) as f64 - 0.5);
            speed.map(|speed| speed * time_s)
        });
        let off = |(a, b): (&[f64; 2], &[f64; 2])| (a[0] - b[0]).hypot(a[1] - b[1]);
        let bend = rows.iter().zip(&straight).map(off).fold(0.0, f64::max);
        self.keep(Curve { index, rows, straight, bend });
    }

    fn keep(&mut self, curve: Curve) {
        if !curve.bend.is_finite() {
            return;
        }
        if let Some(near) = self.curves.iter_mut().find(|kept| curve.index - kept.index < APART) {
            if curve.bend > near.bend {
                *near = curve;
            }
            return;
        }
        self.curves.push(curve);
        if self.curves.len() > CURVES {
            let least = (0..self.curves.len()).min_by(|a, b| self.curves[*a].bend.total_cmp(&self.curves[*b].bend));
            least.map(|least| self.curves.remove(least));
        }
    }

    /// The kept frames, rows from top to bottom as in the picture.
    fn figure(&self, times: &[f64]) -> Markup {
        let all = self.curves.iter().flat_map(|curve| curve.rows.iter().chain(&curve.straight)).flatten();
        let widest = all.fold(1e-3_f64, |most, px| most.max(px.abs()));
        html! {
            figure {
                figcaption {
                    b { "Rows of the frames that bend most" }
                    " each box is a frame, top row at the top: how far its rows moved while it was read, against the middle one. Its edges \
                     are " (format!("{widest:.1}")) " px to the left and right."
                    span.legend {
                        span { i.before {} "sideways" }
                        span { i.after {} "up and down (right is down)" }
                        span { i.third {} "at one speed, as the paper has it" }
                    }
                }
                svg viewBox=(format!("0 0 {} {HEIGHT}", SIDE * CURVES as f64)) role="img" aria-label="rows of single frames" {
                    @for (at, curve) in self.curves.iter().enumerate() {
                        (curve.drawn(at as f64 * SIDE, widest))
                        @let time_s = times.get(curve.index as usize).copied().unwrap_or(0.0);
                        @let text = format!("{time_s:.2} s, off by {:.2} px", curve.bend);
                        (label([(at as f64 + 0.5) * SIDE, HEIGHT - 8.0], "x", text))
                    }
                }
            }
        }
    }
}

impl Curve {
    /// The rows in a box from `left` on, which is `widest` pixels wide to either side.
    fn drawn(&self, left: f64, widest: f64) -> Markup {
        let x = |px: f64| left + SIDE / 2.0 + px / widest * (SIDE / 2.0 - 8.0);
        let y = |i: usize| 8.0 + i as f64 / (RowPoses::SAMPLES - 1) as f64 * (HEIGHT - 36.0);
        let line = |rows: &Rows, axis: usize| Line::through((0..rows.len()).map(|i| [x(rows[i][axis]), y(i)]));
        html! {
            (Line::through([[x(0.0), y(0)], [x(0.0), y(RowPoses::SAMPLES - 1)]]).drawn("grid"))
            @for axis in 0..2 { (line(&self.straight, axis).drawn("line third")) }
            (line(&self.rows, 0).drawn("line before"))
            (line(&self.rows, 1).drawn("line after"))
        }
    }
}

/// The section of the page.
pub(super) fn html(report: &Report, times: &[f64]) -> Markup {
    let plots = Plots { samples: &report.journal.samples, times };
    let sheared =
        vec![plots.line("sideways", "before", |s| s.sheared[0]), plots.line("up and down", "after", |s| s.sheared[1])];
    let note = "motion of the picture while a frame was read, last row against first";
    let is_estimated = |Calibration { readout_s, hfov_deg, lens_k1 }: Calibration| {
        [readout_s, hfov_deg, lens_k1].iter().any(|estimate| !estimate.is_exact())
    };
    html! {
        h2 { "Motion inside frames" }
        p {
            "A frame's rows are exposed one after the other, while the camera moves on. How far the picture moved from the first row to the \
             last is how much a frame was slanted (sideways) or stretched (up and down)."
        }
        (plots.figure("Last row against first", note, "px", sheared, Some((-0.1, 0.1))))
        @if !report.inside.curves.is_empty() { (report.inside.figure(times)) }
        @if report.journal.samples.iter().any(|s| s.calibration.is_some_and(is_estimated)) { (plots.calibration()) }
    }
}

/// Plots over the frames of a run.
#[derive(Clone, Copy)]
struct Plots<'a> {
    samples: &'a [Sample],
    times: &'a [f64],
}

impl Plots<'_> {
    fn line(&self, label: &str, class: &'static str, of: impl Fn(&Sample) -> f64) -> Series {
        Series { label: label.into(), class, values: self.samples.iter().map(of).collect() }
    }

    fn figure(&self, title: &str, note: &str, unit: &str, series: Vec<Series>, least: Option<(f64, f64)>) -> Markup {
        Plot { title: title.into(), note: note.into(), unit, times: self.times, series, limit: None, least }.figure()
    }

    /// What is believed of the camera, over time.
    fn calibration(&self) -> Markup {
        let readout = |camera: &Calibration, s: &Sample| certainty::readout(camera, s.interval_s);
        let readout = self.estimate("readout time", readout, |s| LIMIT.0 * s.interval_s, 1e3);
        let hfov = self.estimate("field of view", |camera, _| certainty::hfov(camera), |_| LIMIT.1, 1.0);
        let lens = self.estimate("k1", |camera, _| certainty::lens(camera), |_| LIMIT.2, 1.0);
        html! {
            h2 { "Calibration" }
            p {
                "Readout time, field of view and lens distortion, as estimated from the motion. The outer lines are two standard deviations \
                 apart from the estimate; they are drawn once they are close enough to be useful."
            }
            (self.figure("Readout time", "negative: bottom to top", "ms", readout, None))
            (self.figure("Field of view", "horizontal", "deg", hfov, None))
            (self.figure("Lens distortion", "k1; negative: barrel", "", lens, None))
        }
    }

    /// An estimate between the edges of its interval, times `scale`; the edges only where it is not wider than some times `limit`.
    fn estimate(
        &self,
        name: &str,
        of: impl Fn(&Calibration, &Sample) -> Stated,
        limit: impl Fn(&Sample) -> f64,
        scale: f64,
    ) -> Vec<Series> {
        let stated = |s: &Sample| s.calibration.as_ref().map(|camera| of(camera, s));
        let edge = |part: f64, s: &Sample| {
            let useful = |stated: &Stated| s.interval_s > 0.0 && stated.uncertainty <= DRAWN * limit(s);
            stated(s).filter(useful).map_or(f64::NAN, |stated| scale * (stated.value + part * stated.uncertainty))
        };
        vec![
            self.line("interval", "third", |s| edge(-1.0, s)),
            self.line("", "third", |s| edge(1.0, s)),
            self.line(name, "after", |s| stated(s).map_or(f64::NAN, |stated| scale * stated.value)),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::PathParameters;
    use crate::geometry::{Estimate, Pinhole, Pose};
    use crate::image::{Picture, Sampling};
    use crate::stage::paper::Zoom;

    fn frame(bend: f64) -> Frame {
        let mut frame = Frame { picture: Picture::new(Sampling::Mono, 64, 48), intact: true, ..Frame::default() };
        let mut rows = RowPoses { samples: [Pose::default(); RowPoses::SAMPLES], spacing: 47.0 / 24.0 };
        for (i, pose) in rows.samples.iter_mut().enumerate() {
            let part = i as f64 / 24.0 - 0.5;
            *pose = Pose([-0.02 * part, 0.01 * part + bend * (part * part), 0.0, 0.0]);
        }
        frame.context.rows = RowMotion::Poses { camera: Pinhole { focal: 100.0, centre: [31.5, 23.5], bend: 0.0 }, rows };
        frame.context.interval_s = 0.04;
        frame.context.motion = PathParameters([-0.04, 0.02, 0.0, 0.0]);
        frame.context.calibration = Some(Calibration { readout_s: Estimate::exact(0.02), ..Calibration::default() });
        frame
    }

    #[test]
    fn the_last_row_is_told_from_the_first_in_both_models() {
        let [x, y] = sheared(&frame(0.01));
        assert!((x - 2.0).abs() < 1e-9 && (y - 1.0).abs() < 1e-9, "{x} {y}");
        let mut uniform = frame(0.0);
        let motion = Zoom { c: 4.0, d: -2.0, ..Zoom::IDENTITY };
        uniform.context.rows = RowMotion::Uniform { motion: motion.homography(), rows: 96.0 };
        assert_eq!(sheared(&uniform), [2.0, -1.0]);
    }

    #[test]
    fn frames_that_bend_most_are_kept_apart_from_each_other() {
        let mut inside = Inside::default();
        for n in 0..200 {
            // one speed throughout agrees with the straight line
            inside.add(&frame(if n % 20 == 3 { 0.001 * f64::from(n) } else { 0.0 }));
        }
        let kept: Vec<u64> = inside.curves.iter().map(|curve| curve.index).collect();
        assert_eq!(kept, [83, 103, 123, 143, 163, 183]);
        assert!((inside.curves[0].bend - 100.0 * 0.083 * 0.25).abs() < 1e-9, "{}", inside.curves[0].bend);
        let html = inside.figure(&[0.0; 200]).0;
        assert!(html.matches("<path class=\"line").count() == 24 && !html.contains("NaN"), "{html}");
    }
}
