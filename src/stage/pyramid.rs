//! The pyramid: luma at half, quarter and eighth resolution.
//!
//! A point (x, y) of the picture lies at ((x + 0.5) / 2^l - 0.5, (y + 0.5) / 2^l - 0.5) of level l.

use crate::frame::Pyramid;
use crate::image::PlaneRef;
use crate::kernel::{Level, pyramid::halve};

/// Levels above the picture itself, at most.
const MAX_LEVELS: usize = 4;
/// A level whose shorter side would be less is not made (pixels).
const MIN_SIDE: usize = 36;

/// Fills `pyramid` from `luma`. Allocates only where the picture's size changed.
pub fn build(level: Level, luma: PlaneRef<'_>, pyramid: &mut Pyramid) {
    let mut count = 0;
    while count < MAX_LEVELS && luma.width().min(luma.height()) >> (count + 1) >= MIN_SIDE {
        count += 1;
    }
    pyramid.levels.resize_with(count, Default::default);
    for i in 0..count {
        let (done, rest) = pyramid.levels.split_at_mut(i);
        let from = done.last().map_or(luma, |plane| plane.as_ref());
        rest[0].reshape(from.width() / 2, from.height() / 2);
        halve(level, from, rest[0].as_mut());
    }
}
