//! Times of known cameras, stamped as real ones are, against the truth.

use super::*;
use crate::frame::FrameFlags;
use crate::random::Congruential;

/// 30 frames a second.
const PERIOD_NS: f64 = 1e9 / 30.0;

/// About normal, of standard deviation 1.
fn normal(random: &mut Congruential) -> f64 {
    (0..12).map(|_| random.unit()).sum::<f64>() - 6.0
}

/// A frame: its stamp, and its true time (nanoseconds).
type Given = (Stamp, f64);

fn stamp(time_ns: f64, sequence: u64) -> Stamp {
    Stamp { time_ns: 50_000_000_000 + time_ns.round() as i64, sequence, flags: FrameFlags::default() }
}

/// Frames of an even camera, stamped with a delay (nanoseconds) that is asked of each.
fn delayed(count: u64, mut delay_ns: impl FnMut(u64) -> f64) -> Vec<Given> {
    (0..count).map(|n| (n as f64 * PERIOD_NS, n)).map(|(true_ns, n)| (stamp(true_ns + delay_ns(n), n), true_ns)).collect()
}

/// Errors of the judged intervals (part of the true one) and whether they are called certain, from frame `from` on.
fn errors(given: &[Given], from: usize) -> Vec<(f64, bool)> {
    let mut timing = Timing::new(1.0 / 30.0);
    let moments: Vec<Moment> = given.iter().map(|(stamp, _)| timing.judge(stamp)).collect();
    let pairs = moments.windows(2).zip(given.windows(2)).skip(from);
    pairs
        .map(|(judged, given)| {
            assert!(judged[1].time_ns > judged[0].time_ns, "time goes on");
            let judged_ns = (judged[1].time_ns - judged[0].time_ns) as f64;
            (judged_ns / (given[1].1 - given[0].1) - 1.0, judged[1].is_certain)
        })
        .collect()
}

/// Root mean square error of the intervals that are called certain, and the part of all that are not.
fn judge(given: &[Given], from: usize) -> (f64, f64) {
    let errors = errors(given, from);
    let certain: Vec<f64> = errors.iter().filter(|(_, certain)| *certain).map(|(error, _)| *error).collect();
    let square = certain.iter().map(|error| error * error).sum::<f64>() / certain.len() as f64;
    (square.sqrt(), 1.0 - certain.len() as f64 / errors.len() as f64)
}

#[test]
fn even_times_are_taken_to_the_nanosecond() {
    let mut random = Congruential::new(1);
    for rate in [7.5, 15.0, 24.0, 25.0, 29.97, 30.0, 60.0, 90.0] {
        for wobble_ns in [0.0, 50_000.0] {
            let mut timing = Timing::new(1.0 / rate);
            let mut last: Option<(Stamp, Moment)> = None;
            for n in 0..200 {
                let stamp = stamp(n as f64 * 1e9 / rate + wobble_ns * random.unit(), 3 * n);
                let stamp = Stamp { sequence: n, ..stamp };
                let moment = timing.judge(&stamp);
                if let Some((before, judged)) = last {
                    assert_eq!(moment.time_ns - judged.time_ns, stamp.time_ns - before.time_ns, "{rate} fps, frame {n}");
                    assert!(moment.is_certain);
                }
                last = Some((stamp, moment));
            }
        }
    }
}

#[test]
fn frames_stamped_late_come_back_to_the_rhythm() {
    const MS: f64 = 1e6;
    for seed in 1..6 {
        for (name, largest, raw) in [("1 ms", 0.02, 1.0), ("3 ms", 0.03, 3.0), ("8 ms", 0.06, 8.0)] {
            let mut random = Congruential::new(seed);
            let given = delayed(400, |_| raw * MS * normal(&mut random));
            let (error, unsure) = judge(&given, 50);
            assert!(error < largest && unsure < 0.08, "jitter of {name}, seed {seed}: {error:.3}, {unsure:.3}");
        }
        for late_ms in [20.0, 40.0] {
            let mut random = Congruential::new(seed);
            let mut late = || if random.unit() < 0.1 { late_ms * MS * random.unit() } else { 0.0 };
            let given = delayed(400, |_| late());
            let (error, unsure) = judge(&given, 50);
            assert!(error < 0.03 && unsure < 0.04, "a tenth late by up to {late_ms} ms, seed {seed}: {error:.3}, {unsure:.3}");
        }
    }
}

#[test]
fn bursts_are_spread_out() {
    for size in 2..=8 {
        let given = delayed(400, |n| (size - 1 - n % size) as f64 * (PERIOD_NS - 1e6));
        let (error, unsure) = judge(&given, 60);
        assert!(error < 0.02 && unsure < 0.01, "bursts of {size}: {error:.3}, {unsure:.3}");
    }
}

#[test]
fn a_stall_is_believed_once_and_its_burst_is_spread_out() {
    for stall_ms in [50.0, 166.0, 500.0] {
        for seed in 1..4 {
            let (mut random, mut due_ns, mut last_ns) = (Congruential::new(seed), 0.0_f64, f64::MIN);
            let given = delayed(400, |n| {
                let true_ns = n as f64 * PERIOD_NS;
                let came_ns = true_ns + 1e6 * normal(&mut random);
                if n % 30 == 29 {
                    due_ns = came_ns + 1e6 * stall_ms;
                }
                last_ns = came_ns.max(due_ns).max(last_ns + 1e6);
                last_ns - true_ns
            });
            let errors = errors(&given, 0);
            let short = errors.iter().map(|(error, _)| *error).fold(0.0, f64::min);
            assert!(short > -0.3, "{stall_ms} ms, seed {seed}: {short:.2}: motion would look faster than it was");
            // the first stall cannot be told from a pause
            let long = errors.iter().filter(|(error, certain)| *error > 0.3 || !certain).count();
            assert!(long < 20, "{stall_ms} ms, seed {seed}: {long} intervals are too long");
        }
    }
}

#[test]
fn another_rate_and_gaps_are_followed_at_once() {
    for slow in [1.2, 1.5, 2.0, 4.0] {
        let mut time_ns = 0.0;
        let given: Vec<Given> = (0..300)
            .map(|n| {
                time_ns += PERIOD_NS * if n / 50 % 2 == 1 { slow } else { 1.0 };
                (stamp(time_ns, n), time_ns)
            })
            .collect();
        for (n, (error, _)) in errors(&given, 0).into_iter().enumerate() {
            assert!(error.abs() < 1e-6, "{slow} times slower, frame {n}: {error}");
        }
    }
    for counts in [true, false] {
        let mut random = Congruential::new(9);
        let kept: Vec<Given> = delayed(500, |_| 0.0).into_iter().filter(|_| random.unit() > 0.15).collect();
        let kept: Vec<Given> = (0..)
            .zip(kept)
            .map(|(n, (stamp, true_ns))| (Stamp { sequence: if counts { stamp.sequence } else { n }, ..stamp }, true_ns))
            .collect();
        for (n, (error, certain)) in errors(&kept, 0).into_iter().enumerate() {
            assert!(error.abs() < 1e-6 && (certain || !counts), "counts {counts}, frame {n}: {error}");
        }
    }
}

#[test]
fn gaps_behind_jitter_are_real_time() {
    for seed in 1..6 {
        let mut random = Congruential::new(seed);
        let given = delayed(500, |_| 3e6 * normal(&mut random));
        let kept: Vec<Given> = given.into_iter().filter(|_| random.unit() > 0.15).collect();
        let (error, unsure) = judge(&kept, 50);
        assert!(error < 0.04 && unsure < 0.06, "seed {seed}: {error:.3}, {unsure:.3}");
    }
}

#[test]
fn nonsense_is_survived() {
    let even = |n: u64| stamp(n as f64 * PERIOD_NS, n);
    let wild = [0, 1, -1, i64::MIN, i64::MAX, 4_154_505_010_207_436_000];
    for place in [0, 1, 20] {
        for time_ns in wild {
            for sequence in [0, 5, u64::MAX] {
                let mut timing = Timing::new(1.0 / 30.0);
                let mut before = None;
                for n in 0..60 {
                    let stamp = if n == place { Stamp { time_ns, sequence, ..even(n) } } else { even(n) };
                    let moment = timing.judge(&stamp);
                    if let Some(before) = before {
                        let seconds = seconds_between(before, moment.time_ns);
                        assert!(seconds > 0.0 && seconds <= 1.0, "{place} {time_ns} {sequence}: {seconds} s at {n}");
                        let settled = n > place + 1;
                        assert!(
                            !settled || (seconds * 30.0 - 1.0).abs() < 1e-6,
                            "{place} {time_ns} {sequence}: {seconds} s at {n}"
                        );
                    }
                    before = Some(moment.time_ns);
                }
            }
        }
    }
}

#[test]
fn equal_and_backward_times_are_the_rhythm() {
    let given = delayed(200, |n| if n % 10 == 9 { -PERIOD_NS } else { 0.0 });
    let (error, unsure) = judge(&given, 0);
    assert!(error < 0.01 && unsure < 0.25, "equal: {error:.3}, {unsure:.3}");
    let given = delayed(200, |n| -2e8 * (n / 30) as f64);
    let errors = errors(&given, 0);
    assert!(errors.iter().all(|(error, _)| error.abs() < 0.01), "a clock that is set back now and then: {errors:?}");
    let still: Vec<Given> = (0..200).map(|n| (stamp(0.0, n), n as f64 * PERIOD_NS)).collect();
    assert!(self::errors(&still, 0).iter().all(|(error, certain)| error.abs() < 1e-6 && !certain), "a clock that stands still");
}

/// A nominal rate that is a fourth of the true one holds only until enough frames have come.
#[test]
fn a_wrong_nominal_rate_is_found_out() {
    let given: Vec<Given> = (0..120).map(|n| (stamp(n as f64 * PERIOD_NS / 4.0, n), n as f64 * PERIOD_NS / 4.0)).collect();
    let settled = errors(&given, 50);
    assert!(settled.iter().all(|(error, certain)| error.abs() < 1e-6 && *certain), "{settled:?}");
}

#[test]
fn steps_are_limited() {
    assert_eq!(seconds_between(0, 2_000_000_000), 1.0);
    assert_eq!(seconds_between(i64::MIN, i64::MAX), 1.0);
    assert_eq!(seconds_between(0, 33_000_000), 0.033);
    assert_eq!((step_s(0.5, 0.03), step_s(0.5, 0.2), step_s(0.03, 0.03)), (0.1, 0.2, 0.03));
}
