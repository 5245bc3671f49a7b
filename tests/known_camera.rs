//! From pixels to the motion of the camera and of its rows, on a camera whose motion and readout are known.

mod common;

use common::{Memory, Script, Seen, filmed, quantile};
use gimbald::device::null::NullSink;
use gimbald::device::synthetic::{self, Motion, Synthetic};
use gimbald::geometry::{Pose, RowMotion};
use gimbald::pipeline::{Camera, Params, run_inline};
use gimbald::rt::stop::Stop;
use gimbald::stage::paper::Zoom;
use gimbald::stage::shutter::{self, Model, Parameters, Prior};

const SIZE: [u32; 2] = [320, 240];
/// Wide, as a webcam's; and narrow, so that a turn shifts the picture and does little else, as the paper's model has it.
const WIDE_DEG: f64 = 60.0;
const NARROW_DEG: f64 = 20.0;

/// A synthetic camera and what the pipeline makes of its frames.
struct Run {
    camera: Synthetic,
    seen: Vec<Vec<Seen>>,
}

/// Runs each of `models` on the same frames: 0.8 seconds at `fps`, `readout` of a frame interval at 30 a second. What is seen through
/// a narrow lens moves as fast as through a wide one.
fn run(motion: Motion, fps: f64, hfov_deg: f64, readout: f64, models: &[shutter::Params]) -> Run {
    let readout_ms = readout * 1000.0 / 30.0;
    let settings = synthetic::Params {
        width: SIZE[0],
        height: SIZE[1],
        fps,
        hfov_deg,
        gain: hfov_deg / WIDE_DEG,
        readout_ms,
        motion,
        frames: (0.8 * fps) as u64,
        noise: 1.0,
        ..synthetic::Params::default()
    };
    let mut camera = Synthetic::new(&settings).unwrap();
    let shots = filmed(&mut camera);
    let see = |shutter: &shutter::Params| {
        let camera =
            Camera { readout_ms: Prior::Fixed(readout_ms), hfov_deg: Prior::Fixed(hfov_deg), lens_k1: Prior::Fixed(0.0) };
        let params = Params { camera, shutter: *shutter, ..Params::default() };
        let (mut source, mut memory) = (Script::new(shots.clone()), Memory::default());
        let mut sink = NullSink::new(&source.format);
        run_inline(&mut source, &mut sink, &params, &Stop::default(), &mut memory).unwrap();
        assert_eq!(memory.seen.len(), shots.len());
        memory.seen
    };
    let seen = models.iter().map(see).collect();
    Run { camera, seen }
}

const PAPER: [shutter::Params; 2] = [
    shutter::Params { model: Model::Cho2007, parameters: Parameters::TimeT },
    shutter::Params { model: Model::Cho2007, parameters: Parameters::TimeT1 },
];
const CONTINUOUS: shutter::Params = shutter::Params { model: Model::Continuous, parameters: Parameters::TimeT };

impl Run {
    /// How far the scene in the picture's middle moves from frame `k` to the next: seen by rows of the same moment, pixels.
    fn moved(&self, k: usize) -> [f64; 2] {
        let middle = SIZE.map(|n| (f64::from(n) - 1.0) / 2.0);
        let ray = self.camera.ray(middle, self.camera.row_time_s(k as u64, 0.0));
        let [x, y] = self.camera.project(ray, self.camera.row_time_s(k as u64 + 1, 0.0)).unwrap();
        [x - middle[0], y - middle[1]]
    }
}

/// What a frame's decomposed motion says of the same: pixels in the time of a frame interval.
fn decomposed(seen: &Seen) -> [f64; 2] {
    let RowMotion::Uniform { motion, .. } = seen.rows else { panic!("not the paper's model") };
    let motion = Zoom::of(&motion);
    let middle = SIZE.map(|n| (f64::from(n) - 1.0) / 2.0);
    [(motion.a - 1.0) * middle[0] + motion.c, (motion.a - 1.0) * middle[1] + motion.d]
}

/// Readouts, in frame intervals at 30 frames a second.
const READOUTS: [f64; 5] = [0.3, 0.85, 1.0, -0.3, -0.85];

/// What each parameter set may be off by, as a part of the camera's fastest motion, and what makes it so. Time-t is the motion of an
/// interval that both frames show. Time-t+1 is that of the interval to come: its beginning is seen in the newest frame's rows, the rest
/// is as if the camera's acceleration stayed, and it does not. The fewer frames a second, the less it does;
/// a readout from bottom to top ends where the interval begins, and sees nothing of it.
fn allowed(parameters: Parameters, fps: f64, readout: f64) -> f64 {
    match parameters {
        Parameters::TimeT => 0.02,
        Parameters::TimeT1 => 0.02 + if readout > 0.0 { 20.0 } else { 40.0 } / (fps * fps),
    }
}

/// The paper's c and d, for both parameter sets, at 320x240 with a motion of up to 6.5 pixels a frame, a sine of 1.3 Hz. Measured
/// medians: Time-t 0.01 to 0.07 px; Time-t+1 0.03 to 0.16 px, with a negative readout up to 0.35 px.
#[test]
fn the_papers_c_and_d_are_recovered() {
    for (motion, readouts) in [(Motion::Horizontal, &READOUTS[..]), (Motion::Vertical, &READOUTS[1..4])] {
        for &readout in readouts {
            let run = run(motion, 30.0, NARROW_DEG, readout, &PAPER);
            for (seen, model) in run.seen.iter().zip(PAPER) {
                let (mut off, mut size) = (Vec::new(), Vec::new());
                for (k, seen) in seen.iter().enumerate().skip(2).take(seen.len() - 4) {
                    let (found, truth) = (decomposed(seen), run.moved(k));
                    off.push((found[0] - truth[0]).hypot(found[1] - truth[1]));
                    size.push(truth[0].hypot(truth[1]));
                }
                let (median, most) = (quantile(&mut off, 0.5), quantile(&mut off, 1.0));
                let fastest = quantile(&mut size, 1.0);
                let name = format!("{motion:?}, readout {readout}, {:?}", model.parameters);
                println!("{name}: off by {median:.3} px, at most {most:.3}, of up to {fastest:.2}");
                assert!(fastest > 3.0, "{name}: the camera hardly moves");
                let limit = allowed(model.parameters, 30.0, readout) * fastest;
                assert!(median < limit && most < 2.0 * limit, "{name}: off by {median} px, at most {most}; {limit} is allowed");
            }
        }
    }
}

/// Continuous time: yaw, pitch and roll from frame to frame, and of the rows within each, as pixels at the picture's middle (roll:
/// at its corners). Measured: 95 % of steps off by up to 0.027 px; rows by 0.002 to 0.004 px, 95 % of them by up to 0.016 px.
#[test]
fn the_continuous_path_and_rows_are_recovered() {
    let cases = [
        (Motion::Horizontal, &READOUTS[..]),
        (Motion::Vertical, &READOUTS[1..2]),
        (Motion::Handheld, &READOUTS[1..4]),
        (Motion::Walk, &READOUTS[4..]),
    ];
    for (motion, readouts) in cases {
        for &readout in readouts {
            let run = run(motion, 30.0, WIDE_DEG, readout, &[CONTINUOUS]);
            check_path(&format!("{motion:?}, readout {readout}"), &run, &run.seen[0]);
        }
    }
}

fn check_path(name: &str, run: &Run, seen: &[Seen]) {
    let focal = run.camera.focal_px();
    let scale = [focal, focal, f64::from(SIZE[0]).hypot(f64::from(SIZE[1])) / 2.0];
    let middle = f64::from(SIZE[1]) / 2.0;
    let pose = |k: usize, row: f64| run.camera.pose_at(run.camera.row_time_s(k as u64, row));
    let (mut steps, mut rows_off, mut rows_size) = ([const { Vec::new() }; 3], Vec::new(), Vec::new());
    for k in 4..seen.len() {
        let (before, now) = (pose(k - 1, middle), pose(k, middle));
        for (c, steps) in steps.iter_mut().enumerate() {
            let found = seen[k].path[c] - seen[k - 1].path[c];
            steps.push((found - (now[c] - before[c])).abs() * scale[c]);
        }
        let RowMotion::Poses { rows, .. } = seen[k].rows else { panic!("rows have no poses") };
        for (i, sample) in rows.samples.iter().enumerate() {
            let truth = pose(k, i as f64 * rows.spacing);
            let pixels = |turn: Pose| (0..3).map(|c| (turn[c] * scale[c]).powi(2)).sum::<f64>().sqrt();
            let within = truth - now;
            rows_off.push(pixels(*sample - within));
            rows_size.push(pixels(within));
        }
    }
    let [yaw, pitch, roll] = steps.each_mut().map(|steps| quantile(steps, 0.95));
    let (median, p95) = (quantile(&mut rows_off, 0.5), quantile(&mut rows_off, 0.95));
    let size = quantile(&mut rows_size, 1.0);
    println!(
        "{name}: 95 % of steps off by up to {yaw:.3} {pitch:.3} {roll:.3} px; rows by {median:.3}, 95 % up to {p95:.3}, of up to {size:.2}"
    );
    assert!(yaw < 0.05 && pitch < 0.05 && roll < 0.05, "{name}: 95 % of steps are off by {yaw} {pitch} {roll} px");
    assert!(size > 0.2 && median < 0.02 && p95 < 0.05, "{name}: rows are off by {median} px, 95 % by up to {p95}, of {size}");
}

/// The same motion at other rates: the speeds found are the camera's.
#[test]
fn the_frame_rate_changes_nothing() {
    for fps in [15.0, 24.0, 60.0] {
        let narrow = run(Motion::Horizontal, fps, NARROW_DEG, 0.45, &PAPER);
        for (seen, model) in narrow.seen.iter().zip(PAPER) {
            let speed = |k: usize| (decomposed(&seen[k])[0] * fps, narrow.moved(k)[0] * fps);
            let (mut off, mut size) = (Vec::new(), Vec::new());
            for (found, truth) in (2..seen.len() - 2).map(speed) {
                off.push((found - truth).abs());
                size.push(truth.abs());
            }
            let (median, fastest) = (quantile(&mut off, 0.5), quantile(&mut size, 1.0));
            println!("{fps}/s, {:?}: speed off by {median:.2} of up to {fastest:.0} px/s", model.parameters);
            let limit = allowed(model.parameters, fps, 0.45) * fastest;
            assert!(median < limit, "{fps}/s, {:?}: off by {median} of {fastest} px/s; {limit} is allowed", model.parameters);
        }
        let wide = run(Motion::Horizontal, fps, WIDE_DEG, 0.45, &[CONTINUOUS]);
        check_path(&format!("{fps}/s"), &wide, &wide.seen[0]);
    }
}
