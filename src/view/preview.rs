//! Pictures for the page: output and input are scaled down, encoded as one JPEG, and kept until the next one.

use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use serde_json::{Value, json};

use crate::report::{EncodedPair, PairEncoder};
use crate::share::FrameInfo;

/// Minimum time between two pictures: 12.5 per second.
pub(super) const INTERVAL: Duration = Duration::from_millis(80);
/// Maximum width of a page's picture (pixels).
pub(super) const WIDEST: usize = 960;
/// JPEG quality, 1 to 100.
const QUALITY: i32 = 80;
/// Frames that are remembered: ten seconds at 120 fps.
const KEPT: usize = 1200;

/// What a page has already received.
#[derive(Clone, Copy, Debug, Default)]
pub struct Cursor {
    /// Number of its last picture; 0: none.
    pub picture: u64,
    /// Epoch of that picture.
    pub epoch: u64,
    /// Number of the last frame; `None`: none.
    pub frame: Option<u64>,
}

/// A picture for a page.
#[derive(Debug)]
pub struct Preview {
    /// Counted from 1.
    pub number: u64,
    /// Width and height of each of both pictures.
    pub size: [usize; 2],
    /// Width and height of the input, in whose pixels [`FrameInfo::corners`] are.
    pub input: [usize; 2],
    /// Increases when frames do not continue the previous ones: a new stream, another position in a recording.
    pub epoch: u64,
    /// The frame that is shown.
    pub shown: FrameInfo,
    /// Frames before it that the page has not received, oldest first.
    pub frames: Vec<FrameInfo>,
    /// Both pictures, the output above the input.
    pub jpeg: Vec<u8>,
}

/// The newest picture, and the threads that wait for the next one.
#[derive(Debug)]
pub(super) struct PreviewFeed {
    state: Mutex<State>,
    published: Condvar,
}

#[derive(Debug)]
struct State {
    newest: Option<Arc<Preview>>,
    frames: VecDeque<FrameInfo>,
    count: u64,
    epoch: u64,
    requested: Option<Instant>,
}

impl Default for PreviewFeed {
    fn default() -> Self {
        let state = State { newest: None, frames: VecDeque::with_capacity(KEPT), count: 0, epoch: 0, requested: None };
        Self { state: Mutex::new(state), published: Condvar::new() }
    }
}

impl PreviewFeed {
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Whether a page has requested a picture within `time`.
    pub(super) fn is_wanted(&self, time: Duration) -> bool {
        self.state().requested.is_some_and(|requested| requested.elapsed() < time)
    }

    /// Waits for a picture after `seen`, `timeout` at most.
    pub(super) fn next(&self, seen: Cursor, timeout: Duration) -> Option<Arc<Preview>> {
        let end = Instant::now() + timeout;
        let mut state = self.state();
        loop {
            state.requested = Some(Instant::now());
            if let Some(newest) = state.newest.as_ref().filter(|newest| newest.number != seen.picture) {
                let last = seen.frame.filter(|_| seen.epoch == newest.epoch);
                let is_new =
                    |frame: &&FrameInfo| frame.number < newest.shown.number && last.is_none_or(|last| frame.number > last);
                let frames = state.frames.iter().filter(is_new).copied().collect();
                return Some(Arc::new(Preview { frames, jpeg: newest.jpeg.clone(), ..**newest }));
            }
            let left = end.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return None;
            }
            state = self.published.wait_timeout(state, left).unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    /// The next frames do not continue the previous ones.
    pub(super) fn restart(&self) {
        let mut state = self.state();
        state.epoch += 1;
        state.frames.clear();
    }

    /// Adds frames; those that were added before are ignored.
    pub(super) fn add_frames(&self, frames: &[FrameInfo]) {
        let mut state = self.state();
        for frame in frames {
            if state.frames.back().is_none_or(|last| frame.number > last.number) {
                state.frames.push_back(*frame);
            }
        }
        while state.frames.len() > KEPT {
            state.frames.pop_front();
        }
    }

    /// Publishes the pictures of the frame `shown`.
    pub(super) fn publish(&self, shown: FrameInfo, encoded: EncodedPair) {
        let mut state = self.state();
        state.count += 1;
        let EncodedPair { size, input, jpeg } = encoded;
        let (number, epoch) = (state.count, state.epoch);
        state.newest = Some(Arc::new(Preview { number, epoch, size, input, shown, frames: Vec::new(), jpeg }));
        drop(state);
        self.published.notify_all();
    }
}

/// An encoder for pictures of at most `widest` pixels' width.
///
/// # Errors
/// What libjpeg-turbo reports.
pub(super) fn encoder(widest: usize) -> Result<PairEncoder, String> {
    PairEncoder::new(widest, QUALITY)
}

/// A frame as the page reads it.
pub(super) fn json(frame: &FrameInfo) -> Value {
    let FrameInfo { number, time_s, path, smoothed, trust, confidence, crop_use, points, outcome, corners, spent_ms, camera } =
        frame;
    json!({
        "n": number, "t": time_s, "path": path, "smoothed": smoothed, "trust": trust, "confidence": confidence, "crop": crop_use,
        "points": points, "outcome": outcome, "corners": corners, "ms": spent_ms, "camera": camera,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(number: u64) -> FrameInfo {
        FrameInfo { number, time_s: number as f64, ..FrameInfo::default() }
    }

    fn encoded() -> EncodedPair {
        EncodedPair { size: [8, 8], input: [8, 8], jpeg: vec![1] }
    }

    #[test]
    fn each_page_gets_what_it_has_not_received() {
        let preview = PreviewFeed::default();
        let brief = Duration::from_millis(1);
        assert!(!preview.is_wanted(Duration::from_secs(60)));
        assert!(preview.next(Cursor::default(), brief).is_none() && preview.is_wanted(Duration::from_secs(60)));
        let give = |numbers: &[u64]| {
            preview.add_frames(&numbers.iter().copied().map(frame).collect::<Vec<_>>());
            preview.publish(frame(numbers[numbers.len() - 1]), encoded());
        };
        give(&[0, 1]);
        let first = preview.next(Cursor::default(), brief).unwrap();
        let numbers =
            |preview: &Preview| preview.frames.iter().chain([&preview.shown]).map(|frame| frame.number).collect::<Vec<_>>();
        assert_eq!((first.number, numbers(&first)), (1, vec![0, 1]));
        let seen = Cursor { picture: 1, epoch: 0, frame: Some(1) };
        assert!(preview.next(seen, brief).is_none());
        // Frames that were added before are added once.
        give(&[1, 2, 3]);
        assert_eq!(numbers(&preview.next(seen, brief).unwrap()), [2, 3]);
        assert_eq!(numbers(&preview.next(Cursor::default(), brief).unwrap()), [0, 1, 2, 3], "another page");
        // A recording that was played from its start again.
        preview.restart();
        give(&[0]);
        let again = preview.next(Cursor { picture: 2, epoch: 0, frame: Some(3) }, brief).unwrap();
        assert_eq!((numbers(&again), again.epoch), (vec![0], 1));
    }

    #[test]
    fn a_waiting_thread_is_woken() {
        let preview = PreviewFeed::default();
        std::thread::scope(|scope| {
            let waiting = scope.spawn(|| preview.next(Cursor::default(), Duration::from_secs(60)));
            while !preview.is_wanted(Duration::from_secs(60)) {
                std::thread::yield_now();
            }
            preview.publish(frame(0), encoded());
            assert_eq!(waiting.join().unwrap().unwrap().number, 1);
        });
    }
}
