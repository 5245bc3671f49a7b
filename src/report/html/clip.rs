//! The player of the page: small pictures of the stretch that shook most, and some from the whole run for the pointer on the plots.

use maud::{Markup, PreEscaped, html};
use serde_json::json;

use super::picture::base64;
use crate::frame::Frame;
use crate::image::PictureRef;
use crate::report::PairEncoder;

/// Length of the stretch (nanoseconds).
const LENGTH_NS: i64 = 5_000_000_000;
/// Time between two of its pictures, at least (nanoseconds).
const INTERVAL_NS: i64 = 60_000_000;
/// Pictures from the whole run; when there are twice as many, every other one goes.
const OVERVIEW: usize = 24;
/// Share of the bytes that the overview may take.
const OVERVIEW_SHARE: f64 = 0.3;
/// Maximum width of a picture (pixels).
const WIDEST: usize = 480;
/// JPEG quality, 1 to 100.
const QUALITY: i32 = 60;

/// Gathers the pictures of a run in bounded memory.
#[derive(Debug)]
pub(super) struct Clip {
    /// `None` where pictures cannot be encoded.
    encoder: Option<PairEncoder>,
    size: [usize; 2],
    seen: u64,
    every: u64,
    overview: Vec<Shot>,
    stretch: Stretch,
    best: Stretch,
}

#[derive(Clone, Debug)]
struct Shot {
    index: u64,
    jpeg: Vec<u8>,
}

#[derive(Clone, Debug, Default)]
struct Stretch {
    start_ns: i64,
    /// Of its last picture.
    last_ns: Option<i64>,
    /// How much the picture moved, in the model's own units.
    shake: f64,
    shots: Vec<Shot>,
}

impl Clip {
    pub(super) fn new() -> Self {
        let encoder = PairEncoder::new(WIDEST, QUALITY).ok();
        let (stretch, best) = Default::default();
        Self { encoder, size: [0; 2], seen: 0, every: 1, overview: Vec::new(), stretch, best }
    }

    /// Takes in a frame and what was drawn of it; `shake` is how much the camera's motion changed since the frame before.
    pub(super) fn add(&mut self, frame: &Frame, output: PictureRef<'_>, shake: f64) {
        let (index, time_ns) = (self.seen, frame.stamp.time_ns);
        self.seen += 1;
        if self.stretch.last_ns.is_none() || time_ns.saturating_sub(self.stretch.start_ns) >= LENGTH_NS {
            self.end_stretch();
            self.stretch.start_ns = time_ns;
        }
        self.stretch.shake += if shake.is_finite() { shake } else { 0.0 };
        let in_overview = index.is_multiple_of(self.every);
        let in_stretch = self.stretch.last_ns.is_none_or(|last| time_ns.saturating_sub(last) >= INTERVAL_NS);
        if !frame.intact || !(in_overview || in_stretch) {
            return;
        }
        let encoded = self.encoder.as_mut().map(|encoder| encoder.encode(output, frame.picture.as_ref()));
        let Some(Ok(encoded)) = encoded else {
            self.encoder = None;
            return;
        };
        self.size = encoded.size;
        let shot = Shot { index, jpeg: encoded.jpeg };
        if in_overview {
            self.overview.push(shot.clone());
            if self.overview.len() > 2 * OVERVIEW {
                self.every *= 2;
                self.overview.retain(|shot| shot.index.is_multiple_of(self.every));
            }
        }
        if in_stretch {
            self.stretch.last_ns = Some(time_ns);
            self.stretch.shots.push(shot);
        }
    }

    fn end_stretch(&mut self) {
        let ended = std::mem::take(&mut self.stretch);
        if ended.shots.len() > 1 && (self.best.shots.len() < 2 || ended.shake > self.best.shake) {
            self.best = ended;
        }
    }

    /// The player as HTML of at most about `room` bytes; nothing where there are too few pictures. `time_of` gives the time of a frame in
    /// seconds.
    pub(super) fn html(&self, room: usize, time_of: impl Fn(u64) -> f64) -> Markup {
        let last_is_best = self.best.shots.len() < 2 || self.stretch.shake > self.best.shake;
        let stretch = if last_is_best { &self.stretch.shots } else { &self.best.shots };
        let overview = thinned(&self.overview, (OVERVIEW_SHARE * room as f64) as usize);
        let mut left = room.saturating_sub(overview.iter().map(|shot| bytes(shot)).sum());
        let stretch: Vec<&Shot> = stretch
            .iter()
            .take_while(|shot| {
                let fits = bytes(shot) <= left;
                left = left.saturating_sub(bytes(shot));
                fits
            })
            .collect();
        let (Some(first), Some(last)) = (stretch.first(), stretch.last()) else { return Markup::default() };
        if stretch.len() < 2 {
            return Markup::default();
        }
        let (from, to) = (time_of(first.index), time_of(last.index));
        let mut all: Vec<&Shot> = stretch.iter().copied().chain(overview).collect();
        all.sort_by_key(|shot| shot.index);
        all.dedup_by_key(|shot| shot.index);
        let tenth_ms = |index: u64| (1e4 * time_of(index)).round() / 1e4;
        let frames: Vec<_> = all.into_iter().map(|shot| json!([tenth_ms(shot.index), base64(&shot.jpeg)])).collect();
        // Numbers and base64: nothing in it ends the element.
        let data = json!({ "size": self.size, "from": tenth_ms(first.index), "to": tenth_ms(last.index), "frames": frames });
        html! {
            (player(from, to))
            script type="application/json" id="clip" { (PreEscaped(data.to_string())) }
        }
    }
}

/// The player, which the page's script fills; its pictures are from `from` to `to` (seconds).
fn player(from: f64, to: f64) -> Markup {
    html! {
        figure #player hidden {
            figcaption {
                b { "Player" }
                " The stretch that shook most, from " (format!("{from:.2}")) " s to " (format!("{to:.2}")) " s. Point at a plot below to see \
                 the nearest picture of that time."
            }
            div #stage tabindex="0" role="slider" aria-label="Divider: before on the left, after on the right" aria-valuemin="0"
                aria-valuemax="100" aria-valuenow="50" {
                canvas #picture {}
                div #divider {}
                span.side.left { "before" }
                span.side.right { "after" }
            }
            div.controls {
                button #play { "Play" }
                input #seek type="range" min="0" max="1" step="any" value="0" aria-label="Time";
                output #time {}
            }
            p.keys { "Drag the divider, or use \u{2190} \u{2192} on the picture. Space plays, comma and period step." }
        }
    }
}

/// A shot's bytes in the page.
fn bytes(shot: &Shot) -> usize {
    shot.jpeg.len().div_ceil(3) * 4 + 16
}

/// Every picture, every second, every fourth and so on: as many as fit.
fn thinned(shots: &[Shot], room: usize) -> Vec<&Shot> {
    let mut step = 1;
    loop {
        let kept: Vec<&Shot> = shots.iter().step_by(step).collect();
        if kept.len() <= 1 || kept.iter().map(|shot| bytes(shot)).sum::<usize>() <= room {
            return kept;
        }
        step *= 2;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::{Picture, Sampling};

    fn run(frames: u64, shaky: std::ops::Range<u64>) -> Clip {
        let mut clip = Clip::new();
        let mut frame = Frame { intact: true, picture: Picture::new(Sampling::S420, 64, 48), ..Frame::default() };
        let output = Picture::new(Sampling::S420, 64, 48);
        for index in 0..frames {
            frame.stamp.time_ns = index as i64 * 1_000_000_000 / 30;
            clip.add(&frame, output.as_ref(), if shaky.contains(&index) { 5.0 } else { 1.0 });
        }
        clip
    }

    fn times(html: &str) -> Vec<f64> {
        let frames = html.split("\"frames\":").nth(1).unwrap();
        frames.split('[').filter_map(|part| part.split(',').next()?.parse().ok()).collect()
    }

    #[test]
    fn the_stretch_that_shook_most_is_shown_and_the_whole_run_a_little() {
        let clip = run(1000, 470..500);
        let html = clip.html(2_000_000, |index| index as f64 / 30.0).0;
        assert!(html.contains("from 15.00 s to 19.93 s"), "{}", &html[..300]);
        let times = times(&html);
        let inside = times.iter().filter(|time| (15.0..20.0).contains(*time)).count();
        assert!((70..=78).contains(&inside), "{inside}");
        assert!(times.len() - inside >= 20 && times[0] == 0.0 && *times.last().unwrap() > 31.0, "{times:?}");
        assert!(times.windows(2).all(|pair| pair[0] < pair[1]));
        // A run that ends with it.
        assert!(run(200, 160..200).html(2_000_000, |index| index as f64 / 30.0).0.contains("from 5.00 s"));
    }

    #[test]
    fn it_takes_no_more_room_than_there_is() {
        let clip = run(1000, 0..1);
        let whole = clip.html(2_000_000, |index| index as f64).0.len();
        for room in [whole / 2, whole / 4] {
            let html = clip.html(room, |index| index as f64).0;
            assert!(html.len() < room + 1500 && times(&html).len() > 3, "{} of {room}", html.len());
        }
        assert_eq!(clip.html(0, |index| index as f64).0, "");
    }

    #[test]
    fn short_and_empty_runs_have_no_player() {
        for frames in [0, 1] {
            assert_eq!(run(frames, 0..0).html(1_000_000, |index| index as f64).0, "");
        }
        assert!(run(4, 0..0).html(1_000_000, |index| index as f64).0.contains("id=\"clip\""));
    }
}
