//! How long to wait before the next attempt: longer each time, up to a limit.

use std::time::Duration;

/// The first pause.
const FIRST: Duration = Duration::from_millis(100);
/// The longest.
const MAX: Duration = Duration::from_secs(5);
/// The longest against a camera that another program has open: nothing reports when it is released.
const MAX_BUSY: Duration = Duration::from_millis(300);

/// Doubles the pause with each attempt.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Backoff {
    pause: Duration,
}

impl Default for Backoff {
    fn default() -> Self {
        Self { pause: FIRST }
    }
}

impl Backoff {
    /// The pause before the next attempt; `busy` where another program has the device.
    pub(super) fn next(&mut self, busy: bool) -> Duration {
        let pause = if busy { self.pause.min(MAX_BUSY) } else { self.pause };
        self.pause = (2 * pause).min(MAX);
        pause
    }

    /// Something worked, or changed: the next pause is the first one again.
    pub(super) fn reset(&mut self) {
        *self = Self::default();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pauses(backoff: &mut Backoff, busy: bool, count: usize) -> Vec<u64> {
        (0..count).map(|_| backoff.next(busy).as_millis() as u64).collect()
    }

    #[test]
    fn pauses_double_up_to_the_limit() {
        let mut backoff = Backoff::default();
        assert_eq!(pauses(&mut backoff, false, 8), [100, 200, 400, 800, 1600, 3200, 5000, 5000]);
        backoff.reset();
        assert_eq!(pauses(&mut backoff, false, 2), [100, 200]);
    }

    #[test]
    fn a_busy_device_is_tried_at_least_three_times_a_second() {
        let mut backoff = Backoff::default();
        assert_eq!(pauses(&mut backoff, true, 4), [100, 200, 300, 300]);
        pauses(&mut backoff, false, 9);
        assert_eq!(pauses(&mut backoff, true, 1), [300], "also after a long wait for another reason");
    }
}
