//! Every kernel at every level, on memory that ends (and memory that begins) at a page that may not be touched: all sizes from 1 to
//! [`MAX`] along both axes, padded rows, extreme parameters. A read or write outside of a slice ends the test by a signal.

mod convert;
mod corner;
mod fenced;
mod lk;
mod normal;
mod pyramid;
mod warp;

use super::*;
use crate::image::PlaneRef;
use crate::random::SplitMix;
use fenced::{Edge, Fenced};

/// The largest width and height of all those that are tried one by one.
const MAX: usize = 40;

#[test]
fn the_cap_holds() {
    assert_eq!(Level::capped(Some("scalar")), Level::SCALAR);
    assert_eq!(Level::capped(Some(Level::best().name())), Level::best());
    assert_eq!(Level::capped(Some("")), Level::best());
    assert_eq!(Level::capped(None), Level::best());
    assert_eq!(Level::all().next(), Some(Level::SCALAR));
}

/// Numbers that kernels are tried with.
struct Random(SplitMix);

impl Random {
    fn new(seed: u64) -> Self {
        Self(SplitMix::new(seed))
    }

    /// A whole number below `limit`.
    fn below(&mut self, limit: usize) -> usize {
        self.0.below(limit)
    }

    /// A whole number from `low` to `high`, both included.
    fn between(&mut self, low: i64, high: i64) -> i64 {
        low + (self.0.bits() % (high - low + 1) as u64) as i64
    }

    fn of<T: Copy>(&mut self, values: &[T]) -> T {
        values[self.below(values.len())]
    }

    /// A sample; many are the least or the greatest there is.
    fn sample(&mut self) -> u8 {
        let noise = self.0.bits();
        [0, 255, noise as u8, (noise >> 8) as u8][(noise >> 62) as usize]
    }
}

/// How a plane of a test lies in memory.
#[derive(Clone, Copy, Debug)]
struct Shape {
    width: usize,
    height: usize,
    stride: usize,
    edge: Edge,
}

impl Shape {
    /// Every size to be tried, without padding and with an odd stride, at the end of memory and at its beginning.
    fn all() -> impl Iterator<Item = Self> {
        (1..=MAX).flat_map(|height| (1..=MAX).flat_map(move |width| Self::of(width, height)))
    }

    /// One size as in [`all`](Self::all).
    fn of(width: usize, height: usize) -> impl Iterator<Item = Self> {
        let strides = [width, (width + 3) | 1];
        let edges = [Edge::End, Edge::Start];
        strides.into_iter().flat_map(move |stride| edges.map(|edge| Self { width, height, stride, edge }))
    }

    /// Samples from the first to the last; the last row has no padding.
    fn len(self) -> usize {
        if self.width == 0 || self.height == 0 { 0 } else { (self.height - 1) * self.stride + self.width }
    }

    /// A plane of noise in `memory`.
    fn plane<'a>(self, memory: &'a mut Fenced<u8>, random: &mut Random) -> PlaneRef<'a> {
        let samples = memory.filled(self.edge, self.len(), |_| random.sample());
        PlaneRef::new(samples, self.width, self.height, self.stride).expect("as long as its shape asks")
    }
}
