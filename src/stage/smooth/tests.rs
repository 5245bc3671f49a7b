//! What the virtual camera's path must keep.

use std::f64::consts::{FRAC_1_SQRT_2, TAU};

use super::*;
use crate::random::Congruential;

fn run(rate: f64, seconds: f64, cutoff_hz: f64, path: impl Fn(f64) -> f64) -> f64 {
    let mut smoother = Smoother::new(&Params { mode: Mode::Iir, cutoff_hz, ..Params::default() });
    let mut out = 0.0;
    for k in 0..=(rate * seconds) as usize {
        out = step(&mut smoother, Pose([path(k as f64 / rate); 4]), 1.0 / rate, &wide())[0];
    }
    out
}

/// A frame that is placed as soon as it is seen.
fn step(smoother: &mut Smoother, camera: Pose, interval_s: f64, bounds: &Bounds) -> Pose {
    smoother.observe(camera, interval_s, RowSpan::default());
    smoother.step(camera, interval_s, 0.0, bounds)
}

/// A window so wide that nothing touches it.
fn wide() -> Bounds {
    let mut bounds = Bounds::default();
    for c in 0..4 {
        for sign in [-1.0, 1.0] {
            let mut normal = [0.0; 4];
            normal[c] = sign;
            bounds.add(normal, 1e9, 1e9);
        }
    }
    bounds
}

#[test]
fn a_still_path_stays_exactly_where_it_is() {
    assert_eq!(run(30.0, 5.0, 0.6, |_| 3.25), 3.25);
}

#[test]
fn a_step_settles_with_the_overshoot_of_butterworth() {
    let step = |t: f64| if t > 0.5 { 1.0 } else { 0.0 };
    let most = (0..200).map(|i| run(100.0, i as f64 * 0.02, 1.0, step)).fold(0.0, f64::max);
    assert!((most - 1.0432).abs() < 2e-3, "overshoot to {most}, exp(-pi) = 0.0432 above 1 expected");
    assert!((run(100.0, 8.0, 1.0, step) - 1.0).abs() < 1e-6);
}

#[test]
fn the_rate_of_frames_changes_nothing_for_a_path_of_straight_lines() {
    let path = |t: f64| if t < 1.0 { t } else { 2.0 - t };
    let (slow, fast) = (run(15.0, 3.0, 0.6, path), run(60.0, 3.0, 0.6, path));
    assert!((slow - fast).abs() < 1e-9, "{slow} {fast}");
}

#[test]
fn a_sine_at_the_cutoff_loses_three_decibels() {
    let mut smoother = Smoother::new(&Params { mode: Mode::Iir, cutoff_hz: 0.6, ..Params::default() });
    let mut most = 0.0f64;
    for k in 0..3000 {
        let t = k as f64 / 200.0;
        let out = step(&mut smoother, Pose([(TAU * 0.6 * t).sin(); 4]), 0.005, &wide())[0];
        if t > 10.0 {
            most = most.max(out);
        }
    }
    assert!((most - FRAC_1_SQRT_2).abs() < 2e-3, "{most}");
}

/// A window as a 640 x 480 picture at a zoom of 1.1 has it, in pixels: roll takes from yaw and pitch.
fn window() -> Bounds {
    let mut bounds = Bounds::default();
    for (x, y) in [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)] {
        for sign in [-1.0, 1.0] {
            bounds.add([sign, 0.1 * sign * x * y, 0.6 * sign * y, 20.0 * sign * x], 29.0, 29.0);
            bounds.add([0.1 * sign * x * y, sign, 0.8 * sign * x, 20.0 * sign * y], 22.0, 22.0);
        }
    }
    bounds
}

/// The virtual camera's path for the camera's, both pixels.
fn follow(params: Params, rate: f64, seconds: f64, path: impl Fn(f64) -> [f64; 4]) -> Vec<(Pose, Pose)> {
    let mut smoother = Smoother::new(&params);
    let bounds = window();
    (0..(rate * seconds) as usize)
        .map(|k| {
            let camera = Pose(path(k as f64 / rate));
            (camera, step(&mut smoother, camera, if k > 0 { 1.0 / rate } else { 0.0 }, &bounds))
        })
        .collect()
}

/// The same where frames may be so many late.
fn follow_late(late: usize, rate: f64, seconds: f64, path: impl Fn(f64) -> [f64; 4]) -> Vec<(Pose, Pose)> {
    let (mut smoother, bounds) = (Smoother::new(&Params::default()), window());
    let interval = |k: usize| if k > 0 { 1.0 / rate } else { 0.0 };
    let (count, mut seen) = ((rate * seconds) as usize, 0);
    (0..count)
        .map(|k| {
            while seen < count && seen <= k + late {
                smoother.observe(Pose(path(seen as f64 / rate)), interval(seen), RowSpan::default());
                seen += 1;
            }
            let camera = Pose(path(k as f64 / rate));
            (camera, smoother.step(camera, interval(k), (seen - 1 - k) as f64 / rate, &bounds))
        })
        .collect()
}

/// Sums of sines from 0.2 to 8 Hz, of about `rms` pixels, and a slow drift.
fn shake(seed: u64, rms: f64) -> impl Fn(f64) -> [f64; 4] {
    let mut generator = Congruential::scattered(seed);
    let mut random = move || generator.unit();
    let waves: [[[f64; 3]; 8]; 4] = std::array::from_fn(|c| {
        std::array::from_fn(|_| {
            let hz = 0.2 * 40f64.powf(random());
            [hz, rms * [0.5, 0.5, 0.1, 0.0005][c] / hz.max(0.5).sqrt(), TAU * random()]
        })
    });
    let drift = 60.0 * (random() - 0.5) * rms / 10.0;
    move |t| {
        std::array::from_fn(|c| {
            let sum: f64 = waves[c].iter().map(|[hz, size, phase]| size * ((TAU * hz * t + phase).sin() - phase.sin())).sum();
            sum + if c < 2 { drift * t } else { 0.0 }
        })
    }
}

const MODES: [Mode; 2] = [Mode::Adaptive, Mode::Iir];

#[test]
fn nothing_ever_leaves_the_window() {
    for seed in 0..60 {
        for rate in [15.0, 25.0, 30.0, 60.0] {
            for mode in MODES {
                for strength in [1.0, 0.5, TRIPOD] {
                    let params = Params { mode, strength, ..Params::default() };
                    let rms = [3.0, 10.0, 40.0, 150.0][seed as usize % 4];
                    for (camera, place) in follow(params, rate, 5.0, shake(seed, rms)) {
                        let crop_use = window().crop_use(&(place - camera));
                        assert!(crop_use <= 1.0, "seed {seed}, {rate} fps, {mode:?}: {crop_use}");
                    }
                }
            }
        }
    }
}

#[test]
fn look_ahead_leaves_the_window_never_and_is_steadier_the_farther_it_looks() {
    let mut sums = [0.0; 3];
    for seed in 0..24 {
        let rate = [15.0, 30.0, 60.0][seed as usize % 3];
        for (late_s, sum) in [0.0, 0.1, 0.4].into_iter().zip(&mut sums) {
            let path = follow_late((late_s * rate) as usize, rate, 8.0, shake(seed, [3.0, 8.0, 15.0, 40.0][seed as usize % 4]));
            for (camera, place) in &path {
                let crop_use = window().crop_use(&(*place - *camera));
                assert!(crop_use <= 1.0, "seed {seed}, {late_s} s: {crop_use}");
            }
            let rms = |which: fn(&(Pose, Pose)) -> Pose| {
                let second = |w: &[(Pose, Pose)]| {
                    let [a, b, c] = [0, 1, 2].map(|i| which(&w[i]));
                    (0..2).map(|i| (a[i] - 2.0 * b[i] + c[i]).powi(2)).sum::<f64>()
                };
                path.windows(3).map(second).sum::<f64>().sqrt()
            };
            *sum += rms(|p| p.1) / rms(|p| p.0) / 24.0;
        }
    }
    println!("acceleration's ratio with no look-ahead, 0.1 s, 0.4 s: {sums:.3?}");
    assert!(sums[1] < 0.9 * sums[0] && sums[2] < 0.9 * sums[1], "{sums:?}");
}

#[test]
fn what_only_shakes_is_held_still() {
    let params = Params::default();
    for rate in [15.0, 30.0, 60.0] {
        let path = |t: f64| [9.0 * (TAU * 3.0 * t).sin(), 7.0 * (TAU * 2.3 * t).sin(), 2.0 * (TAU * 1.7 * t).sin(), 0.0];
        // of a shake of 9 pixels; within the first second it finds where the window leaves it most room, then nothing moves
        let held = follow(params, rate, 6.0, path);
        let found = held[rate as usize].1;
        let off = |place: &Pose, from: &Pose| (0..4).map(|c| (place[c] - from[c]).abs()).fold(0.0, f64::max);
        let (first, after) = held.split_at(rate as usize);
        let [first, after] = [(first, Pose::default()), (after, found)]
            .map(|(part, from)| part.iter().map(|(_, place)| off(place, &from)).fold(0.0, f64::max));
        assert!(first < 2.0 && after < 0.1, "{rate} fps: {first} px in the first second, {after} px after");
    }
    for (camera, place) in follow(params, 30.0, 3.0, |_| [3.0, -2.0, 0.5, 0.1]) {
        assert_eq!(camera, place);
    }
}

#[test]
fn a_sway_that_fits_in_the_window_is_held_and_one_that_does_not_is_followed() {
    for rate in [15.0, 30.0, 60.0] {
        // of a window of 58 pixels; part of the sway that is left after it was seen once
        let left = [30.0, 240.0].map(|size| {
            let sway = |t: f64| [0.5 * size * (TAU * 0.35 * t).sin(), 0.0, 0.0, 0.0];
            let path = follow(Params::default(), rate, 12.0, sway);
            let places = path[(4.0 * rate) as usize..].iter().map(|(_, place)| place[0]);
            (places.clone().fold(f64::MIN, f64::max) - places.fold(f64::MAX, f64::min)) / size
        });
        println!("{rate} fps: {left:.3?} of the sway is left");
        assert!(left[0] < 0.1 && left[1] > 0.6, "{rate} fps: {left:?}");
    }
}

#[test]
fn a_step_and_a_pan_are_followed_without_overshoot_or_pull_back() {
    for rate in [15.0, 25.0, 30.0, 60.0] {
        let step = follow(Params::default(), rate, 6.0, |t| [if t > 1.0 { 60.0 } else { 0.0 }, 0.0, 0.0, 0.0]);
        let most = step.iter().map(|(_, place)| place[0]).fold(0.0, f64::max);
        assert!(most <= 60.0 * 1.02, "{rate} fps: a step of 60 to {most}");
        let pan = |t: f64| {
            let u = ((t - 1.0) / 1.6).clamp(0.0, 1.0);
            [213.0 * u * u * (3.0 - 2.0 * u), 0.0, 0.0, 0.0]
        };
        let path = follow(Params::default(), rate, 6.0, pan);
        let most = path.iter().map(|(_, place)| place[0]).fold(0.0, f64::max);
        assert!(most <= 213.0 * 1.02, "{rate} fps: a pan of 213 to {most}");
        assert!(path.windows(2).all(|pair| pair[1].1[0] >= pair[0].1[0] - 0.3), "{rate} fps: pulled back");
        let at = |t: f64| path[(t * rate) as usize].1[0];
        assert!(
            (at(5.5) - at(3.1)).abs() < 0.05 * 213.0,
            "{rate} fps: from {} half a second after the end to {}",
            at(3.1),
            at(5.5)
        );
    }
}

#[test]
fn the_rate_of_frames_changes_little() {
    for seed in 0..20 {
        let path = |rate| follow(Params::default(), rate, 6.0, shake(seed, [4.0, 8.0][seed as usize % 2]));
        let (slow, fast) = (path(30.0), path(60.0));
        let off = slow.iter().zip(fast.iter().step_by(2)).map(|((_, a), (_, b))| (a[0] - b[0]).hypot(a[1] - b[1]));
        let off: Vec<f64> = off.collect();
        let rms = (off.iter().map(|o| o * o).sum::<f64>() / off.len() as f64).sqrt();
        println!("seed {seed}: rms {rms}, most {}", off.iter().copied().fold(0.0, f64::max));
        // of a window of 29 x 22: who is a little nearer to an edge is pushed a little sooner, and stays there
        assert!(rms < 4.0, "seed {seed}: {rms}");
    }
}

#[test]
fn the_output_never_shakes_harder_than_the_input() {
    for seed in 0..40 {
        for mode in MODES {
            let path = follow(
                Params { mode, ..Params::default() },
                30.0,
                8.0,
                shake(seed, [4.0, 10.0, 30.0, 80.0][seed as usize % 4]),
            );
            let second = |k: usize, which: fn(&(Pose, Pose)) -> Pose| {
                let [a, b, c] = [k - 1, k, k + 1].map(|k| which(&path[k]));
                (0..2).map(|i| (a[i] - 2.0 * b[i] + c[i]).powi(2)).sum::<f64>()
            };
            let rms = |which| ((1..path.len() - 1).map(|k| second(k, which)).sum::<f64>() / path.len() as f64).sqrt();
            let (input, output) = (rms(|p| p.0), rms(|p| p.1));
            println!("seed {seed} {mode:?}: {}", output / input);
            assert!(output < input, "seed {seed}, {mode:?}: {output} of {input} px / frame^2");
        }
    }
}

#[test]
fn a_tripod_holds_one_place_for_as_long_as_the_window_lasts() {
    for rate in [15.0, 30.0, 60.0] {
        // away at an even speed, to the edge of a window of 29 pixels after three seconds; a steady camera follows, a tripod stands
        let away = |t: f64| [29.0 / 3.0 * t + 2.0 * ((TAU * 1.3 * t).cos() - 1.0), 0.0, 0.0, 0.0];
        let until = |strength: f64| {
            let path = follow(Params { strength, ..Params::default() }, rate, 8.0, away);
            let first = path.iter().position(|(_, place)| place[0].abs() > 0.5);
            first.map_or(0.0, |k| path[k].0[0]) / 29.0
        };
        let held = [until(1.0), until(TRIPOD)];
        println!("{rate} fps: held up to {held:.2?} of the window");
        assert!(held[0] < held[1] - 0.1 && (0.9..1.05).contains(&held[1]), "{rate} fps: {held:?}");
        // and what comes back is held altogether, in every channel
        let sway = |t: f64| [0.0, 16.0 * (TAU * 0.2 * t).sin(), 0.0, 0.0];
        let path = follow(Params { strength: TRIPOD, ..Params::default() }, rate, 12.0, sway);
        let most = path.iter().map(|(_, place)| place[1].abs()).fold(0.0, f64::max);
        assert!(most < 0.5, "{rate} fps: {most} px of a sway of 16");
    }
}

#[test]
fn the_stronger_the_steadier() {
    for seed in 0..12 {
        let rms = [0.0, 0.3, 0.6, 1.0].map(|strength| {
            let path = follow(Params { strength, ..Params::default() }, 30.0, 8.0, shake(seed, 12.0));
            let way = |w: &[(Pose, Pose)]| (0..2).map(|c| (w[1].1[c] - w[0].1[c]).powi(2)).sum::<f64>();
            path.windows(2).map(way).sum::<f64>().sqrt()
        });
        assert!(rms.windows(2).all(|pair| pair[1] < pair[0]), "seed {seed}: {rms:.2?} px");
    }
}

#[test]
fn strength_and_mode_glide() {
    let mut smoother = Smoother::new(&Params::default());
    let (bounds, path) = (window(), shake(5, 6.0));
    let changes = [
        Params { strength: 0.0, ..Params::default() },
        Params::default(),
        Params { mode: Mode::Iir, ..Params::default() },
        Params { strength: TRIPOD, ..Params::default() },
    ];
    let mut last: Option<(Pose, Pose)> = None;
    for k in 0..450 {
        if k % 90 == 89 {
            smoother.set_params(&changes[k / 90 % 4]);
        }
        let camera = Pose(path(k as f64 / 30.0));
        let place = step(&mut smoother, camera, 1.0 / 30.0, &bounds);
        if let Some((camera_before, before)) = last {
            // a correction is given up within a second: no faster than a few pixels a frame
            let (moved, by) = ((place[0] - before[0]).abs(), (camera[0] - camera_before[0]).abs());
            assert!(moved < by + 3.0, "frame {k}: {moved} px, the camera {by} px");
        }
        last = Some((camera, place));
    }
}

/// What the channels' own plans make of a path; no window ever counts as full.
fn follow_alone(path: impl Fn(f64) -> [f64; 4]) -> Vec<(Pose, Pose)> {
    let never = Tuning { full_from: 2.0, full_to: 3.0, ..Tuning::default() };
    let (mut smoother, bounds) = (Smoother::tuned(&Params::default(), &never), window());
    let place = |k: usize| {
        let camera = Pose(path(k as f64 / 30.0));
        (camera, step(&mut smoother, camera, if k > 0 { 1.0 / 30.0 } else { 0.0 }, &bounds))
    };
    (0..360).map(place).collect()
}

#[test]
fn the_channels_are_planned_together_only_where_the_window_is_full() {
    let mut differ = 0;
    for seed in 0..30 {
        let rms = [1.0, 4.0, 25.0][seed as usize % 3];
        let (path, alone) = (follow(Params::default(), 30.0, 12.0, shake(seed, rms)), follow_alone(shake(seed, rms)));
        let crop_use = |(camera, place): &(Pose, Pose)| window().crop_use(&(*place - *camera));
        let full = alone.iter().position(|frame| crop_use(frame) > Tuning::default().full_use);
        let first = path.iter().zip(&alone).position(|(a, b)| a.1 != b.1);
        assert!(
            first.is_none_or(|first| full.is_some_and(|full| full < first)),
            "seed {seed}: full {full:?}, differs {first:?}"
        );
        differ += usize::from(first.is_some());
    }
    assert!((10..28).contains(&differ), "{differ} of 30 paths differ");
}

#[test]
fn a_full_window_is_shared_by_what_it_buys() {
    let (mut sums, seeds) = ([[0.0; 2]; 2], 16);
    for seed in 0..seeds {
        // a camera that was taken up turned to one side, and shakes more than the window holds
        let shaken = shake(seed, 22.0);
        let path = |t: f64| {
            let [yaw, pitch, roll, zoom] = shaken(t);
            [yaw, pitch, roll + 16.0 * (t / 0.6).min(1.0), zoom]
        };
        for (sum, path) in sums.iter_mut().zip([follow_alone(path), follow(Params::default(), 30.0, 12.0, path)]) {
            let second = |w: &[(Pose, Pose)], c: usize| (w[0].1[c] - 2.0 * w[1].1[c] + w[2].1[c]).powi(2);
            sum[0] += path.windows(3).map(|w| second(w, YAW) + second(w, PITCH)).sum::<f64>().sqrt();
            sum[1] += path[90..].iter().map(|(camera, place)| (place[ROLL] - camera[ROLL]).abs()).sum::<f64>();
        }
    }
    let [acceleration, roll] = [0, 1].map(|i| sums[1][i] / sums[0][i]);
    println!("channels together over channels alone: acceleration {acceleration:.3}, correction of roll {roll:.3}");
    assert!(acceleration < 0.93 && roll < 0.7, "acceleration {acceleration}, correction of roll {roll}");
}
