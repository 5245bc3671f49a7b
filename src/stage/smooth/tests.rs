//! What the virtual camera's path must keep.

use std::f64::consts::{FRAC_1_SQRT_2, TAU};

use super::*;

fn run(rate: f64, seconds: f64, cutoff_hz: f64, path: impl Fn(f64) -> f64) -> f64 {
    let mut smoother = Smoother::new(&Params { mode: Mode::Iir, cutoff_hz, ..Params::default() });
    let mut out = 0.0;
    for k in 0..=(rate * seconds) as usize {
        out = smoother.step([path(k as f64 / rate); 4], 1.0 / rate, &wide())[0];
    }
    out
}

/// A window so wide that nothing touches it.
fn wide() -> Room {
    let mut room = Room::default();
    for c in 0..4 {
        for sign in [-1.0, 1.0] {
            let mut normal = [0.0; 4];
            normal[c] = sign;
            room.add(normal, 1e9, 1e9);
        }
    }
    room
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
        let out = smoother.step([(TAU * 0.6 * t).sin(); 4], 0.005, &wide())[0];
        if t > 10.0 {
            most = most.max(out);
        }
    }
    assert!((most - FRAC_1_SQRT_2).abs() < 2e-3, "{most}");
}
