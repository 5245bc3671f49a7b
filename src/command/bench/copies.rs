//! The time of a plain copy of a picture: the reference that makes results of different machines comparable.
//!
//! Copied in two ways. *In cache*: the same two buffers again and again, the fastest that a copy can be. *Through memory*: from one ring of
//! pictures to another, both larger than the last-level cache, so that each picture comes from memory and goes there. The latter is what
//! a video pipeline can be compared with: a camera's frame was written by another device, the one before was seen a frame ago, and the
//! output goes to a reader; none of them waits in the cache.

use std::hint::black_box;

use crate::rt::clock::monotonic_ns;

/// Bytes of each ring, more than any last-level cache that a core of a desktop machine has for itself.
const RING: usize = 64 << 20;
/// The first copy of the two buffers brings them near; it does not count.
const COPIES: usize = 3;

/// Medians, nanoseconds; 0 before anything was measured.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CopyTimes {
    /// The same two buffers again and again.
    pub cache_ns: u64,
    /// From ring to ring.
    pub memory_ns: u64,
}

/// Takes the times of copies, a few at a time, between other work.
#[derive(Debug)]
pub struct Copies {
    bytes: usize,
    from: Vec<u8>,
    to: Vec<u8>,
    next: usize,
    cache_ns: Vec<u64>,
    memory_ns: Vec<u64>,
}

impl Copies {
    /// For pictures of so many bytes. Takes the memory of both rings.
    pub fn new(bytes: usize) -> Self {
        let bytes = bytes.max(1);
        let ring = RING.div_ceil(bytes).max(2) * bytes;
        let (from, to) = (vec![7; ring], vec![9; ring]);
        Self { bytes, from, to, next: 0, cache_ns: Vec::new(), memory_ns: Vec::new() }
    }

    /// Copies once through memory and some times in cache.
    pub fn measure(&mut self) {
        let at = self.next..self.next + self.bytes;
        self.next = if at.end == self.to.len() { 0 } else { at.end };
        for n in 0..=COPIES {
            let started = monotonic_ns();
            self.to[at.clone()].copy_from_slice(black_box(&self.from[at.clone()]));
            black_box(&mut self.to);
            let spent_ns = monotonic_ns().saturating_sub(started) as u64;
            match n {
                0 => self.memory_ns.push(spent_ns),
                1 => {}
                _ => self.cache_ns.push(spent_ns),
            }
        }
    }

    /// The times so far.
    pub fn times(&mut self) -> CopyTimes {
        let median = |times: &mut Vec<u64>| {
            times.sort_unstable();
            times.get(times.len() / 2).copied().unwrap_or(0)
        };
        CopyTimes { cache_ns: median(&mut self.cache_ns), memory_ns: median(&mut self.memory_ns) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_copies_are_timed_and_the_ring_goes_round() {
        let mut copies = Copies::new(RING / 3 + 5);
        assert_eq!(copies.times(), CopyTimes::default());
        for _ in 0..4 {
            copies.measure();
            assert!(copies.next < copies.to.len() && copies.next.is_multiple_of(copies.bytes));
        }
        let times = copies.times();
        assert!(times.cache_ns > 0 && times.memory_ns > 0, "{times:?}");
    }
}
