//! Cameras that travel, as tracks whose truth is known.

use super::*;
use crate::frame::Fit;
use crate::geometry::Pinhole;
use crate::random::Congruential;
use crate::stage::shutter::{Prior, certainty};

const SIZE: [usize; 2] = [640, 360];
const HFOV_DEG: f64 = 65.0;
const INTERVAL_S: f64 = 1.0 / 30.0;
/// Of the camera above the ground (m).
const HEIGHT_M: f64 = 1.4;

/// Of the wall before the camera (m).
const WALL_M: f64 = 5.0;

/// A camera's ground truth: pose (yaw, pitch, roll; radians) and place (right, down, forward; m) by time, and its readout (seconds).
struct Truth {
    pose: fn(f64) -> [f64; 3],
    place: fn(f64) -> [f64; 3],
    readout_s: f64,
    /// Whether a wall fills the picture, in place of the ground below a far horizon.
    walled: bool,
    /// Of the lens.
    k1: f64,
    /// From frame to frame (seconds).
    interval_s: f64,
}

fn optics(readout_s: Prior, hfov_deg: Prior) -> Optics {
    Optics { readout_s, hfov_deg, lens_k1: Prior::Fixed(0.0) }
}

fn still(_: f64) -> [f64; 3] {
    [0.0; 3]
}

fn shaken(t: f64) -> [f64; 3] {
    [0.012 * (11.0 * t).sin(), 0.015 * (13.0 * t + 1.0).sin() + 0.004 * (29.0 * t).sin(), 0.006 * (9.0 * t + 2.0).sin()]
}

fn swaying(t: f64) -> [f64; 3] {
    [0.08 * (5.0 * t).sin() + 0.04 * (17.0 * t).sin(), 0.06 * (7.0 * t + 1.0).sin(), 0.8 * t]
}

fn walking(t: f64) -> [f64; 3] {
    [0.03 * (6.0 * t).sin(), 0.02 * (12.0 * t + 0.5).sin(), 1.2 * t]
}

impl Truth {
    fn camera(&self) -> Pinhole {
        Pinhole::new(SIZE, HFOV_DEG).with_lens(self.k1, SIZE[0])
    }

    /// Where the camera sees a point (metres, or a direction where `far`) at `t`, pixels.
    fn seen(&self, point: [f64; 3], far: bool, t: f64) -> [f64; 2] {
        let camera = self.camera();
        let from = if far { [0.0; 3] } else { (self.place)(t) };
        let d: [f64; 3] = std::array::from_fn(|i| point[i] - from[i]);
        let [cx, cy] = camera.centre;
        let straight = [cx + camera.focal * d[0] / d[2], cy + camera.focal * d[1] / d[2]];
        let [yaw, pitch, roll] = (self.pose)(t);
        camera.bent(camera.turned(Pose([yaw, pitch, roll, 0.0])).apply(straight))
    }

    /// Where the frame of number `k` shows the point: on the row that was read when it was there.
    fn shown(&self, point: [f64; 3], far: bool, k: usize) -> [f64; 2] {
        let mut y = 0.5 * SIZE[1] as f64;
        for _ in 0..12 {
            let t = k as f64 * self.interval_s + self.readout_s * y / SIZE[1] as f64;
            y = self.seen(point, far, t)[1];
        }
        self.seen(point, far, k as f64 * self.interval_s + self.readout_s * y / SIZE[1] as f64)
    }

    /// Tracks from frame `k` to the next: the wall, or above the horizon far things and below it the ground, each with an error of
    /// .05 px.
    fn tracks(&self, k: usize, random: &mut impl FnMut() -> f64) -> Vec<Track> {
        let camera = self.camera();
        let place = (self.place)(k as f64 * self.interval_s);
        let mut tracks = Vec::new();
        while tracks.len() < 300 {
            let [x, y] = [0.5 * (random() + 1.0) * SIZE[0] as f64, 0.5 * (random() + 1.0) * SIZE[1] as f64];
            let [straight_x, straight_y] = camera.straight([x, y]);
            let ray = [(straight_x - camera.centre[0]) / camera.focal, (straight_y - camera.centre[1]) / camera.focal, 1.0];
            let far = !self.walled && ray[1] < 0.06;
            let reach = if self.walled {
                WALL_M - place[2]
            } else if far {
                1.0
            } else {
                (HEIGHT_M - place[1]) / ray[1]
            };
            let point = std::array::from_fn(|i| reach * ray[i] + if far { 0.0 } else { place[i] });
            let [from, to] = [self.shown(point, far, k), self.shown(point, far, k + 1)];
            let inside = |p: [f64; 2]| (0..2).all(|i| p[i] > 0.0 && p[i] < SIZE[i] as f64);
            if inside(from) && inside(to) {
                let to = to.map(|c| c + 0.05 * random());
                tracks.push(Track { from, to, sigma_px: 0.05, background: 1.0, ..Track::default() });
            }
        }
        tracks
    }

    /// The model after `frames` frames, and the motion of the rows within a frame that it found: root mean squares over the last two
    /// thirds of the frames of what is wrong with it and of what it is, pixels.
    fn followed(&self, readout: Prior, frames: usize) -> (Continuous, f64, f64) {
        let hfov = if readout == Prior::Unknown { Prior::Unknown } else { Prior::Fixed(HFOV_DEG) };
        self.followed_by(optics(readout, hfov), frames)
    }

    /// The same with a model that is told `optics`.
    fn followed_by(&self, optics: Optics, frames: usize) -> (Continuous, f64, f64) {
        let mut random = numbers();
        let mut model = Continuous::new(optics, 1, Level::detected());
        model.begin(SIZE);
        let (mut off, mut size, mut count) = (0.0, 0.0, 0);
        for k in 0..frames {
            let mut tracks = self.tracks(k, &mut random);
            let fit = Fit::default();
            model.observe(Pair { tracks: &mut tracks, fit: &fit, interval_s: self.interval_s, off_s: 0.0, is_certain: true });
            if k < frames / 3 {
                continue;
            }
            let RowMotion::Poses { camera, rows } = model.newest().rows else { panic!("not rows") };
            let pose = |y: f64| (self.pose)((k + 1) as f64 * self.interval_s + self.readout_s * y / SIZE[1] as f64);
            let middle = pose(0.5 * SIZE[1] as f64);
            for y in (0..SIZE[1]).step_by(30) {
                let (found, truth) = (rows.at(y as f64), pose(y as f64));
                for c in 0..2 {
                    let truth = camera.focal * (truth[c] - middle[c]);
                    off += (camera.focal * found[c] - truth).powi(2);
                    size += truth * truth;
                }
                count += 1;
            }
        }
        let mean = |sum: f64| (sum / f64::from(count)).sqrt();
        (model, mean(off), mean(size))
    }
}

/// Measured: off by .015 px where the camera goes straight on, by .041 px of .67 where it is shaken, too.
#[test]
fn travel_does_not_bend_the_rows() {
    for (name, pose, allowed) in [("straight", still as fn(f64) -> [f64; 3], 0.05), ("shaken", shaken, 0.1)] {
        let truth =
            Truth { pose, place: walking, readout_s: 0.75 * INTERVAL_S, walled: false, k1: 0.0, interval_s: INTERVAL_S };
        let (model, off, size) = truth.followed(Prior::Fixed(truth.readout_s), 90);
        println!("{name}: rows off by {off:.3} px of {size:.3}");
        assert!(off < allowed, "{name}: {off} px");
        assert!(model.newest().path[3].abs() < 0.01, "the path zooms: {}", model.newest().path[3]);
    }
}

/// Measured: off by .004 px of .67.
#[test]
fn a_camera_that_only_turns_is_followed_as_closely() {
    let truth =
        Truth { pose: shaken, place: still, readout_s: 0.75 * INTERVAL_S, walled: false, k1: 0.0, interval_s: INTERVAL_S };
    let (_, off, size) = truth.followed(Prior::Fixed(truth.readout_s), 90);
    println!("rows off by {off:.3} px of {size:.3}");
    assert!(off < 0.02 && size > 0.5, "{off} px of {size}");
}

/// Measured: .120, -.118, .001 and .080 with a camera that only turns, off by .007 to .021 where it walks on as well.
#[test]
fn the_lens_is_found() {
    for (k1, hfov_deg) in
        [(-0.12, Prior::Fixed(HFOV_DEG)), (-0.12, Prior::Unknown), (0.0, Prior::Unknown), (0.08, Prior::Unknown)]
    {
        for place in [still as fn(f64) -> [f64; 3], walking] {
            let truth = Truth { pose: shaken, place, readout_s: 0.75 * INTERVAL_S, walled: false, k1, interval_s: INTERVAL_S };
            let optics = Optics { readout_s: Prior::Fixed(truth.readout_s), hfov_deg, lens_k1: Prior::Unknown };
            let (model, off, size) = truth.followed_by(optics, 120);
            let found = certainty::lens(&model.calibration().unwrap());
            println!("k1 {k1}: {:.3} +- {:.3}, rows off by {off:.3} px of {size:.3}", found.value, found.uncertainty);
            assert!((found.value - k1).abs() < found.uncertainty, "{k1}: {found:?}");
            assert!((found.value - k1).abs() < 0.04, "{k1}: {found:?}");
            assert!(off < 0.1, "{off} px");
        }
    }
}

/// Where nothing is far, the picture as a whole is what is to be held: the path follows it, and is believed. Measured: .3 px of its 2.4 px
/// acceleration are left; without rows that hold the path .5 px, and confidence sinks to .45.
#[test]
fn where_all_is_near_the_path_follows_the_picture() {
    let truth =
        Truth { pose: shaken, place: swaying, readout_s: 0.75 * INTERVAL_S, walled: true, k1: 0.0, interval_s: INTERVAL_S };
    let camera = Pinhole::new(SIZE, HFOV_DEG);
    let mut model = Continuous::new(optics(Prior::Fixed(truth.readout_s), Prior::Fixed(HFOV_DEG)), 1, Level::detected());
    model.begin(SIZE);
    let mut random = numbers();
    let (mut confidence, mut rest, mut speeds) = (1.0f64, Vec::new(), Vec::new());
    for k in 0..120 {
        let mut tracks = truth.tracks(k, &mut random);
        let mean = |c: usize| tracks.iter().map(|track| track.to[c] - track.from[c]).sum::<f64>() / tracks.len() as f64;
        let picture = [mean(0), mean(1)];
        let fit = Fit::default();
        model.observe(Pair { tracks: &mut tracks, fit: &fit, interval_s: INTERVAL_S, off_s: 0.0, is_certain: true });
        if k < 40 {
            continue;
        }
        let motion = model.newest();
        confidence = confidence.min(motion.confidence);
        let by_path = camera.derivative(camera.centre).map(|row| pose_of(motion.motion).dot(&row));
        rest.push([picture[0] - by_path[0], picture[1] - by_path[1]]);
        speeds.push(picture);
    }
    let rough = |speeds: &[[f64; 2]]| {
        let squares = speeds.windows(2).map(|pair| (0..2).map(|c| (pair[1][c] - pair[0][c]).powi(2)).sum::<f64>());
        (squares.sum::<f64>() / (speeds.len() - 1) as f64).sqrt()
    };
    println!("confidence {confidence:.2}, acceleration {:.3} px, left by the path {:.3} px", rough(&speeds), rough(&rest));
    assert_eq!(confidence, 1.0);
    assert!(rough(&rest) < 0.15 * rough(&speeds), "{} of {}", rough(&rest), rough(&speeds));
}

/// A dark picture: nothing is seen for some frames, then a few points that agree with each other and with nothing else.
#[test]
fn after_silence_the_path_rests_and_a_few_points_are_not_believed_at_once() {
    fn panned(t: f64) -> [f64; 3] {
        [0.4 * t, 0.0, 0.0]
    }
    let truth = Truth { pose: panned, place: still, readout_s: 0.0, walled: false, k1: 0.0, interval_s: INTERVAL_S };
    let mut model = Continuous::new(optics(Prior::Fixed(0.0), Prior::Fixed(HFOV_DEG)), 1, Level::detected());
    model.begin(SIZE);
    let mut random = numbers();
    let observe = |model: &mut Continuous, mut tracks: Vec<Track>| {
        let fit = Fit::default();
        model.observe(Pair { tracks: &mut tracks, fit: &fit, interval_s: INTERVAL_S, off_s: 0.0, is_certain: true });
        model.newest()
    };
    let last = (0..40).map(|k| observe(&mut model, truth.tracks(k, &mut random))).last().unwrap();
    assert!(last.confidence == 1.0 && last.motion[0] > 0.012, "{last:?}");
    let dark = (0..6).map(|_| observe(&mut model, Vec::new())).last().unwrap();
    let gone = (dark.path[0] - last.path[0]) / last.motion[0];
    assert!((0.0..4.0).contains(&gone), "in six frames without tracks the path went on by {gone:.2} frames' motion");
    let few = |k: usize, random: &mut dyn FnMut() -> f64| truth.tracks(k, &mut || random()).into_iter().step_by(12).collect();
    let found: Vec<f64> = (46..76).map(|k| observe(&mut model, few(k, &mut random)).confidence).collect();
    assert!(found[0] < 0.3, "25 of 300 points are believed at once: {found:?}");
    assert!(found[29] > 0.5, "and never: {found:?}");
}

/// Measured: .763 +- .267 for .75 and .076 +- .287 for .02.
#[test]
fn the_readout_is_found_beside_travel_or_said_to_be_unknown() {
    for readout in [0.75, 0.02] {
        let truth = Truth {
            pose: shaken,
            place: walking,
            readout_s: readout * INTERVAL_S,
            walled: false,
            k1: 0.0,
            interval_s: INTERVAL_S,
        };
        let (model, ..) = truth.followed(Prior::Unknown, 150);
        let found = certainty::readout(&model.calibration().unwrap(), INTERVAL_S);
        let [value, uncertainty] = [found.value, found.uncertainty].map(|s| s / INTERVAL_S);
        println!("readout {readout}: {value:.3} +- {uncertainty:.3}");
        assert!((value - readout).abs() < 0.1, "{readout}: {value}");
        assert!((value - readout).abs() < uncertainty, "{readout}: {value} +- {uncertainty}");
    }
    let truth =
        Truth { pose: still, place: walking, readout_s: 0.75 * INTERVAL_S, walled: false, k1: 0.0, interval_s: INTERVAL_S };
    let (model, ..) = truth.followed(Prior::Unknown, 150);
    let found = model.calibration().unwrap();
    println!("no shake: {:?}", certainty::readout(&found, INTERVAL_S));
    assert_eq!(certainty::known_readout(&found, INTERVAL_S), None);
    assert_eq!(certainty::known_hfov(&found), None);
}

/// Numbers between -1 and 1, always the same.
fn numbers() -> impl FnMut() -> f64 {
    let mut generator = Congruential::new(5);
    move || generator.signed()
}

/// Tracks of a camera with a global shutter that turns by `turn` between two frames, each with an error of .1 px.
fn turned(camera: &Pinhole, turn: Pose, random: &mut impl FnMut() -> f64) -> Vec<Track> {
    let homography = camera.turned(turn);
    let track = |_| {
        let from = [0, 1].map(|i| 0.5 * (random() + 1.0) * SIZE[i] as f64);
        let to = camera.bent(homography.apply(camera.straight(from))).map(|c| c + 0.1 * random());
        Track { from, to, sigma_px: 0.1, background: 1.0, ..Track::default() }
    };
    (0..200).map(track).collect()
}

/// The path holds the whole pan as an angle, and each new belief in the focal length or the lens makes another angle of it. Measured: .14 px; .59 px
/// where the path's beginning is what stays where it is.
#[test]
fn a_long_pan_does_not_shake_while_focal_length_and_lens_are_found() {
    let camera = Pinhole::new(SIZE, HFOV_DEG).with_lens(-0.05, SIZE[0]);
    let optics = Optics { readout_s: Prior::Fixed(0.0), hfov_deg: Prior::Unknown, lens_k1: Prior::Unknown };
    let mut model = Continuous::new(optics, 1, Level::detected());
    model.begin(SIZE);
    let mut random = numbers();
    let mut path = Vec::new();
    for k in 0..180 {
        // not quite steady, as a hand is: a pan that is says nothing of the lens
        let speed = |t: f64| [0.4 + 0.05 * (5.0 * t).sin(), 0.02 * (7.0 * t).sin(), 0.0];
        let [yaw, pitch, roll] = speed(f64::from(k) * INTERVAL_S).map(|speed| speed * INTERVAL_S);
        let mut tracks = turned(&camera, Pose([yaw, pitch, roll, 0.0]), &mut random);
        let fit = Fit::default();
        model.observe(Pair { tracks: &mut tracks, fit: &fit, interval_s: INTERVAL_S, off_s: 0.0, is_certain: true });
        path.push(model.newest().path[0]);
    }
    let jerks = path[60..].windows(4).map(|p| camera.focal * (p[3] - 3.0 * p[2] + 3.0 * p[1] - p[0]).abs());
    let worst = jerks.fold(0.0, f64::max);
    println!("worst third difference {worst:.3} px");
    assert!(worst < 0.3, "the path jerks by {worst} px");
}

/// A global shutter where a rolling one is expected: the search restarts, and the picture does not jump. The belief moves by more than a quarter of the
/// interval at a time.
#[test]
fn a_new_belief_in_the_readout_time_does_not_move_the_picture_at_once() {
    let camera = Pinhole::new(SIZE, HFOV_DEG);
    let mut model = Continuous::new(optics(Prior::Unknown, Prior::Fixed(HFOV_DEG)), 1, Level::detected());
    model.begin(SIZE);
    let mut random = numbers();
    let mut believed = Vec::new();
    let mut drawn = Vec::new();
    let mut parts = Vec::new();
    for k in 0..90 {
        let [from, to] = [0, 1].map(|i| shaken(f64::from(k + i) * INTERVAL_S));
        let [yaw, pitch, _] = std::array::from_fn(|i| to[i] - from[i]);
        let mut tracks = turned(&camera, Pose([yaw, pitch, 0.0, 0.0]), &mut random);
        let fit = Fit::default();
        model.observe(Pair { tracks: &mut tracks, fit: &fit, interval_s: INTERVAL_S, off_s: 0.0, is_certain: true });
        believed.push(model.calibration().unwrap().readout_s.value / INTERVAL_S);
        drawn.push(model.calibrator.drawn_s / INTERVAL_S);
        parts.push(model.newest().agreement);
    }
    let step = |values: &[f64]| values.windows(2).map(|pair| (pair[1] - pair[0]).abs()).fold(0.0, f64::max);
    println!("believed by {:.3}, drawn by {:.3}, parts by {:.3} at a time", step(&believed), step(&drawn), step(&parts));
    assert!(step(&believed) > 0.25, "the search did not restart: {believed:?}");
    assert!(step(&drawn) < 0.05 && step(&parts) < 0.1, "{drawn:?} {parts:?}");
    assert!(believed[89].abs() < 0.1 && drawn[89].abs() < 0.1, "{believed:?} {drawn:?}");
}

fn flying(t: f64) -> [f64; 3] {
    [0.3 * (0.5 * t).sin(), 0.0, 3.0 * t]
}

/// A flight over the ground at 60 frames/s, for four seconds: the far scene keeps its scale, and so does the path. Measured: .0013.
#[test]
fn the_path_zooms_only_where_the_picture_does() {
    let interval_s = 1.0 / 60.0;
    for (pose, readout, is_known) in [(still as fn(f64) -> [f64; 3], 0.0, true), (shaken, 0.0, false), (shaken, 0.75, false)] {
        let truth = Truth { pose, place: flying, readout_s: readout * interval_s, walled: false, k1: 0.0, interval_s };
        let known = if is_known { Prior::Fixed(truth.readout_s) } else { Prior::Unknown };
        let (model, ..) = truth.followed(known, 240);
        let zoom = model.newest().path[3];
        println!("readout {readout}, {known}: zoom {zoom:.4}");
        assert!(zoom.abs() < 0.003, "readout {readout}, {known}: {zoom}");
    }
}

/// A point of a scene that does not move by itself, and how surely it was background so far.
struct Point {
    place: [f64; 2],
    background: f32,
}

/// Furthest that the path goes (pixels, degrees of roll) in eight seconds before a dark wall of `count` points, of which each is lost after some twenty
/// frames and has an error of up to .3 px; and whether a hand with forty points waves before it from the third second to the sixth.
fn dark_wall(count: usize, with_hand: bool) -> [f64; 2] {
    let camera = Pinhole::new(SIZE, HFOV_DEG);
    let mut model = Continuous::new(optics(Prior::Unknown, Prior::Unknown), 1, Level::detected());
    model.begin(SIZE);
    let mut random = numbers();
    let [mut wall, mut hand]: [Vec<Point>; 2] = Default::default();
    let mut furthest = [0.0f64; 2];
    let hand_at = |t: f64| [320.0 + 150.0 * (3.0 * t).sin(), 400.0 - 200.0 * (t - 2.0).min(1.0) + 20.0 * (7.0 * t).cos()];
    for k in 0..240 {
        let time = f64::from(k) * INTERVAL_S;
        let is_there = with_hand && (2.0..6.0).contains(&time);
        let [at, then] = [time, time + INTERVAL_S].map(hand_at);
        wall.retain(|_| random() < 0.9);
        wall.resize_with(count, || Point { place: SIZE.map(|n| 0.5 * (random() + 1.0) * n as f64), background: 0.5 });
        hand.resize_with(40, || Point { place: [110.0 * random(), 120.0 * random()], background: 0.5 });
        let hides = |p: &Point| is_there && (p.place[0] - at[0]).abs() < 110.0 && (p.place[1] - at[1]).abs() < 120.0;
        let still = wall.iter_mut().filter(|p| !hides(p)).map(|p| (p, [0.0; 2], [0.0; 2]));
        let moved = hand.iter_mut().filter(|p| is_there && p.place[1] + at[1] < SIZE[1] as f64).map(|p| (p, at, then));
        let mut seen: Vec<_> = still.chain(moved).collect();
        let mut tracks: Vec<Track> = Vec::new();
        for (point, at, then) in &seen {
            let from = [0, 1].map(|i| point.place[i] + at[i]);
            let to = [0, 1].map(|i| point.place[i] + then[i] + 0.3 * random());
            tracks.push(Track { from, to, sigma_px: 0.3, background: point.background, ..Track::default() });
        }
        let fit = Fit::default();
        model.observe(Pair { tracks: &mut tracks, fit: &fit, interval_s: INTERVAL_S, off_s: 0.0, is_certain: true });
        for ((point, ..), track) in seen.iter_mut().zip(&tracks) {
            point.background += 0.1 * (track.weight - point.background);
        }
        let [yaw, pitch, roll, _] = model.newest().path.0.map(f64::abs);
        furthest = [furthest[0].max(camera.focal * yaw.max(pitch)), furthest[1].max(roll.to_degrees())];
    }
    furthest
}

/// The wall's points come and go, and their errors add up to a little; a hand adds nothing to it. Measured: 1.4 px and .14 degrees with 25
/// points (.9 and .18 without it), .6 px and .08 degrees with 60.
#[test]
fn a_hand_before_a_dark_wall_does_not_move_the_path() {
    for count in [25, 40, 60] {
        let [[px, degrees], alone] = [true, false].map(|with_hand| dark_wall(count, with_hand));
        println!("{count} points: {px:.2} px, {degrees:.3} degrees; without the hand {alone:.2?}");
        assert!(px < 2.0 && degrees < 0.25, "{count} points: {px} px, {degrees} degrees");
    }
}
