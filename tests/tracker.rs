//! The tracker alone, on pairs of pictures whose motion is known.

mod common;

use common::{drawn_frame, film, frame_of, normal, quantile};
use gimbald::device::synthetic::{self, Motion, Synthetic};
use gimbald::frame::{Frame, Track};
use gimbald::kernel::Level;
use gimbald::random::SplitMix;
use gimbald::stage::{detect, track};

const SIZE: [usize; 2] = [320, 240];

/// Corners of `before`, followed into `now`.
fn follow(before: &Frame, now: &mut Frame, params: track::Params) -> Vec<Track> {
    let mut features = Vec::new();
    detect::Detector::new(detect::Params::default()).replenish(before, &mut features);
    assert!(features.len() > 150, "only {} corners", features.len());
    track::Tracker::new(params, Level::detected()).follow(before, now, &mut features);
    now.context.tracks.clone()
}

/// A wall of soft-edged blocks, large and small, known at every point: what a lens leaves of an edge is `EDGE` wide.
fn wall(x: f64, y: f64) -> f64 {
    const EDGE: f64 = 0.8;
    let mut value = 115.0 + 20.0 * (0.021 * x + 0.013 * y).sin();
    for (cell, height) in [(53.0, 45.0), (13.0, 45.0)] {
        let (column, row) = ((x / cell).floor(), (y / cell).floor());
        for (i, j) in [-1.0, 0.0, 1.0].into_iter().flat_map(|j| [-1.0, 0.0, 1.0].map(|i| (column + i, row + j))) {
            let mut random = SplitMix::new(((i as i64 as u64) << 32) ^ (j as i64 as u64 & 0xffff_ffff) ^ cell as u64);
            let centre = [(i + 0.5 + 0.4 * random.signed()) * cell, (j + 0.5 + 0.4 * random.signed()) * cell];
            let half = [0.2 + 0.25 * random.signed().abs(), 0.2 + 0.25 * random.signed().abs()].map(|h| h * cell);
            let height = height * random.signed();
            let inside = |d: f64, half: f64| 1.0 / (1.0 + (-(half - d.abs()) / (0.5 * EDGE)).exp());
            value += height * inside(x - centre[0], half[0]) * inside(y - centre[1], half[1]);
        }
    }
    value.clamp(15.0, 220.0)
}

/// A motion of the picture: turned and magnified about its middle, then shifted.
#[derive(Clone, Copy, Debug)]
struct Move {
    shift: [f64; 2],
    degrees: f64,
    zoom: f64,
}

impl Move {
    fn to(self, [x, y]: [f64; 2]) -> [f64; 2] {
        let [cx, cy] = SIZE.map(|n| n as f64 / 2.0);
        let (sin, cos) = self.degrees.to_radians().sin_cos();
        let (u, v) = (self.zoom * (x - cx), self.zoom * (y - cy));
        [cos * u - sin * v + cx + self.shift[0], sin * u + cos * v + cy + self.shift[1]]
    }

    fn from(self, [x, y]: [f64; 2]) -> [f64; 2] {
        let [cx, cy] = SIZE.map(|n| n as f64 / 2.0);
        let (sin, cos) = self.degrees.to_radians().sin_cos();
        let (u, v) = (x - cx - self.shift[0], y - cy - self.shift[1]);
        [(cos * u + sin * v) / self.zoom + cx, (cos * v - sin * u) / self.zoom + cy]
    }
}

const fn moved(x: f64, y: f64, degrees: f64, zoom: f64) -> Move {
    Move { shift: [x, y], degrees, zoom }
}

const MOVES: [Move; 9] = [
    moved(0.0, 0.0, 0.0, 1.0),
    moved(0.25, -0.5, 0.0, 1.0),
    moved(0.5, 0.5, 0.0, 1.0),
    moved(3.3, -2.7, 0.0, 1.0),
    moved(11.6, 7.4, 0.0, 1.0),
    moved(-17.2, 9.1, 0.0, 1.0),
    moved(1.7, 0.4, 1.0, 1.0),
    moved(0.3, 0.8, 0.0, 1.02),
    moved(-6.4, 4.9, -2.0, 0.99),
];

/// The wall before and after a motion, with noise of the given deviation.
fn pair(motion: Move, noise: f64) -> (Frame, Frame) {
    let draw = |seed: u64, at: &dyn Fn([f64; 2]) -> [f64; 2]| {
        let random = std::cell::RefCell::new(SplitMix::new(seed));
        drawn_frame(SIZE[0], SIZE[1], |x, y| {
            let [x, y] = at([x, y]);
            wall(x, y) + if noise > 0.0 { noise * normal(&mut random.borrow_mut()) } else { 0.0 }
        })
    };
    (draw(11, &|p| p), draw(12, &|p| motion.from(p)))
}

fn errors(tracks: &[Track], mut truth: impl FnMut([f64; 2]) -> [f64; 2]) -> Vec<f64> {
    let mut distance = |t: &Track| {
        let to = truth(t.from);
        (t.to[0] - to[0]).hypot(t.to[1] - to[1])
    };
    tracks.iter().map(&mut distance).collect()
}

/// Measured without noise: medians of 0.000 to 0.034 px, with noise 0.042 to 0.053 px; with the last motion (60 degrees a second at 30
/// frames a second: the patch is not turned with the picture) 0.062 and 0.074 px.
#[test]
fn known_motion_is_measured_to_a_few_hundredths_of_a_pixel() {
    for (noise, most) in [(0.0, 0.06), (2.0, 0.08)] {
        for motion in MOVES {
            let most = most + if motion.degrees < -1.5 { 0.02 } else { 0.0 };
            let (before, mut now) = pair(motion, noise);
            let tracks = follow(&before, &mut now, track::Params::default());
            let mut off = errors(&tracks, |p| motion.to(p));
            let (median, p95) = (quantile(&mut off, 0.5), quantile(&mut off, 0.95));
            println!("noise {noise}, {motion:?}: {} tracks, median {median:.4} px, 95 % {p95:.3} px", tracks.len());
            assert!(tracks.len() > 120, "{motion:?}: {} tracks", tracks.len());
            assert!(median <= most, "{motion:?} with noise {noise}: median error {median} px");
        }
    }
}

/// The synthetic camera's wall is harder: texels are sampled, not averaged. Measured: medians of 0.028 (4 px a frame) to 0.043 px
/// (22 px a frame) without noise, 0.037 to 0.051 px with.
#[test]
fn the_synthetic_cameras_motion_is_measured_too() {
    let cases = [
        (Motion::Handheld, 1.0, 25.0),
        (Motion::Horizontal, 3.0, 0.0),
        (Motion::Vertical, 2.0, 20.0),
        (Motion::Walk, 2.0, 30.0),
    ];
    for (motion, gain, readout_ms) in cases {
        for (noise, most) in [(0.0, 0.06), (2.0, 0.08)] {
            let params = synthetic::Params {
                width: SIZE[0] as u32,
                height: SIZE[1] as u32,
                motion,
                gain,
                readout_ms,
                noise,
                frames: 6,
                ..synthetic::Params::default()
            };
            let camera = Synthetic::new(&params).unwrap();
            let shots = film(&params);
            let (mut off, mut farthest) = (Vec::new(), 0.0f64);
            for k in 0..5 {
                let (before, mut now) = (frame_of(&shots[k]), frame_of(&shots[k + 1]));
                let tracks = follow(&before, &mut now, track::Params::default());
                off.extend(errors(&tracks, |p| {
                    let ray = camera.ray(p, camera.row_time_s(k as u64, p[1]));
                    let to = camera.locate(ray, k as u64 + 1).unwrap();
                    farthest = farthest.max((to[0] - p[0]).hypot(to[1] - p[1]));
                    to
                }));
            }
            let (median, p95) = (quantile(&mut off, 0.5), quantile(&mut off, 0.95));
            println!(
                "{motion:?}, noise {noise}: {} tracks up to {farthest:.1} px, median {median:.4} px, 95 % {p95:.3} px",
                off.len()
            );
            assert!(median <= most, "{motion:?} with noise {noise}: median error {median} px");
        }
    }
}

/// Something comes before the wall: points behind it are not there any more, and whatever they are taken for is not found back.
#[test]
fn points_that_are_hidden_are_rejected() {
    let motion = moved(1.3, -0.8, 0.0, 1.0);
    let (before, _) = pair(motion, 0.0);
    // a board with a pattern of its own, 110 x 140 pixels
    let hidden = |[x, y]: [f64; 2], rim: f64| (x - 160.0).abs() < 55.0 + rim && (y - 120.0).abs() < 70.0 + rim;
    let now = || {
        drawn_frame(SIZE[0], SIZE[1], |x, y| {
            let [wx, wy] = motion.from([x, y]);
            if hidden([x, y], 0.0) { wall(1.1 * y + 2000.0, 0.9 * x - 900.0) } else { wall(wx, wy) }
        })
    };
    let count = |max_round_trip_px: f64| {
        let tracks = follow(&before, &mut now(), track::Params { max_round_trip_px, ..track::Params::default() });
        let behind = |t: &&Track| hidden(motion.to(t.from), -8.0);
        let clear = tracks.iter().filter(|t| !hidden(motion.to(t.from), 10.0)).count();
        (tracks.iter().filter(behind).count(), clear)
    };
    let mut corners = Vec::new();
    detect::Detector::new(detect::Params::default()).replenish(&before, &mut corners);
    let covered = corners.iter().filter(|f| hidden(motion.to(f.at.map(f64::from)), -8.0)).count();
    let (checked, clear) = count(track::Params::default().max_round_trip_px);
    let (unchecked, clear_unchecked) = count(1e6);
    println!(
        "{covered} corners hidden: {checked} survive the check, {unchecked} without it; {clear} of {clear_unchecked} in view"
    );
    assert!(covered > 60);
    assert!(checked * 20 <= covered, "{checked} of {covered} hidden corners are still followed");
    assert!(unchecked >= 4 * checked.max(1), "the check does nothing: {unchecked} without, {checked} with it");
    assert!(clear * 100 >= 97 * clear_unchecked, "{clear} of {clear_unchecked} points in view are kept");
}

/// A lamp flickers: 10 % more or less contrast, and some grey levels up or down.
#[test]
fn a_change_of_brightness_moves_nothing() {
    let motion = moved(2.4, -1.7, 0.3, 1.0);
    let (before, mut same) = pair(motion, 0.0);
    let plain = follow(&before, &mut same, track::Params::default());
    for (contrast, offset) in [(1.1, 0.0), (0.9, 0.0), (1.0, 12.0), (1.1, -12.0), (0.9, 12.0)] {
        let mut now = drawn_frame(SIZE[0], SIZE[1], |x, y| {
            let [x, y] = motion.from([x, y]);
            wall(x, y) * contrast + offset
        });
        let changed = follow(&before, &mut now, track::Params::default());
        let apart = |t: &Track| {
            let other = plain.iter().find(|p| p.id == t.id)?;
            Some((t.to[0] - other.to[0]).hypot(t.to[1] - other.to[1]))
        };
        let mut apart: Vec<f64> = changed.iter().filter_map(apart).collect();
        let off = quantile(&mut errors(&changed, |p| motion.to(p)), 0.5);
        let (p99, most) = (quantile(&mut apart, 0.99), quantile(&mut apart, 1.0));
        println!(
            "x{contrast} + {offset}: {} of {} tracks, moved by 99 % {p99:.4}, at most {most:.4} px",
            apart.len(),
            plain.len()
        );
        assert!(apart.len() * 100 >= 98 * plain.len(), "{} of {} tracks are left", apart.len(), plain.len());
        assert!(p99 < 0.1 && off <= 0.06, "99 % of the tracks moved by up to {p99} px, median error {off}");
    }
}
