//! A limit for log lines that clients cause: at most so many per second, and a count of those suppressed.

use std::time::{Duration, Instant};

const SECOND: Duration = Duration::from_secs(1);

/// What the lines are about. Together they are at most ten a second.
#[derive(Clone, Copy, Debug, Eq, PartialEq)]
pub(super) enum Subject {
    /// A request that was refused.
    Refusal,
    /// A setting that was changed.
    Change,
    /// The configuration that was read again.
    Reload,
    /// A connection that was refused or ended.
    Connection,
}

impl Subject {
    const ALL: [Self; 4] = [Self::Refusal, Self::Change, Self::Reload, Self::Connection];

    /// Lines a second; one more may say how many were suppressed.
    fn most(self) -> u32 {
        match self {
            Self::Refusal | Self::Connection => 1,
            Self::Change | Self::Reload => 2,
        }
    }

    fn name(self) -> &'static str {
        match self {
            Self::Refusal => "refused requests",
            Self::Change => "changed settings",
            Self::Reload => "reloads",
            Self::Connection => "connections",
        }
    }
}

/// The counts of the second that runs, for each subject.
#[derive(Debug, Default)]
pub(super) struct LogLimiter([Count; Subject::ALL.len()]);

#[derive(Debug, Default)]
struct Count {
    /// When the second began; `None` where nothing was said since the last.
    since: Option<Instant>,
    said: u32,
    suppressed: u64,
}

impl LogLimiter {
    /// Whether a line about this may be written now; where not, it is counted.
    pub(super) fn may_log(&mut self, about: Subject, now: Instant) -> bool {
        self.flush(now);
        let count = &mut self.0[about as usize];
        count.since.get_or_insert(now);
        let may = count.said < about.most();
        if may {
            count.said += 1;
        } else {
            count.suppressed += 1;
        }
        may
    }

    /// Writes what was suppressed in seconds that are over.
    pub(super) fn flush(&mut self, now: Instant) {
        for (about, suppressed) in self.over(now) {
            tracing::warn!("{suppressed} more suppressed: {}", about.name());
        }
    }

    fn over(&mut self, now: Instant) -> Vec<(Subject, u64)> {
        let mut told = Vec::new();
        for (count, about) in self.0.iter_mut().zip(Subject::ALL) {
            if count.since.is_some_and(|since| now.saturating_duration_since(since) >= SECOND) {
                if count.suppressed > 0 {
                    told.push((about, count.suppressed));
                }
                *count = Count::default();
            }
        }
        told
    }

    /// When [`LogLimiter::flush`] has something to write at the latest.
    pub(super) fn deadline(&self) -> Option<Instant> {
        self.0.iter().filter(|count| count.suppressed > 0).filter_map(|count| Some(count.since? + SECOND)).min()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ten_lines_a_second_whatever_happens_and_all_are_counted() {
        let start = Instant::now();
        let mut limiter = LogLimiter::default();
        assert_eq!(limiter.deadline(), None);
        let most: u32 = Subject::ALL.iter().map(|about| about.most() + 1).sum();
        assert_eq!(most, 10);
        let (mut said, mut suppressed) = (0, 0);
        for ms in 0..3500 {
            let now = start + Duration::from_millis(ms);
            suppressed += limiter.over(now).iter().map(|(_, count)| count).sum::<u64>();
            for about in Subject::ALL {
                said += u64::from(limiter.may_log(about, now));
            }
        }
        assert_eq!(said, 4 * 6, "four seconds began");
        assert!(limiter.deadline().is_some_and(|at| at <= start + Duration::from_millis(4000)));
        suppressed += limiter.over(start + Duration::from_secs(5)).iter().map(|(_, count)| count).sum::<u64>();
        assert_eq!(said + suppressed, 4 * 3500);
        assert_eq!(limiter.deadline(), None);
    }
}
