//! A token bucket: limits a rate and allows short bursts. Time is an argument.

use std::time::{Duration, Instant};

/// So much a second in the long run, and so much at once after a rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rate {
    /// In a second; more than 0.
    pub per_second: f64,
    /// At once; at least 1.
    pub burst: f64,
}

/// What was taken counts half after this long.
const HALF_LIFE_S: f64 = 5.0;

/// What is left of it.
#[derive(Clone, Debug)]
pub(super) struct TokenBucket {
    rate: Rate,
    level: f64,
    /// What was taken of late: the newest counts most. Tells apart those who ask less than they may.
    taken: f64,
    at: Instant,
}

impl TokenBucket {
    /// All of it.
    pub(super) fn new(rate: Rate, now: Instant) -> Self {
        Self { rate, level: rate.burst, taken: 0.0, at: now }
    }

    /// How much is left.
    pub(super) fn level(&self, now: Instant) -> f64 {
        let grown = now.saturating_duration_since(self.at).as_secs_f64() * self.rate.per_second;
        (self.level + grown).min(self.rate.burst)
    }

    /// Whether one is left.
    pub(super) fn has(&self, now: Instant) -> bool {
        self.level(now) >= 1.0
    }

    /// How much was taken of late.
    pub(super) fn taken(&self, now: Instant) -> f64 {
        let half_lives = now.saturating_duration_since(self.at).as_secs_f64() / HALF_LIFE_S;
        self.taken * (-half_lives).exp2()
    }

    /// Whether it is as if nothing had ever been taken.
    pub(super) fn is_new(&self, now: Instant) -> bool {
        self.level(now) >= self.rate.burst && self.taken(now) < 0.5
    }

    /// Takes one, or what is left.
    pub(super) fn take(&mut self, now: Instant) {
        (self.level, self.taken, self.at) = ((self.level(now) - 1.0).max(0.0), self.taken(now) + 1.0, now);
    }

    /// Takes one where one is left.
    pub(super) fn try_take(&mut self, now: Instant) -> bool {
        let has = self.has(now);
        if has {
            self.take(now);
        }
        has
    }

    /// How long it takes until one is left.
    pub(super) fn wait(&self, now: Instant) -> Duration {
        let missing = (1.0 - self.level(now)).max(0.0);
        Duration::try_from_secs_f64(missing / self.rate.per_second).unwrap_or(Duration::from_secs(3600))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_burst_then_the_rate() {
        let start = Instant::now();
        let after = |ms: u64| start + Duration::from_millis(ms);
        let mut bucket = TokenBucket::new(Rate { per_second: 10.0, burst: 3.0 }, start);
        assert!((0..3).all(|_| bucket.try_take(start)) && !bucket.try_take(start));
        assert!(bucket.wait(start).as_millis().abs_diff(100) <= 1);
        assert!(!bucket.try_take(after(90)) && bucket.try_take(after(101)) && !bucket.try_take(after(102)));
        assert!((bucket.taken(after(101)) - 4.0).abs() < 0.1 && (bucket.taken(after(5101)) - 2.0).abs() < 0.1);
        assert!(!bucket.is_new(after(1000)) && bucket.is_new(after(60_000)));
        assert!(bucket.level(after(100_000)) <= 3.0, "a long rest gives no more than the burst");
        (0..100).for_each(|_| bucket.take(after(100_000)));
        assert!(bucket.wait(after(100_000)).as_millis() <= 100, "nothing is owed");
        assert_eq!(bucket.wait(after(200_000)), Duration::ZERO);
        // time that goes backwards, as between two threads' clocks, gives nothing
        assert!(bucket.level(start) <= 3.0);
    }
}
