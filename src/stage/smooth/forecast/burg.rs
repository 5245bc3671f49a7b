//! Autoregression: the weights by Burg's method, and what they let expect.

use super::{AHEAD, ORDER, PAST};

/// Weights of the last ways in the next, by Burg's recursion. `ways` are the newest first; each counts `keep` times less than the one
/// after it. `ridge` is how much way squared must be seen before any of it is believed.
pub fn weights(ways: &[f64], keep: f64, ridge: f64) -> [f64; ORDER] {
    let mut weights = [0.0; ORDER];
    let n = ways.len();
    // prediction errors: of a way by those before it, and by those after it
    let (mut forth, mut back, mut share) = ([0.0; PAST], [0.0; PAST], [0.0; PAST]);
    forth[..n].copy_from_slice(ways);
    back[..n].copy_from_slice(ways);
    let mut weight = 1.0;
    for share in &mut share[..n] {
        *share = weight;
        weight *= keep;
    }
    for m in 0..ORDER.min(n / 2) {
        // newest first: the way before is the next in the list
        let pairs = n - m - 1;
        let (mut both, mut across) = (ridge, 0.0);
        for i in 0..pairs {
            let (f, b) = (forth[i], back[i + 1]);
            both += share[i] * (f * f + b * b);
            across += share[i] * f * b;
        }
        if both <= 0.0 {
            break;
        }
        let reflection = 2.0 * across / both;
        let before = weights;
        weights[m] = reflection;
        for i in 0..m {
            weights[i] = before[i] - reflection * before[m - 1 - i];
        }
        for i in 0..pairs {
            let (f, b) = (forth[i], back[i + 1]);
            forth[i] = f - reflection * b;
            back[i] = b - reflection * f;
        }
    }
    weights
}

/// How far the camera will have gone 1, 2 .. ticks on.
pub fn predict(weights: &[f64; ORDER], ways: &[f64]) -> [f64; AHEAD] {
    let mut last = [0.0; ORDER];
    for (last, way) in last.iter_mut().zip(ways) {
        *last = *way;
    }
    let mut gone = 0.0;
    std::array::from_fn(|_| {
        let way: f64 = last.iter().zip(weights).map(|(way, weight)| way * weight).sum();
        last.rotate_right(1);
        last[0] = way;
        gone += way;
        gone
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Congruential;

    /// Numbers of variance 1, always the same.
    fn numbers(seed: u64) -> impl FnMut() -> f64 {
        let mut generator = Congruential::new(seed);
        move || generator.signed() * 3f64.sqrt()
    }

    /// The last ways, the newest first, of `x = a1 x' + a2 x'' + noise`.
    fn process([a1, a2]: [f64; 2], random: &mut impl FnMut() -> f64) -> Vec<f64> {
        let mut ways = vec![0.0; PAST + 200];
        for k in 2..ways.len() {
            ways[k] = a1 * ways[k - 1] + a2 * ways[k - 2] + random();
        }
        ways.reverse();
        ways.truncate(PAST);
        ways
    }

    /// Measured: means off by at most .03, single weights of 120 ways by .1 (one over the root of their number).
    #[test]
    fn the_weights_of_a_known_process_are_found() {
        let mut random = numbers(5);
        for known in [[1.6, -0.9], [0.5, 0.3], [-0.4, 0.0], [0.0, 0.0]] {
            let (runs, mut mean) = (400, [0.0; ORDER]);
            for _ in 0..runs {
                let found = weights(&process(known, &mut random), 1.0, 0.0);
                (0..ORDER).for_each(|i| mean[i] += found[i] / f64::from(runs));
            }
            println!("{known:?}: {mean:.3?}");
            for (i, found) in mean.into_iter().enumerate() {
                let wanted = known.get(i).copied().unwrap_or(0.0);
                assert!((found - wanted).abs() < 0.06, "{known:?}: weight {i} is {found}, not {wanted}");
            }
        }
    }

    #[test]
    fn a_swing_is_foreseen_and_what_is_not_seen_is_not_believed() {
        let swing = |k: f64| (0.4 * k).sin();
        let ways: Vec<f64> = (0..PAST).map(|k| swing(-(k as f64))).collect();
        let expected = predict(&weights(&ways, 1.0, 0.0), &ways);
        let mut gone = 0.0;
        for (k, expected) in expected.into_iter().enumerate().take(12) {
            gone += swing(k as f64 + 1.0);
            assert!((expected - gone).abs() < 0.1, "{k}: {expected} for {gone}");
        }
        assert_eq!(weights(&[0.0; PAST], 1.0, 0.0), [0.0; ORDER]);
        let faint = weights(&ways, 1.0, 1e6);
        assert!(faint.iter().all(|weight| weight.abs() < 1e-3), "{faint:?}");
    }

    /// Old ways count less where they are to be forgotten.
    #[test]
    fn a_process_that_changed_is_learned_from_its_newest_ways() {
        let mut random = numbers(9);
        let mut both = process([-0.8, 0.0], &mut random);
        both.truncate(40);
        both.extend(process([0.8, 0.0], &mut random).into_iter().take(PAST - 40));
        let [kept, faded] = [1.0, 0.9].map(|keep| weights(&both, keep, 0.0)[0]);
        assert!(faded < -0.5 && kept > faded + 0.3, "{faded} and {kept}");
    }
}
