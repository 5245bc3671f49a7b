//! The devices that the supervisor opens, behind traits: real ones here, fakes in its tests.

use std::path::{Path, PathBuf};

use super::monitored_source::Camera;
use super::output::LiveOutput;
use super::viewers::ViewerStatus;
use crate::config::Settings;
use crate::control::OutputInfo;
use crate::device::v4l2::{Capture, CaptureParams};
use crate::device::{DeviceError, FrameSink, StreamFormat};
use crate::image::PixelFormat;
use crate::rt::notifier::Notifier;
use crate::share::{Companions, Inspector};

/// Opens devices.
pub(super) trait Devices: Sync {
    /// The format that a camera would have, and its node, without starting it.
    fn probe_camera(&self, params: &CaptureParams) -> Result<(StreamFormat, PathBuf), DeviceError>;

    /// Opens a camera and starts it. `wake` ends a wait for its next frame.
    fn open_camera(&self, params: &CaptureParams, wake: Notifier) -> Result<Box<dyn LiveCamera>, DeviceError>;

    /// Opens the outputs for a camera's pictures in `format`. `wake` is notified when the viewers change.
    fn open_output(
        &self,
        settings: &Settings,
        format: &StreamFormat,
        companions: Option<&Companions>,
        wake: &Notifier,
    ) -> Result<Box<dyn Output>, DeviceError>;
}

/// An open camera.
pub(super) trait LiveCamera: Camera {
    /// Its node.
    fn path(&self) -> &Path;

    /// Its name, and the bus that it is connected to.
    fn name_and_bus(&self) -> (String, String);

    /// The pixel format to try where the present one gives no usable frame.
    fn next_best(&self) -> Option<PixelFormat>;
}

/// The open outputs: a sink for pictures, and its viewers.
pub(super) trait Output: FrameSink {
    /// Who watches.
    fn viewers(&self) -> &ViewerStatus;

    /// Whether pictures that the camera gives in `format` can be shown without opening the output again.
    fn suits(&self, format: &StreamFormat) -> bool;

    /// Where the frame path gives frames to pages of `gimbald view`, if they may have them.
    fn inspector(&self) -> Option<Inspector> {
        None
    }

    /// Its names for people.
    fn name(&self) -> String;

    /// Whether there is a loopback, and not PipeWire alone.
    fn has_loopback(&self) -> bool;

    /// Puts the placeholder in place of the camera's last pictures.
    fn clear(&mut self) -> Result<(), DeviceError>;

    /// Shows the placeholder again, as of now.
    fn refresh(&mut self) -> Result<(), DeviceError>;

    /// Closes it. With `resumes`, viewers keep the last picture until the service is started again.
    fn close(self: Box<Self>, resumes: bool);

    /// What the status says of it.
    fn info(&self) -> OutputInfo {
        let format = self.format();
        OutputInfo { path: self.name(), format: format.pixel.to_string(), width: format.width, height: format.height }
    }
}

/// V4L2 cameras, v4l2loopback, PipeWire companions.
#[derive(Clone, Copy, Debug)]
pub(super) struct RealDevices;

impl Devices for RealDevices {
    fn probe_camera(&self, params: &CaptureParams) -> Result<(StreamFormat, PathBuf), DeviceError> {
        Capture::probe(params)
    }

    fn open_camera(&self, params: &CaptureParams, wake: Notifier) -> Result<Box<dyn LiveCamera>, DeviceError> {
        Ok(Box::new(Capture::open(params, wake)?))
    }

    fn open_output(
        &self,
        settings: &Settings,
        format: &StreamFormat,
        companions: Option<&Companions>,
        wake: &Notifier,
    ) -> Result<Box<dyn Output>, DeviceError> {
        Ok(Box::new(LiveOutput::open(settings, format, companions, wake)?))
    }
}

impl LiveCamera for Capture {
    fn path(&self) -> &Path {
        Capture::path(self)
    }

    fn name_and_bus(&self) -> (String, String) {
        Capture::name_and_bus(self)
    }

    fn next_best(&self) -> Option<PixelFormat> {
        Capture::next_best(self)
    }
}
