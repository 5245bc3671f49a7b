//! Durations in a fixed number of buckets: median and percentiles of runs of any length in bounded memory.

/// Buckets to an octave, as a power of two: a bucket is 1/64 of its value wide.
const FINE_BITS: u32 = 6;
/// Durations of 2^44 ns (nearly 5 hours) and more share the last bucket.
const OCTAVES: u32 = 44;
const BUCKETS: usize = ((OCTAVES - FINE_BITS + 1) << FINE_BITS) as usize;

/// Counts of durations in nanoseconds. Percentiles are right within 1/128 of their value; count, sum and maximum are exact.
#[derive(Clone, Debug)]
pub struct Histogram {
    buckets: Box<[u64]>,
    count: u64,
    max: u64,
}

impl Default for Histogram {
    fn default() -> Self {
        Self { buckets: vec![0; BUCKETS].into(), count: 0, max: 0 }
    }
}

impl Histogram {
    /// Counts one duration. Allocates nothing.
    #[inline]
    pub fn add(&mut self, ns: u64) {
        self.buckets[bucket(ns)] += 1;
        self.count += 1;
        self.max = self.max.max(ns);
    }

    /// Durations counted.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// The longest, nanoseconds; 0 where there is none.
    pub fn max(&self) -> u64 {
        self.max
    }

    /// The duration that `share` (0 to 1) of all do not exceed, nanoseconds; 0 where there is none.
    pub fn quantile(&self, share: f64) -> u64 {
        let rank = ((share.clamp(0.0, 1.0) * self.count as f64).ceil() as u64).max(1);
        let mut seen = 0;
        for (index, count) in self.buckets.iter().enumerate() {
            seen += count;
            if seen >= rank {
                return middle(index).min(self.max);
            }
        }
        0
    }
}

/// The bucket of a duration: whole numbers up to 127, then 64 to an octave.
fn bucket(ns: u64) -> usize {
    let octave = (63 - (ns | 1).leading_zeros()).max(FINE_BITS);
    if octave >= OCTAVES {
        return BUCKETS - 1;
    }
    let shift = octave - FINE_BITS;
    ((shift as usize) << FINE_BITS) + (ns >> shift) as usize
}

/// The middle of a bucket, nanoseconds.
fn middle(index: usize) -> u64 {
    let shift = (index >> FINE_BITS).saturating_sub(1);
    let fine = index - (shift << FINE_BITS);
    ((fine as u64) << shift) + ((1 << shift) >> 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn buckets_follow_each_other_without_gap_and_hold_their_middle() {
        let mut last = 0;
        for ns in (0..20_000).chain((1..=35).flat_map(|power| [(1 << power) - 1, 1 << power, (1 << power) + 1]).skip(42)) {
            let index = bucket(ns);
            assert!(index < BUCKETS && bucket(middle(index)) == index, "{ns}");
            assert!((middle(index) as f64 - ns as f64).abs() <= ns as f64 / 128.0 + 0.5, "{ns}: {}", middle(index));
            if ns < 20_000 {
                assert!(index == last || index == last + 1, "{ns}");
                last = index;
            }
        }
        assert_eq!(bucket(u64::MAX), BUCKETS - 1);
    }

    #[test]
    fn quantiles_of_known_durations() {
        let mut histogram = Histogram::default();
        assert_eq!(histogram.quantile(0.5), 0);
        (1..=1000).rev().for_each(|ms| histogram.add(ms * 1_000_000));
        for (share, ms) in [(0.5, 500.0), (0.99, 990.0), (1.0, 1000.0), (0.0, 1.0)] {
            let got = histogram.quantile(share) as f64 / 1e6;
            assert!((got - ms).abs() <= ms / 100.0, "{share}: {got}");
        }
        assert_eq!((histogram.count(), histogram.max()), (1000, 1_000_000_000));
    }
}
