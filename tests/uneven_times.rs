//! However unevenly frames are stamped, the picture is never moved by more than the camera moved.

mod common;

use common::stamps::{ALL, Stamped, stamp};
use common::{Memory, Script, Seen, Shot, filmed};
use gimbald::device::null::NullSink;
use gimbald::device::synthetic::{self, Synthetic};
use gimbald::pipeline::{Params, run_inline};
use gimbald::rt::stop::Stop;
use gimbald::stage::shutter::{self, Model, Parameters};

const FPS: f64 = 30.0;
/// Part of a pixel by which a step may be larger: that of the resampling, as the measured inputs allow.
const LEEWAY_PX: f64 = 0.5;

/// Ways of stamping that the paper's model is tried with.
const PAPERS: [Stamped; 5] =
    [Stamped::Jitter(8.0), Stamped::Bursts(5), Stamped::Stalls(166.0), Stamped::Dropped { counted: false }, Stamped::Halved];

/// A camera that films for four seconds, and what it gave.
fn filmed_handheld() -> (Synthetic, Vec<Shot>) {
    let settings =
        synthetic::Params { width: 320, height: 240, fps: FPS, frames: 120, gain: 1.5, ..synthetic::Params::default() };
    let mut camera = Synthetic::new(&settings).unwrap();
    let shots = filmed(&mut camera);
    (camera, shots)
}

fn stabilized(shots: Vec<Shot>, params: &Params) -> Vec<Seen> {
    let (mut source, mut memory) = (Script::new(shots), Memory::default());
    let mut sink = NullSink::new(&source.format);
    run_inline(&mut source, &mut sink, params, &Stop::default(), &mut memory).unwrap();
    memory.seen
}

/// The farthest that the scene in the picture's middle moved from frame to frame in the input and in the output (pixels of the input).
/// `came` are the camera's frames.
fn largest_steps(camera: &Synthetic, came: &[u64], seen: &[Seen]) -> [f64; 2] {
    let [width, height] = [camera.params().width, camera.params().height].map(f64::from);
    let middle = [0.5 * (width - 1.0), 0.5 * (height - 1.0)];
    // where `frame` shows what the frame before showed at `place`
    let moved = |before: u64, place: [f64; 2], frame: u64| {
        let ray = camera.ray(place, camera.row_time_s(before, place[1]));
        camera.locate(ray, frame).unwrap()
    };
    let distance = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
    let mut most = [0.0_f64; 2];
    for (frames, seen) in came.windows(2).zip(seen.windows(2)) {
        let shown = [&seen[0], &seen[1]].map(|seen| seen.corners()[4]);
        let steps =
            [distance(moved(frames[0], middle, frames[1]), middle), distance(moved(frames[0], shown[0], frames[1]), shown[1])];
        most = std::array::from_fn(|i| most[i].max(steps[i]));
    }
    most
}

#[test]
fn the_picture_never_moves_more_than_the_camera() {
    let (camera, shots) = filmed_handheld();
    let paper = |parameters| shutter::Params { model: Model::Cho2007, parameters };
    let models = [shutter::Params::default(), paper(Parameters::TimeT), paper(Parameters::TimeT1)];
    for stamped in ALL {
        // the paper's model asks the times for less: the kinds that are hardest are enough
        let models = if PAPERS.contains(&stamped) { &models[..] } else { &models[..1] };
        for (m, &shutter) in models.iter().enumerate() {
            let mut shots = shots.clone();
            let came = stamp(&mut shots, stamped, FPS, 3);
            let seen = stabilized(shots, &Params { shutter, ..Params::default() });
            assert_eq!(seen.len(), came.len());
            let [input, output] = largest_steps(&camera, &came, &seen);
            println!("{stamped:?}, model {m}: {input:.1} px in, {output:.1} px out");
            assert!(output <= input + LEEWAY_PX, "{stamped:?}, model {m}: {input:.1} px in, {output:.1} px out");
        }
    }
}

/// Bursts are the camera's own rhythm: after the first few frames they change nothing.
#[test]
fn the_intervals_are_the_cameras() {
    let (_, shots) = filmed_handheld();
    for stamped in [Stamped::Jitter(3.0), Stamped::Jitter(8.0), Stamped::Bursts(4), Stamped::Stalls(166.0), Stamped::Late(20.0)]
    {
        let mut shots = shots.clone();
        stamp(&mut shots, stamped, FPS, 5);
        let seen = stabilized(shots, &Params { enabled: false, ..Params::default() });
        let wrong = seen[10..].iter().filter(|seen| !(0.8..1.25).contains(&(FPS * seen.interval_s))).count();
        assert!(wrong <= 8, "{stamped:?}: {wrong} of {} intervals are wrong", seen.len() - 10);
        assert!(
            seen[10..].iter().all(|seen| FPS * seen.interval_s > 0.6),
            "{stamped:?}: motion would look much faster than it was"
        );
    }
}
