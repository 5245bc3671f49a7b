//! Observers of a stream's frames: the heartbeat, and pages of `gimbald view`.

use super::heartbeat::Heartbeat;
use crate::frame::Frame;
use crate::image::PictureRef;
use crate::pipeline::Observer;
use crate::share::Inspector;

/// Both, as one observer.
pub(super) struct Observers<'a> {
    pub(super) heartbeat: &'a Heartbeat<'a>,
    /// `None` where `output.pipewire = false`.
    pub(super) inspector: Option<Inspector>,
}

impl Observer for Observers<'_> {
    fn drawn(&mut self, frame: &Frame, output: PictureRef<'_>) {
        if let Some(inspector) = &mut self.inspector {
            inspector.show(frame, output);
        }
    }

    fn sent(&mut self, frame: &Frame) {
        let mut heartbeat = self.heartbeat;
        heartbeat.sent(frame);
    }
}
