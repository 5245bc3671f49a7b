//! A progress bar with frame rate and remaining time, where standard error is a terminal.

use std::io::{IsTerminal, stderr};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use crate::frame::Frame;
use crate::image::PictureRef;
use crate::pipeline::Observer;

/// Shows the number of frames processed.
#[derive(Debug)]
pub(super) struct Progress(ProgressBar);

impl Progress {
    /// A bar for `frames` frames, a counter where their number is not known, nothing where standard error is not a terminal.
    pub(super) fn new(what: &'static str, frames: Option<u64>) -> Self {
        let target = if stderr().is_terminal() { ProgressDrawTarget::stderr() } else { ProgressDrawTarget::hidden() };
        let template = match frames {
            Some(_) => "{msg} {wide_bar} {pos}/{len} frames  {per_sec}  {eta} left",
            None => "{msg} {spinner} {pos} frames  {per_sec}  {elapsed}",
        };
        let bar = ProgressBar::with_draw_target(frames, target).with_message(what);
        // The templates above are right; were one not, the plain bar would do.
        if let Ok(style) = ProgressStyle::with_template(template) {
            bar.set_style(style.with_key("per_sec", |state: &indicatif::ProgressState, to: &mut dyn std::fmt::Write| {
                let _ = write!(to, "{:.0}/s", state.per_sec());
            }));
        }
        Self(bar)
    }

    /// One frame more.
    pub(super) fn step(&self) {
        self.0.inc(1);
    }

    /// Takes the bar away.
    pub(super) fn finish(self) {
        self.0.finish_and_clear();
    }
}

/// Shows nothing.
impl Default for Progress {
    fn default() -> Self {
        Self(ProgressBar::hidden())
    }
}

impl Observer for Progress {
    fn drawn(&mut self, _: &Frame, _: PictureRef<'_>) {}

    fn sent(&mut self, _: &Frame) {
        self.step();
    }
}
