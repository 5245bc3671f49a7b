//! When to log an event that repeats: at once, then at increasing intervals.

const SECOND_NS: i64 = 1_000_000_000;

/// Pauses after the first time, the second, and so on; the last one from then on (nanoseconds).
const PAUSES_NS: [i64; 4] = [10 * SECOND_NS, 60 * SECOND_NS, 600 * SECOND_NS, 3600 * SECOND_NS];

/// After so long without the event it counts as new (nanoseconds).
const OVER_NS: i64 = 600 * SECOND_NS;

/// Decides, for one kind of event, which of its occurrences are logged. Times are nanoseconds on any clock that does not run back.
#[derive(Clone, Copy, Debug, Default)]
pub struct LogThrottle {
    /// Times it was logged, when last, and when the event last happened.
    times: usize,
    logged_ns: i64,
    happened_ns: i64,
}

impl LogThrottle {
    /// The event happens (again) at `now_ns`; whether this is to be logged.
    pub fn is_due(&mut self, now_ns: i64) -> bool {
        if self.times > 0 && now_ns.saturating_sub(self.happened_ns) >= OVER_NS {
            self.times = 0;
        }
        self.happened_ns = now_ns;
        let pause = self.times.checked_sub(1).map(|before| PAUSES_NS[before.min(PAUSES_NS.len() - 1)]);
        let due = pause.is_none_or(|pause_ns| now_ns.saturating_sub(self.logged_ns) >= pause_ns);
        if due {
            self.times += 1;
            self.logged_ns = now_ns;
        }
        due
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_happens_every_second_is_logged_at_once_and_then_ever_more_rarely() {
        let mut throttle = LogThrottle::default();
        let due: Vec<i64> = (0..9000).filter(|second| throttle.is_due(second * SECOND_NS)).collect();
        assert_eq!(due, [0, 10, 70, 670, 4270, 7870]);
    }

    #[test]
    fn what_had_stopped_is_new_again() {
        let mut throttle = LogThrottle::default();
        let happens = [0, 10, 20, 700, 705, 710];
        let due: Vec<i64> = happens.into_iter().filter(|second| throttle.is_due(second * SECOND_NS)).collect();
        assert_eq!(due, [0, 10, 700, 710], "after more than ten minutes without");
    }
}
