//! The outputs: loopback, PipeWire companions, or both; and the placeholder while there is no picture from a camera.

use std::time::Duration;

use super::devices::Output;
use super::viewers::{ViewerMonitor, ViewerStatus};
use crate::config::Settings;
use crate::control::OutputInfo;
use crate::device::v4l2::{Loopback, LoopbackParams};
use crate::device::{DeviceError, FrameSink, StreamFormat, placeholder};
use crate::frame::Stamp;
use crate::image::{Picture, PictureMut, Sampling};
use crate::rt::clock::monotonic_ns;
use crate::rt::notifier::Notifier;
use crate::share::{Companions, Inspector, Outlet, PIXEL};

/// How often readers get a picture while the camera gives none. Browsers give a camera up after some ten seconds without.
pub(super) const SHOW_EVERY: Duration = Duration::from_millis(500);

/// For this long after the last picture (nanoseconds) it is shown again: most faults are over before.
const BRIDGE_NS: i64 = 1_000_000_000;

/// The outputs, and who watches them.
#[derive(Debug)]
pub(super) struct LiveOutput {
    // Before the loopback: its thread listens there.
    viewer_monitor: ViewerMonitor,
    /// `None` where there is none and PipeWire does without.
    loopback: Option<Loopback>,
    companions: Option<(Companions, Outlet)>,
    format: StreamFormat,
    /// Drawn into where there is no loopback.
    canvas: Picture,
    placeholder: Picture,
    /// When the camera's last picture was sent.
    live_ns: i64,
}

impl LiveOutput {
    /// Opens the loopback in `format`'s size (even), rate and colours; in the size that a node's readers hold where they do. A reader of
    /// the process before keeps its last picture for a moment. Where the loopback cannot be opened, PipeWire is the only output: if companions
    /// are connected, or if `output.pipewire = true` says that they will be.
    ///
    /// # Errors
    /// As [`Loopback::open`].
    pub(super) fn open(
        settings: &Settings,
        format: &StreamFormat,
        companions: Option<&Companions>,
        wake: &Notifier,
    ) -> Result<Self, DeviceError> {
        let (width, height) = size_for(format, companions);
        let expected = settings.output.pipewire == Some(true);
        let params = LoopbackParams {
            device: settings.output.device.clone(),
            pixel: settings.output.format,
            width,
            height,
            interval: format.interval,
            colour: format.planar().colour,
            buffers: 4,
            create: settings.output.create,
        };
        let loopback = match Loopback::open(&params) {
            Ok(loopback) => Some(loopback),
            Err(error) if companions.is_some_and(|companions| companions.connected() > 0 || expected) => {
                tracing::info!("PipeWire is the only output: {error}");
                None
            }
            Err(error) => return Err(error),
        };
        let alone = StreamFormat { colour: params.colour, ..StreamFormat::tight(width, height, PIXEL, format.interval) };
        let given = loopback.as_ref().map_or(alone, FrameSink::format);
        let picture = || Picture::new(Sampling::S420, given.width as usize, given.height as usize);
        let mut placeholder = picture();
        placeholder::draw(&mut placeholder.as_mut());
        let canvas = if loopback.is_none() { picture() } else { Picture::default() };
        let linger = Duration::try_from_secs_f64(settings.output.linger_s).unwrap_or_default();
        let viewer_monitor = ViewerMonitor::follow(loopback.as_ref().map(Loopback::path), companions, linger, wake)?;
        let companions = companions.map(|companions| (companions.clone(), companions.outlet(&given)));
        Ok(Self { viewer_monitor, loopback, companions, format: given, canvas, placeholder, live_ns: monotonic_ns() })
    }

    /// Companions show their own, the same.
    fn show_placeholder(&mut self) -> Result<(), DeviceError> {
        let Some(loopback) = &mut self.loopback else { return Ok(()) };
        let canvas = loopback.canvas()?;
        canvas.planes.into_iter().zip(self.placeholder.as_ref().planes).for_each(|(mut to, from)| to.copy_from(from));
        loopback.submit(&Stamp { time_ns: monotonic_ns(), ..Stamp::default() })
    }
}

impl FrameSink for LiveOutput {
    fn format(&self) -> StreamFormat {
        self.format
    }

    fn canvas(&mut self) -> Result<PictureMut<'_>, DeviceError> {
        match &mut self.loopback {
            Some(loopback) => loopback.canvas(),
            None => Ok(self.canvas.as_mut()),
        }
    }

    fn submit(&mut self, stamp: &Stamp) -> Result<(), DeviceError> {
        self.live_ns = monotonic_ns();
        if let Some((_, outlet)) = &mut self.companions
            && outlet.is_wanted()
        {
            let drawn = self.loopback.as_ref().map_or_else(|| Some(self.canvas.as_ref()), Loopback::drawn);
            if let Some(drawn) = drawn {
                outlet.send(drawn, stamp);
            }
        }
        self.loopback.as_mut().map_or(Ok(()), |loopback| loopback.submit(stamp))
    }

    fn submit_placeholder(&mut self, _: &Stamp) -> Result<bool, DeviceError> {
        self.show_placeholder().map(|()| true)
    }

    fn idle(&mut self) -> Result<(), DeviceError> {
        if monotonic_ns().saturating_sub(self.live_ns) >= BRIDGE_NS {
            return self.show_placeholder();
        }
        self.loopback.as_mut().map_or(Ok(()), Loopback::repeat)
    }
}

impl Output for LiveOutput {
    fn viewers(&self) -> &ViewerStatus {
        self.viewer_monitor.status()
    }

    /// Its size is the camera's, or viewers hold it.
    fn suits(&self, format: &StreamFormat) -> bool {
        let companions = self.companions.as_ref().map(|(companions, _)| companions);
        let wanted = size_for(format, companions);
        let held = companions.is_some_and(|companions| companions.held_size() == Some((self.format.width, self.format.height)));
        (self.format.width, self.format.height) == wanted || held || self.viewers().at_loopback() > 0
    }

    fn name(&self) -> String {
        match (&self.loopback, &self.companions) {
            (Some(loopback), Some((companions, _))) if companions.connected() > 0 => {
                format!("{} and PipeWire", loopback.path().display())
            }
            (Some(loopback), _) => loopback.path().display().to_string(),
            (None, _) => "PipeWire".into(),
        }
    }

    fn inspector(&self) -> Option<Inspector> {
        self.companions.as_ref().map(|(companions, _)| companions.inspector(&self.format))
    }

    fn has_loopback(&self) -> bool {
        self.loopback.is_some()
    }

    /// Every buffer gets the placeholder: nothing of what the camera saw is left for the next viewer.
    fn clear(&mut self) -> Result<(), DeviceError> {
        self.live_ns = i64::MIN;
        let buffers = self.loopback.as_ref().map_or(0, Loopback::buffers);
        (0..=buffers).try_for_each(|_| self.show_placeholder())
    }

    fn refresh(&mut self) -> Result<(), DeviceError> {
        self.loopback.as_mut().map_or(Ok(()), Loopback::renew)
    }

    fn close(mut self: Box<Self>, resumes: bool) {
        match &mut self.loopback {
            Some(loopback) if resumes && self.viewer_monitor.status().at_loopback() > 0 => loopback.hand_over(),
            // What is left behind in the device is not what the camera saw.
            _ => drop(self.clear()),
        }
    }

    fn info(&self) -> OutputInfo {
        let StreamFormat { pixel, width, height, .. } = self.format;
        let path = self.loopback.as_ref().map_or_else(|| self.name(), |loopback| loopback.path().display().to_string());
        OutputInfo { path, format: pixel.to_string(), width, height }
    }
}

/// The size of the picture: what a node's readers hold, else the camera's, made even.
fn size_for(format: &StreamFormat, companions: Option<&Companions>) -> (u32, u32) {
    companions.and_then(Companions::held_size).unwrap_or((format.width & !1, format.height & !1))
}
