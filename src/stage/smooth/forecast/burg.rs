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
