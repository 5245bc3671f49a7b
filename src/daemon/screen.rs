//! The loopback with what is shown on it while no camera gives a picture, so that readers keep theirs.

use std::time::Duration;

use super::audience::Audience;
use crate::config::Settings;
use crate::device::v4l2::{Loopback, LoopbackParams};
use crate::device::{DeviceError, FrameSink, StreamFormat, placeholder};
use crate::frame::Stamp;
use crate::image::{Picture, PictureMut, Sampling};
use crate::rt::clock::monotonic_ns;
use crate::rt::wake::Wake;

/// How often readers get a picture while the camera gives none. Browsers give a camera up after some ten seconds without.
pub(super) const SHOW_EVERY: Duration = Duration::from_millis(500);

/// For this long after the last picture (nanoseconds) it is shown again: most faults are over before.
const BRIDGE_NS: i64 = 1_000_000_000;

/// The loopback, and who watches it.
#[derive(Debug)]
pub(super) struct Screen {
    // Before the loopback: its thread listens there.
    pub(super) audience: Audience,
    pub(super) loopback: Loopback,
    placeholder: Picture,
    /// When the camera's last picture was sent.
    live_ns: i64,
}

impl Screen {
    /// Opens the loopback in `format`'s size (even), rate and colours. A reader of the process before keeps its last picture for a
    /// moment.
    ///
    /// # Errors
    /// As [`Loopback::open`].
    pub(super) fn open(settings: &Settings, format: &StreamFormat, wake: &Wake) -> Result<Self, DeviceError> {
        let params = LoopbackParams {
            device: settings.output.device.clone(),
            pixel: settings.output.format,
            width: format.width & !1,
            height: format.height & !1,
            interval: format.interval,
            colour: format.planar().colour,
            buffers: 4,
            create: settings.output.create,
        };
        let loopback = Loopback::open(&params)?;
        let given = loopback.format();
        let mut placeholder = Picture::new(Sampling::S420, given.width as usize, given.height as usize);
        placeholder::draw(&mut placeholder.as_mut());
        let linger = Duration::try_from_secs_f64(settings.output.linger_s).unwrap_or_default();
        let audience = Audience::follow(loopback.path(), linger, wake)?;
        Ok(Self { audience, loopback, placeholder, live_ns: monotonic_ns() })
    }

    /// Whether the picture that the camera gives in `format` has this screen's size.
    pub(super) fn fits(&self, format: &StreamFormat) -> bool {
        let given = self.loopback.format();
        (given.width, given.height) == (format.width & !1, format.height & !1)
    }

    /// Puts the placeholder into every buffer: nothing of what the camera saw is left for who comes next.
    ///
    /// # Errors
    /// As [`FrameSink::submit`].
    pub(super) fn clear(&mut self) -> Result<(), DeviceError> {
        self.live_ns = i64::MIN;
        (0..=self.loopback.buffers()).try_for_each(|_| self.show_placeholder())
    }

    /// Once it was cleared, and until something else is sent: shows the same, as of now.
    ///
    /// # Errors
    /// As [`FrameSink::submit`].
    pub(super) fn rest(&mut self) -> Result<(), DeviceError> {
        self.loopback.renew()
    }

    fn show_placeholder(&mut self) -> Result<(), DeviceError> {
        let canvas = self.loopback.canvas()?;
        canvas.planes.into_iter().zip(self.placeholder.as_ref().planes).for_each(|(mut to, from)| to.copy_from(from));
        self.loopback.submit(&Stamp { time_ns: monotonic_ns(), ..Stamp::default() })
    }
}

impl FrameSink for Screen {
    fn format(&self) -> StreamFormat {
        self.loopback.format()
    }

    fn canvas(&mut self) -> Result<PictureMut<'_>, DeviceError> {
        self.loopback.canvas()
    }

    fn submit(&mut self, stamp: &Stamp) -> Result<(), DeviceError> {
        self.live_ns = monotonic_ns();
        self.loopback.submit(stamp)
    }

    fn submit_placeholder(&mut self, _: &Stamp) -> Result<bool, DeviceError> {
        self.show_placeholder().map(|()| true)
    }

    fn idle(&mut self) -> Result<(), DeviceError> {
        if monotonic_ns().saturating_sub(self.live_ns) < BRIDGE_NS { self.loopback.repeat() } else { self.show_placeholder() }
    }
}
