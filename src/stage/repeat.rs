//! Detects repeated frames: some cameras and drivers keep up a steady rate by sending a frame twice.

use crate::frame::Track;

/// Tracks below which nothing is judged.
const MIN_TRACKS: usize = 12;
/// A track that moved by less (pixels) is at rest: codecs move a repeated picture by less, and motion that the eye sees is more.
const STILL_PX: f64 = 0.06;
/// Part of the tracks that may move in a repeated frame.
const MAX_MOVING: f64 = 0.1;
/// A track that moved by more than this (pixels) in the pair before moved, and the part of the tracks that must have: a camera that stands
/// still repeats nothing in this sense.
const MOVED_PX: f64 = 0.4;
const MIN_MOVED: f64 = 0.8;

/// Whether a frame whose points moved by `tracks` shows the frame before once more, where the points of the pair before moved by `before`.
pub fn is_repeat(tracks: &[Track], before: &[Track]) -> bool {
    let enough = tracks.len() >= MIN_TRACKS && before.len() >= MIN_TRACKS;
    enough && moving(tracks, STILL_PX) < MAX_MOVING && moving(before, MOVED_PX) > MIN_MOVED
}

/// The part of the tracks that moved by more than `least` pixels.
fn moving(tracks: &[Track], least: f64) -> f64 {
    let far = |t: &&Track| (t.to[0] - t.from[0]).powi(2) + (t.to[1] - t.from[1]).powi(2) > least * least;
    tracks.iter().filter(far).count() as f64 / tracks.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tracks(count: usize, moved: f64) -> Vec<Track> {
        (0..count).map(|i| Track { from: [i as f64, 5.0], to: [i as f64 + moved, 5.0], ..Track::default() }).collect()
    }

    #[test]
    fn a_picture_that_stops_in_the_middle_of_a_motion_is_a_repeat() {
        assert!(is_repeat(&tracks(50, 0.02), &tracks(50, 2.0)));
        assert!(!is_repeat(&tracks(50, 0.02), &tracks(50, 0.02)), "the camera stood still before");
        assert!(!is_repeat(&tracks(50, 0.2), &tracks(50, 2.0)), "it still moves");
        let mut few = tracks(50, 0.0);
        few[..8].copy_from_slice(&tracks(8, 3.0));
        assert!(!is_repeat(&few, &tracks(50, 2.0)), "something else moves");
        assert!(!is_repeat(&tracks(11, 0.0), &tracks(50, 2.0)) && !is_repeat(&tracks(50, 0.0), &tracks(11, 2.0)));
    }
}
