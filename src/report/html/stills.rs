//! Pictures that show steadiness without moving: frames before and after, a line of pixels over time, many frames laid over
//! each other.

use maud::{Markup, html};

use super::picture::{Rgb, grey_img};
use crate::frame::Frame;
use crate::image::{Picture, PictureRef, Plane, PlaneRef, Sampling};
use crate::kernel::shrink::boxes;
use crate::report::pair::reduced;

/// Pairs that are kept; when they are full, every other one goes.
const PAIRS: usize = 8;
/// Pairs that are shown.
const SHOWN: usize = 3;
/// Maximum width of a picture in the page (pixels).
const WIDEST: usize = 720;
/// Frames whose middle lines are kept.
const LINES: usize = 600;
/// Frames that are laid over each other.
const LAID: usize = 15;

/// The same thing of the input and of the output.
type Pair<T> = [T; 2];

/// Gathers the pictures of a run in bounded memory.
#[derive(Debug)]
pub(super) struct Stills {
    seen: u64,
    every: u64,
    pairs: Vec<(u64, Pair<Picture>)>,
    /// A column a frame: the middle row and the middle column of luma.
    rows: Pair<Plane>,
    columns: Pair<Plane>,
    lined: usize,
    laid: Option<Laid>,
    best: Option<Laid>,
}

/// Frames laid over each other: sums of their samples.
#[derive(Clone, Debug)]
struct Laid {
    first: u64,
    count: usize,
    sampling: Sampling,
    sums: Pair<[Plane<u16>; 3]>,
    /// How much the picture moved, in the model's own units.
    shake: f64,
}

impl Stills {
    pub(super) fn new() -> Self {
        Self {
            seen: 0,
            every: 1,
            pairs: Vec::new(),
            rows: Default::default(),
            columns: Default::default(),
            lined: 0,
            laid: None,
            best: None,
        }
    }

    /// Takes in a frame and what was drawn of it; `shake` is how much the camera moved against the frame before.
    pub(super) fn add(&mut self, frame: &Frame, output: PictureRef<'_>, shake: f64) {
        if !frame.intact {
            self.seen += 1;
            return;
        }
        let pictures = [frame.picture.as_ref(), output];
        if self.seen.is_multiple_of(self.every) {
            if self.pairs.len() == PAIRS {
                self.every *= 2;
                self.pairs.retain(|(index, _)| index.is_multiple_of(self.every));
            }
            if self.seen.is_multiple_of(self.every) {
                self.pairs.push((self.seen, pictures.map(copied)));
            }
        }
        self.line(pictures);
        self.lay(pictures, shake);
        self.seen += 1;
    }

    /// Adds a column of pixels to the slices.
    fn line(&mut self, pictures: Pair<PictureRef<'_>>) {
        if self.lined == LINES {
            return;
        }
        let lumas = pictures.map(|picture| picture.planes[0]);
        if self.lined == 0 {
            self.rows = lumas.map(|luma| Plane::new(LINES, luma.width()));
            self.columns = lumas.map(|luma| Plane::new(LINES, luma.height()));
        }
        for (i, luma) in lumas.into_iter().enumerate() {
            let (x, y) = (luma.width() / 2, luma.height() / 2);
            if luma.width() != self.rows[i].height() || luma.height() != self.columns[i].height() {
                return;
            }
            (0..luma.width()).for_each(|at| self.rows[i].row_mut(at)[self.lined] = luma.at(at, y));
            (0..luma.height()).for_each(|at| self.columns[i].row_mut(at)[self.lined] = luma.at(x, at));
        }
        self.lined += 1;
    }

    /// Lays the frame over those before; keeps the group that shook most.
    fn lay(&mut self, pictures: Pair<PictureRef<'_>>, shake: f64) {
        let laid = self.laid.get_or_insert_with(|| Laid::new(self.seen, pictures));
        if !laid.add(pictures) {
            self.laid = None;
            return;
        }
        laid.shake += if shake.is_finite() { shake } else { 0.0 };
        if laid.count == LAID {
            let full = self.laid.take();
            if self.best.as_ref().is_none_or(|best| full.as_ref().is_some_and(|full| full.shake > best.shake)) {
                self.best = full;
            }
        }
    }

    /// The pictures as HTML. `time_of` gives the time of a frame in seconds.
    pub(super) fn html(&self, time_of: impl Fn(u64) -> f64) -> Markup {
        let shown = SHOWN.min(self.pairs.len());
        html! {
            @if let Some(laid) = &self.best {
                @let note = format!(
                    "{LAID} consecutive frames laid over each other, from {:.2} s on, where the camera shook most. Parts that do not move are sharp.",
                    time_of(laid.first)
                );
                (pair_html("Frames laid over each other", &note, "pair", self.images(&laid.means())))
            }
            @if self.lined > 1 { (self.slices()) }
            // Spread over the run, away from its ends.
            @for (index, pictures) in (0..shown).map(|i| &self.pairs[(2 * i + 1) * self.pairs.len() / (2 * shown)]) {
                (pair_html(&format!("Frame {index}"), &format!("at {:.2} s", time_of(*index)), "pair", self.images(pictures)))
            }
        }
    }

    /// The middle lines over time.
    fn slices(&self) -> Markup {
        let slice = |plane: &Plane, alt| {
            // Tall ones are reduced: only their height is shown smaller.
            let down = plane.height().div_ceil(WIDEST);
            let mut small: Plane = Plane::new(self.lined, plane.height() / down);
            if let Some(part) = PlaneRef::new(plane.samples(), self.lined, plane.height(), plane.width()) {
                let rows = 0..small.height();
                boxes(part, (1, down), &mut small.as_mut(), rows);
            }
            grey_img(small.as_ref(), alt)
        };
        let pair = |[before, after]: &Pair<Plane>| [slice(before, "before"), slice(after, "after")];
        let columns =
            "The middle column of each frame, side by side: time runs to the right. A steady picture draws level lines.";
        let rows = "The middle row of each frame, rotated: time runs to the right, the left of the picture is at the top.";
        html! {
            (pair_html("Up and down over time", columns, "pair slice", pair(&self.columns)))
            (pair_html("Left and right over time", rows, "pair slice", pair(&self.rows)))
        }
    }

    fn images(&self, pictures: &Pair<Picture>) -> Pair<Markup> {
        [0, 1].map(|i| Rgb::of(reduced(pictures[i].as_ref(), WIDEST).as_ref()).img(["before", "after"][i]))
    }
}

impl Laid {
    fn new(first: u64, pictures: Pair<PictureRef<'_>>) -> Self {
        let sums = pictures.map(|picture| picture.planes.map(|plane| Plane::new(plane.width(), plane.height())));
        Self { first, count: 0, sampling: pictures[0].sampling, sums, shake: 0.0 }
    }

    /// Lays a frame on top; `false` where it has another shape.
    fn add(&mut self, pictures: Pair<PictureRef<'_>>) -> bool {
        for (sums, picture) in self.sums.iter_mut().zip(pictures) {
            for (sums, plane) in sums.iter_mut().zip(picture.planes) {
                if (sums.width(), sums.height()) != (plane.width(), plane.height()) {
                    return false;
                }
                for y in 0..plane.height() {
                    sums.row_mut(y).iter_mut().zip(plane.row(y)).for_each(|(sum, sample)| *sum += u16::from(*sample));
                }
            }
        }
        self.count += 1;
        true
    }

    /// The mean pictures.
    fn means(&self) -> Pair<Picture> {
        [0, 1].map(|i| {
            let luma = &self.sums[i][0];
            let mut picture = Picture::new(self.sampling, luma.width(), luma.height());
            for (plane, sums) in picture.as_mut().planes.iter_mut().zip(&self.sums[i]) {
                for y in 0..plane.height().min(sums.height()) {
                    let mean = |sum: &u16| ((usize::from(*sum) + self.count / 2) / self.count.max(1)) as u8;
                    plane.row_mut(y).iter_mut().zip(sums.row(y)).for_each(|(sample, sum)| *sample = mean(sum));
                }
            }
            picture
        })
    }
}

fn copied(from: PictureRef<'_>) -> Picture {
    let mut picture = Picture::new(from.sampling, from.width(), from.height());
    picture.as_mut().planes.iter_mut().zip(from.planes).for_each(|(to, from)| to.copy_from(from));
    picture
}

/// Two pictures beside each other; `class` is the style sheet's.
fn pair_html(title: &str, note: &str, class: &str, [before, after]: Pair<Markup>) -> Markup {
    html! {
        figure {
            figcaption { b { (title) } " " (note) }
            div class=(class) {
                div { (before) span { "before" } }
                div { (after) span { "after" } }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(frames: u64) -> Stills {
        let mut stills = Stills::new();
        let mut frame = Frame { intact: true, ..Frame::default() };
        let output = Picture::new(Sampling::S420, 8, 6);
        for index in 0..frames {
            frame.picture = Picture::new(Sampling::S420, 8, 6);
            frame.picture.as_mut().planes[0].fill(index as u8);
            stills.add(&frame, output.as_ref(), if (30..45).contains(&index) { 5.0 } else { 1.0 });
        }
        stills
    }

    #[test]
    fn few_pairs_are_kept_of_a_long_run_evenly() {
        let stills = run(1000);
        let kept: Vec<u64> = stills.pairs.iter().map(|(index, _)| *index).collect();
        assert_eq!(kept, [0, 128, 256, 384, 512, 640, 768, 896]);
        assert_eq!(stills.pairs[1].1[0].luma().at(0, 0), 128);
        assert_eq!((stills.lined, stills.columns[0].row(3)[599]), (LINES, (599 % 256) as u8));
    }

    #[test]
    fn the_group_that_shook_most_is_laid_together() {
        let best = run(100).best.unwrap();
        assert_eq!((best.first, best.count), (30, LAID));
    }

    #[test]
    fn short_and_empty_runs_have_a_page_too() {
        for frames in [0, 1, 2, 14] {
            let html = run(frames).html(|index| index as f64).0;
            assert_eq!(html.contains("<b>Frame "), frames > 0, "{frames}");
        }
    }
}
