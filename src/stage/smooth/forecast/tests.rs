//! What a forecast must keep.

use super::*;
use crate::random::Congruential;

/// Numbers from -1 to 1, the same for the same seed.
fn random(seed: u64) -> impl FnMut() -> f64 {
    let mut generator = Congruential::new(seed);
    move || generator.signed()
}

#[test]
fn a_sine_is_foreseen_and_the_errors_say_so() {
    let tuning = Tuning::default();
    let path = |k: f64| (0.4 * k).sin() + 0.3 * (0.9 * k + 1.0).sin();
    // rows that are read at once, and for as long as there is from frame to frame
    for half in [0.0, 0.3, 0.5] {
        let mut forecast = Forecast::new();
        forecast.begin(path(0.0));
        for k in (1..400).map(f64::from) {
            let (half_s, interval_s) = (half / 30.0, 1.0 / 30.0);
            let ends =
                RowSpan { first: path(k - half), last: path(k + half), last_before: path(k - 1.0 + half), half_s, interval_s };
            forecast.observe(&tuning, path(k), 1.0 / 30.0, ends, 1.0);
        }
        for j in -6..=6 {
            let (expected, deviation) = forecast.at(f64::from(j) / 30.0);
            let place = path(399.0 + f64::from(j));
            assert!((expected - place).abs() < if j > 0 { 0.1 } else { 1e-6 }, "{half}, {j}: {expected}, {place}");
            assert!(deviation < 0.05 && (deviation > 0.0) == (j > 0), "{half}, {j}: {deviation}");
        }
    }
}

#[test]
fn what_the_last_rows_saw_brings_the_forecast_nearer() {
    let mut random = random(3);
    // a speed that wanders, at twelve times the frames' rate
    let (mut place, mut speed) = (0.0, 0.0);
    let path: Vec<f64> = (0..12 * 600)
        .map(|_| {
            speed += 0.02 * random() - 0.01 * speed;
            place += speed;
            place
        })
        .collect();
    let error = |half: usize| {
        let tuning = Tuning::default();
        let mut forecast = Forecast::new();
        forecast.begin(path[0]);
        let mut squares = 0.0;
        for k in 1..598 {
            let at = |place: usize| path[place];
            let (half_s, interval_s) = (half as f64 / 360.0, 1.0 / 30.0);
            let ends = RowSpan {
                first: at(12 * k - half),
                last: at(12 * k + half),
                last_before: at(12 * k - 12 + half),
                half_s,
                interval_s,
            };
            forecast.observe(&tuning, path[12 * k], 1.0 / 30.0, ends, 1.0);
            squares += (forecast.at(1.0 / 30.0).0 - path[12 * (k + 1)]).powi(2);
        }
        squares
    };
    let (middle, last) = (error(0), error(5));
    assert!(last < 0.5 * middle, "squared error {middle} from middle rows, {last} from last rows");
}

#[test]
fn what_the_next_frame_says_of_the_last_row_takes_its_place() {
    let (tuning, half_s, interval_s) = (Tuning::default(), 0.01, 1.0 / 30.0);
    let mut forecast = Forecast::new();
    forecast.begin(0.0);
    for k in (1..9).map(f64::from) {
        let ends = RowSpan { first: k - 0.3, last: k + 0.2, last_before: k - 0.7, half_s, interval_s };
        forecast.observe(&tuning, k, interval_s, ends, 1.0);
        // what is newest is as its frame says
        assert!((forecast.at(half_s).0 - (k + 0.2)).abs() < 1e-12);
        if k > 1.0 {
            let revised = forecast.at(half_s - interval_s).0;
            assert!((revised - (k - 0.7)).abs() < 1e-9, "frame {k}: {revised}");
        }
    }
    // a frame that says nothing of the one before leaves it, and so does one that looks farther back
    for interval_s in [0.0, 2.0 / 30.0] {
        let before = forecast.at(half_s).0;
        let ends = RowSpan { first: 9.0, last: 9.0, last_before: 77.0, half_s, interval_s };
        forecast.observe(&tuning, 9.0, 1.0 / 30.0, ends, 1.0);
        assert!((forecast.at(half_s - 1.0 / 30.0).0 - before).abs() < 1e-9);
    }
}

#[test]
fn the_range_is_that_of_the_last_seconds() {
    let tuning = Tuning::default();
    let mut forecast = Forecast::new();
    forecast.begin(50.0);
    for k in 1..=90 {
        let place = f64::from(k % 3);
        forecast.observe(&tuning, place, 1.0 / 30.0, RowSpan { first: place, last: place, ..RowSpan::default() }, 1.0);
    }
    assert_eq!((forecast.range(2.0), forecast.range(10.0)), (2.0, 50.0));
}

#[test]
fn whatever_comes_the_forecast_stays_finite_and_stable() {
    let mut random = random(7);
    let tuning = Tuning::default();
    let mut forecast = Forecast::new();
    forecast.begin(0.0);
    let mut place = 0.0;
    for k in 0..600 {
        place += if k % 97 == 0 { 50.0 } else { random() };
        forecast.observe(&tuning, place, [1.0, 0.5, 3.0, 1e-3][k % 4] / 30.0, RowSpan::default(), 1.0);
        for ahead in 0..30 {
            let (expected, deviation) = forecast.at(f64::from(ahead) / 30.0);
            assert!((expected - place).abs() < 2000.0 && deviation < 2000.0, "{k}: {expected} from {place}, {deviation}");
        }
    }
}

#[test]
fn a_still_camera_stays() {
    let tuning = Tuning::default();
    let mut forecast = Forecast::new();
    forecast.begin(3.0);
    for _ in 0..100 {
        forecast.observe(&tuning, 3.0, 1.0 / 30.0, RowSpan { first: 3.0, last: 3.0, ..RowSpan::default() }, 1.0);
        assert!((0..30).all(|ahead| forecast.at(f64::from(ahead) / 30.0).0 == 3.0));
    }
}
