//! Whether the camera is needed: while there are viewers and for some time after, but not for programs that only probe the device.

use std::time::Duration;

/// A visit shorter than this is a program that only probes cameras.
const BRIEF_NS: i64 = 1_000_000_000;
/// After two brief visits within this time, the camera is not opened for a third...
const MEMORY_NS: i64 = 60_000_000_000;
/// ...until it has lasted this long.
const DOUBT_NS: i64 = 500_000_000;

/// Tracks viewers and decides. Times are nanoseconds on any monotonic clock.
#[derive(Clone, Copy, Debug)]
pub(super) struct Demand {
    linger_ns: i64,
    /// Whether brief visits may be programs that only probe cameras.
    doubts: bool,
    watched: bool,
    /// When the present visit, or the time without one, began.
    since_ns: i64,
    /// When the camera must have been open for this visit, if it lasts.
    from_ns: i64,
    /// Until when it stays open without viewers.
    until_ns: i64,
    /// Brief visits in a row, and when the last one ended.
    brief: u32,
    brief_ns: i64,
}

impl Demand {
    /// No viewers; the camera lingers for as long where there were some.
    pub(super) fn new(linger: Duration) -> Self {
        let linger_ns = i64::try_from(linger.as_nanos()).unwrap_or(i64::MAX);
        Self {
            linger_ns,
            doubts: true,
            watched: false,
            since_ns: 0,
            from_ns: 0,
            until_ns: i64::MIN,
            brief: 0,
            brief_ns: i64::MIN,
        }
    }

    /// As [`Demand::new`], where every visit counts as a viewer's.
    pub(super) fn exact(linger: Duration) -> Self {
        Self { doubts: false, ..Self::new(linger) }
    }

    /// There are viewers or there are none, at `now_ns`.
    pub(super) fn see(&mut self, watched: bool, now_ns: i64) {
        if watched == self.watched {
            return;
        }
        if watched {
            let doubted = self.doubts && self.brief >= 2 && now_ns.saturating_sub(self.brief_ns) < MEMORY_NS;
            self.from_ns = now_ns.saturating_add(if doubted { DOUBT_NS } else { 0 });
        } else {
            if now_ns.saturating_sub(self.since_ns) < BRIEF_NS {
                let again = now_ns.saturating_sub(self.brief_ns) < MEMORY_NS;
                (self.brief, self.brief_ns) = (if again { self.brief.saturating_add(1) } else { 1 }, now_ns);
            } else {
                self.brief = 0;
            }
            if now_ns >= self.from_ns {
                self.until_ns = now_ns.saturating_add(self.linger_ns);
            }
        }
        (self.watched, self.since_ns) = (watched, now_ns);
    }

    /// Whether the camera should be open at `now_ns`.
    pub(super) fn wants(&self, now_ns: i64) -> bool {
        (self.watched && now_ns >= self.from_ns) || now_ns < self.until_ns
    }

    /// How long from `now_ns` on the answer stays the same if no viewer comes or goes; `None`: without limit.
    pub(super) fn stays_for(&self, now_ns: i64) -> Option<Duration> {
        let until_ns = if self.watched { self.from_ns } else { self.until_ns };
        let left_ns = until_ns.checked_sub(now_ns).filter(|left_ns| *left_ns > 0)?;
        Some(Duration::from_nanos(left_ns.unsigned_abs()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const S: i64 = 1_000_000_000;

    /// The answers at each full second of `visits` (from, to; tenths of seconds), sampled 50 ms after each tenth: open tenths.
    fn open(linger_s: u64, visits: &[(i64, i64)], tenths: i64) -> Vec<i64> {
        let mut demand = Demand::new(Duration::from_secs(linger_s));
        (0..tenths)
            .filter(|&tenth| {
                let now = 100 * S + tenth * S / 10;
                demand.see(visits.iter().any(|&(from, to)| (from..to).contains(&tenth)), now);
                demand.wants(now + S / 20)
            })
            .collect()
    }

    #[test]
    fn it_opens_at_once_and_lingers() {
        assert_eq!(open(2, &[(10, 50)], 100), (10..70).collect::<Vec<_>>());
        assert_eq!(open(2, &[(10, 50), (60, 80)], 120), (10..100).collect::<Vec<_>>(), "no gap between two visits");
        assert_eq!(open(0, &[(10, 50)], 100), (10..50).collect::<Vec<_>>());
        assert_eq!(open(2, &[], 50), Vec::<i64>::new());
    }

    #[test]
    fn who_only_looks_in_again_and_again_does_not_keep_it_open() {
        // For 0.3 s, every three seconds: the first two could be viewers.
        let probes: Vec<_> = (0..20).map(|n| (30 * n, 30 * n + 3)).collect();
        assert_eq!(open(2, &probes, 600), [(0..23), (30..53)].into_iter().flatten().collect::<Vec<_>>());
        assert_eq!(open(5, &probes, 600), (0..83).collect::<Vec<_>>());
        // A viewer that stays gets the camera half a second late.
        let staying: Vec<_> = probes.iter().copied().take(4).chain([(120, 200)]).collect();
        assert_eq!(open(2, &staying, 240).into_iter().filter(|&t| t > 60).collect::<Vec<_>>(), (125..220).collect::<Vec<_>>());
    }

    #[test]
    fn who_is_known_to_watch_is_served_at_once_however_often() {
        let mut demand = Demand::exact(Duration::ZERO);
        for visit in 0..20 {
            let now = (100 + visit) * S;
            demand.see(true, now);
            assert!(demand.wants(now), "visit {visit}");
            demand.see(false, now + S / 10);
            assert!(!demand.wants(now + S / 10));
        }
    }

    #[test]
    fn the_answer_stands_as_long_as_it_says() {
        let mut demand = Demand::new(Duration::from_secs(3));
        assert_eq!(demand.stays_for(5 * S), None);
        demand.see(true, 5 * S);
        assert_eq!(demand.stays_for(5 * S), None);
        demand.see(false, 9 * S);
        assert_eq!(demand.stays_for(10 * S), Some(Duration::from_secs(2)));
        assert!(demand.wants(12 * S - 1) && !demand.wants(12 * S));
        assert_eq!(demand.stays_for(12 * S), None);
    }
}
