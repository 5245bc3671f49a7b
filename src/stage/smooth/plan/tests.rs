//! The planner's parts, each against what it is by definition.

use super::*;
use crate::random::Congruential;
use nalgebra::{DMatrix, DVector};

/// Numbers between -1 and 1, always the same.
fn numbers(seed: u64) -> impl FnMut() -> f64 {
    let mut generator = Congruential::new(seed);
    move || generator.signed()
}

#[test]
fn banded_equations_have_the_solution_that_a_dense_solver_finds() {
    let mut random = numbers(3);
    for _ in 0..20 {
        // L L' of a random banded factor is positive definite and has the same band
        let mut factor = DMatrix::<f64>::zeros(AHEAD, AHEAD);
        for i in 0..AHEAD {
            for j in i.saturating_sub(BAND - 1)..=i {
                factor[(i, j)] = if i == j { 1.5 + random() } else { random() };
            }
        }
        let dense = &factor * factor.transpose();
        let mut banded = [[0.0; BAND]; AHEAD];
        for i in 0..AHEAD {
            for d in 0..BAND.min(i + 1) {
                banded[i][d] = dense[(i, i - d)];
            }
        }
        let right: [f64; AHEAD] = std::array::from_fn(|_| random());
        let wanted = dense.cholesky().unwrap().solve(&DVector::from_row_slice(&right));
        let mut x = right;
        solve(&mut banded, &mut x);
        for i in 0..AHEAD {
            assert!((x[i] - wanted[i]).abs() < 1e-6 * wanted.amax().max(1.0), "{i}: {} for {}", x[i], wanted[i]);
        }
    }
}

/// The slope and the curvature of E[max(0, e + deviation z)^2] / 2, z standard normal, by summing over z.
#[test]
fn an_expected_excess_is_what_the_integral_gives() {
    for (e, deviation) in [(-0.3, 0.1), (-0.05, 0.1), (0.0, 0.2), (0.1, 0.05), (0.4, 0.3), (-1.0, 0.1), (1.0, 0.1)] {
        let (step, mut slope, mut curve) = (1e-3, 0.0, 0.0);
        for i in -8000..8000 {
            let z = (f64::from(i) + 0.5) * step;
            let weight = step * (-0.5 * z * z).exp() / std::f64::consts::TAU.sqrt();
            let excess = e + deviation * z;
            if excess > 0.0 {
                slope += weight * excess;
                curve += weight;
            }
        }
        let found = excess(e, deviation);
        assert!(
            (found.0 - slope).abs() < 1e-4 && (found.1 - curve).abs() < 1e-3,
            "{e} {deviation}: {found:?} for {slope} {curve}"
        );
    }
}

/// Far from the edges, and with no cost of speed, nothing is smoother than to go on.
#[test]
fn a_steady_motion_goes_on() {
    let tuning = Tuning::default();
    let motion = Motion { place: 0.1, speed: 0.02, acceleration: 0.0, ticks: 1.0 };
    let camera: [f64; AHEAD] = std::array::from_fn(|i| 0.1 + 0.02 * (i as f64 + 1.0));
    let (wide, tick_s) = ([-50.0, 50.0], 1.0 / 30.0);
    let ahead = Ahead { camera, deviation: [0.01; AHEAD], known: wide, later: wide, tick_s, ..Ahead::default() };
    for ticks in [0.5, 1.0, 2.0] {
        let x = next(&tuning, &motion, ticks, &ahead);
        assert!((x - (0.1 + 0.02 * ticks)).abs() < 1e-6, "{ticks}: {x}");
    }
    let braked = next(&tuning, &motion, 1.0, &Ahead { drag_hz: 3.0, ..ahead });
    assert!((0.1..0.119).contains(&braked), "speed that costs falls: {braked}");
}

#[test]
fn the_window_moves_the_plan_before_the_camera_is_at_its_edge() {
    let tuning = Tuning::default();
    let motion = Motion { ticks: 1.0, ..Motion::default() };
    let at = |speed: f64, deviation: f64| {
        let camera = std::array::from_fn(|i| speed * i as f64);
        let edge = [-1.0, 1.0];
        let ahead =
            Ahead { camera, deviation: [deviation; AHEAD], known: edge, later: edge, tick_s: 1.0 / 30.0, ..Ahead::default() };
        next(&tuning, &motion, 1.0, &ahead)
    };
    assert!(at(0.0, 0.02).abs() < 1e-9, "a still camera is left alone");
    let (slow, fast, doubtful) = (at(0.02, 0.02), at(0.3, 0.02), at(0.3, 0.3));
    assert!(slow.abs() < 1e-3 && fast > 0.005, "{slow} {fast}");
    assert!(doubtful > fast, "an uncertain forecast keeps more distance: {doubtful} {fast}");
    assert!((at(-0.3, 0.02) + fast).abs() < 1e-9, "both ways alike");
}
