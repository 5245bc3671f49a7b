//! What a run tells about itself: traces, times, side-by-side pictures, a page to look at. Watches the pipeline, never steers it.

mod compare;
mod histogram;
mod names;
mod stats;
mod trace;

pub use compare::{Compare, compare_format};
pub use histogram::Histogram;
pub use names::{Axis, MotionNames, outcome_name};
pub use stats::Stats;
pub use trace::Trace;

use crate::frame::Frame;
use crate::image::PictureRef;
use crate::pipeline::Observer;

/// Several observers at once, asked in order.
#[derive(Default)]
pub struct Tee<'a>(pub Vec<&'a mut dyn Observer>);

impl Observer for Tee<'_> {
    fn drawn(&mut self, frame: &Frame, output: PictureRef<'_>) {
        self.0.iter_mut().for_each(|observer| observer.drawn(frame, output));
    }

    fn sent(&mut self, frame: &Frame) {
        self.0.iter_mut().for_each(|observer| observer.sent(frame));
    }
}
