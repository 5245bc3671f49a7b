//! Seeded generators: the same numbers on every machine, for a camera that is made up, for the choices of robust estimators and for tests.
//!
//! There are two, because the pictures whose digests `tests/golden.txt` has rest on the sequence of each. New code takes [`SplitMix`].

/// The 64 bits of `bits` as a number from 0 to 1.
fn unit(bits: u64) -> f64 {
    (bits >> 11) as f64 / (1u64 << 53) as f64
}

/// The 64 bits of `bits` as a number from -1 to 1.
fn signed(bits: u64) -> f64 {
    (bits >> 11) as f64 / (1u64 << 52) as f64 - 1.0
}

/// The 64 bits of `bits` as a whole number below `limit`.
fn below(bits: u64, limit: usize) -> usize {
    ((u128::from(bits) * limit as u128) >> 64) as usize
}

/// splitmix64 (G. Steele, D. Lea, C. Flood, "Fast splittable pseudorandom number generators", OOPSLA 2014).
#[derive(Clone, Debug)]
pub struct SplitMix(u64);

impl SplitMix {
    /// The sequence of this seed.
    pub fn new(seed: u64) -> Self {
        Self(seed)
    }

    /// Any 64 bits.
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        mix(self.0)
    }

    /// A whole number below `limit`.
    pub fn below(&mut self, limit: usize) -> usize {
        below(self.bits(), limit)
    }

    /// Between -1 and 1.
    pub fn signed(&mut self) -> f64 {
        signed(self.bits())
    }

    /// Between `low` and `high`.
    pub fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * unit(self.bits())
    }

    /// Normally distributed, mean 0, standard deviation 1 (Box and Muller).
    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.uniform(0.0, 1.0)).ln()).sqrt();
        radius * self.uniform(0.0, std::f64::consts::TAU).cos()
    }
}

/// Scatters the bits of a number: splitmix64's output function.
pub fn mix(n: u64) -> u64 {
    let n = (n ^ (n >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let n = (n ^ (n >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    n ^ (n >> 31)
}

/// A linear congruential generator with D. Knuth's multiplier for MMIX ("The Art of Computer Programming" 2, 3.3.4). Its upper bits are the
/// better ones.
#[derive(Clone, Copy, Debug)]
pub struct Congruential(u64);

impl Congruential {
    /// The sequence of this seed. Neighbouring seeds begin with similar numbers.
    pub fn new(seed: u64) -> Self {
        Self(seed)
    }

    /// The same for seeds that are counted: neighbouring ones begin with numbers that have nothing in common.
    pub fn scattered(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1)
    }

    /// 64 bits, the lower ones not very random.
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        self.0
    }

    /// Eight bits.
    pub fn byte(&mut self) -> u8 {
        (self.bits() >> 56) as u8
    }

    /// A whole number below `limit`.
    pub fn below(&mut self, limit: usize) -> usize {
        below(self.bits(), limit)
    }

    /// Between 0 and 1.
    pub fn unit(&mut self) -> f64 {
        unit(self.bits())
    }

    /// Between -1 and 1.
    pub fn signed(&mut self) -> f64 {
        signed(self.bits())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Golden digests rest on these sequences.
    #[test]
    fn the_sequences_are_what_they_were() {
        let mut random = SplitMix::new(1_234_567);
        assert_eq!([random.bits(), random.bits()], [6_457_827_717_110_365_317, 3_203_168_211_198_807_973]);
        let mut random = Congruential::new(1);
        assert_eq!([random.bits(), random.bits()], [7_806_831_264_735_756_412, 9_396_908_728_118_811_419]);
    }

    #[test]
    fn numbers_are_spread_evenly_over_their_range() {
        let (mut random, mut other) = (SplitMix::new(3), Congruential::scattered(3));
        let (mut sums, mut squares, count) = ([0.0; 4], [0.0; 4], 20_000);
        for _ in 0..count {
            let numbers = [random.signed(), random.normal(), other.signed(), 2.0 * other.unit() - 1.0];
            assert!(numbers[0].abs() <= 1.0 && numbers[2].abs() <= 1.0 && numbers[3].abs() <= 1.0);
            assert!(random.below(7) < 7 && other.below(1) == 0);
            (0..4).for_each(|i| sums[i] += numbers[i]);
            (0..4).for_each(|i| squares[i] += numbers[i] * numbers[i]);
        }
        for (i, variance) in [1.0 / 3.0, 1.0, 1.0 / 3.0, 1.0 / 3.0].into_iter().enumerate() {
            let (mean, square) = (sums[i] / f64::from(count), squares[i] / f64::from(count));
            assert!(mean.abs() < 0.03 && (square / variance - 1.0).abs() < 0.05, "{i}: {mean} {square}");
        }
    }
}
