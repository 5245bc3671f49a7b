//! Executes what the [`Lifecycle`] decides: opens devices, streams, waits, and returns the outcome as the next event.

#[cfg(test)]
mod tests;

use std::time::{Duration, Instant};

use crossbeam_channel::{RecvTimeoutError, bounded};

use super::calibration_store::{CalibrationStore, CameraMode};
use super::cameras::Cameras;
use super::devices::{Devices, LiveCamera, Output};
use super::heartbeat::Heartbeat;
use super::lifecycle::{Action, Cause, Event, Lifecycle, State};
use super::monitored_source::{MonitoredSource, Notes};
use super::observers::Observers;
use super::output::SHOW_EVERY;
use super::recovery::{Recovery, RejectedFormats, Step};
use super::{companions, describe};
use crate::config::Settings;
use crate::control::{DaemonState, Phase};
use crate::device::v4l2::{CaptureParams, Hotplug, News};
use crate::device::{DeviceError, StreamFormat};
use crate::image::PixelFormat;
use crate::pipeline::{Params, run_live};
use crate::rt::clock::monotonic_ns;
use crate::rt::notifier::Notifier;
use crate::rt::stop::Stop;
use crate::share::Companions;

/// A service whose camera is absent reports READY after this long, so that nothing that waits for it (the boot) is held up.
const READY_WITHOUT_CAMERA: Duration = Duration::from_secs(20);

/// A companion that is running already has connected after this long.
const COMPANION_TIMEOUT: Duration = Duration::from_millis(1500);

/// For this long, opening a camera counts as progress for the watchdog.
const MAX_OPENING: Duration = Duration::from_secs(10);

/// Size and rate that are assumed of a camera that was never open.
const USUAL: (u32, u32, f64) = (1280, 720, 30.0);

/// What a supervisor works with.
pub(super) struct Parts<'a> {
    pub(super) devices: &'a dyn Devices,
    pub(super) settings: &'a Settings,
    pub(super) state: &'a DaemonState,
    pub(super) stop: &'a Stop,
    /// Notified when the viewers or `stop` changed.
    pub(super) wake: &'a Notifier,
    pub(super) heartbeat: &'a Heartbeat<'a>,
    pub(super) store: &'a CalibrationStore,
    pub(super) cameras: &'a Cameras,
    /// The PipeWire companions, where they are enabled.
    pub(super) companions: Option<&'a Companions>,
    pub(super) hotplug: Option<Hotplug>,
    /// Managed by systemd: what does not work is waited for from the start.
    pub(super) is_service: bool,
}

/// Runs the service.
pub(super) struct Supervisor<'a> {
    parts: Parts<'a>,
    lifecycle: Lifecycle,
    started: Instant,
    /// Opened first and kept: its viewers never lose it.
    output: Option<Box<dyn Output>>,
    /// The format of the last camera, until an idle output has been compared with it.
    last_format: Option<StreamFormat>,
    /// Opened, and not yet streaming.
    camera: Option<Box<dyn LiveCamera>>,
    /// Of the last failure.
    error: Option<DeviceError>,
    /// What was logged last of waiting, so that it is logged once.
    logged: String,
    recovery: Recovery,
    rejected: RejectedFormats,
    /// Times a camera was opened.
    cameras_opened: u64,
}

impl<'a> Supervisor<'a> {
    /// A supervisor that has opened nothing yet.
    pub(super) fn new(parts: Parts<'a>) -> Self {
        Self {
            lifecycle: Lifecycle::new(parts.is_service),
            parts,
            started: Instant::now(),
            output: None,
            last_format: None,
            camera: None,
            error: None,
            logged: String::new(),
            recovery: Recovery::new(),
            rejected: RejectedFormats::default(),
            cameras_opened: 0,
        }
    }

    /// Runs until the stop flag is set.
    ///
    /// # Errors
    /// The failure that waiting cannot help against.
    pub(super) fn run(&mut self) -> Result<(), DeviceError> {
        let mut action = Action::OpenOutput;
        loop {
            let event = match action {
                Action::Stop => return Ok(()),
                Action::Fail => return self.error.take().map_or(Ok(()), Err),
                _ if self.parts.stop.is_set() => Event::StopRequested,
                Action::OpenOutput => self.open_output(),
                Action::Idle => self.idle(),
                Action::OpenCamera => self.open_camera(),
                Action::Stream => self.stream(),
                Action::Wait(pause) => self.wait(pause),
            };
            action = self.lifecycle.handle(event, self.is_camera_wanted());
        }
    }

    /// Closes the output; returns how many times a camera was opened. Viewers of a service keep the picture until its next start.
    pub(super) fn close(self) -> u64 {
        if let Some(output) = self.output {
            output.close(self.parts.is_service);
        }
        self.cameras_opened
    }

    /// Whether the camera should be open.
    fn is_camera_wanted(&self) -> bool {
        !self.parts.settings.output.on_demand || self.output.as_ref().is_some_and(|output| output.viewers().wants_camera())
    }

    fn camera_failed(&mut self, error: DeviceError) -> Event {
        let cause = Cause::from(&error);
        self.error = Some(error);
        Event::CameraFailed(cause)
    }

    fn output_failed(&mut self, error: DeviceError) -> Event {
        let cause = Cause::from(&error);
        self.error = Some(error);
        self.output = None;
        self.parts.state.metrics.clear_output();
        Event::OutputFailed(cause)
    }

    /// Opens the output in the size that the camera would have, or in the likeliest where the camera cannot be asked.
    fn open_output(&mut self) -> Event {
        self.output = None;
        let Parts { devices, settings, cameras, companions, .. } = self.parts;
        let format = match self.camera_params().and_then(|params| devices.probe_camera(&params)) {
            Ok((format, path)) => {
                cameras.opened(&path);
                format
            }
            Err(error) if self.lifecycle.gives_up_camera(Cause::from(&error)) => return self.camera_failed(error),
            Err(_) => self.likely_format(),
        };
        if let (Some(companions), Some(camera)) = (companions, companions::locate(settings, cameras)) {
            companions.camera_is(&camera);
        }
        match self.open_output_for(&format) {
            Ok(()) => Event::OutputOpened,
            Err(error) if self.await_companion(&error) => Event::CompanionConnected,
            Err(error) => self.output_failed(error),
        }
    }

    fn open_output_for(&mut self, format: &StreamFormat) -> Result<(), DeviceError> {
        let Parts { devices, settings, companions, wake, state, .. } = self.parts;
        let output = devices.open_output(settings, format, companions, wake)?;
        let viewers = output.viewers().clone();
        let count: Box<dyn Fn() -> u32 + Send> = Box::new(move || viewers.at_loopback());
        state.metrics.set_output(output.info(), output.has_loopback().then_some(count));
        self.output = Some(output);
        Ok(())
    }

    /// At the start, where there is no loopback and this is no service: gives a companion, which needs none, a moment to connect.
    /// Returns whether one did.
    fn await_companion(&self, error: &DeviceError) -> bool {
        let is_early = || !self.parts.is_service && self.started.elapsed() < COMPANION_TIMEOUT;
        let Some(companions) = self.parts.companions.filter(|_| is_early()) else { return false };
        if companions.connected() == 0 {
            tracing::info!("{error}; or run `gimbald pipewire` in your session, which needs no loopback");
        }
        while !self.parts.stop.is_set() && is_early() && companions.connected() == 0 {
            self.parts.wake.wait(Duration::from_millis(20));
        }
        companions.connected() > 0
    }

    /// The format of a camera that cannot be asked: as configured, else as it was last time.
    fn likely_format(&self) -> StreamFormat {
        let (width, height, fps) = self.parts.store.latest().unwrap_or(USUAL);
        let asked = &self.parts.settings.camera;
        let (width, height) = if asked.width > 0 && asked.height > 0 { (asked.width, asked.height) } else { (width, height) };
        let fps = if asked.fps > 0.0 { asked.fps } else { fps };
        let interval = if fps > 0.0 { (100, (100.0 * fps).round() as u32) } else { (1, 30) };
        StreamFormat::tight(width, height, PixelFormat::Yuyv, interval)
    }

    /// What to ask for: the camera of the settings, and once it was open, that one.
    fn camera_params(&self) -> Result<CaptureParams, DeviceError> {
        let asked = CaptureParams { avoid: self.rejected.avoided(), ..self.parts.settings.camera.params() };
        self.parts.cameras.params(asked)
    }

    /// Opens the camera, and the output again where it does not suit the camera's pictures.
    fn open_camera(&mut self) -> Event {
        let camera = match self.camera_params().and_then(|params| self.open_in_thread(&params)) {
            Ok(camera) => camera,
            // The output failed meanwhile.
            Err(_) if self.output.is_none() => return Event::OutputFailed(Cause::Unavailable),
            Err(error) => {
                // The format that was to be tried in place of a rejected one may not exist.
                if matches!(error, DeviceError::Unsupported { .. }) && self.rejected.try_all_again() {
                    tracing::warn!("trying all formats again: {error}");
                    self.recovery.goes_round();
                }
                return self.camera_failed(error);
            }
        };
        self.cameras_opened += 1;
        self.parts.cameras.opened(camera.path());
        if let Some(companions) = self.parts.companions {
            companions.camera_is(camera.path());
        }
        let format = camera.format();
        self.last_format = Some(format);
        if self.output.as_ref().is_none_or(|output| !output.suits(&format)) {
            // The old one first: the loopback takes one writer.
            self.output = None;
            if let Err(error) = self.open_output_for(&format) {
                return self.output_failed(error);
            }
        }
        self.camera = Some(camera);
        Event::CameraOpened
    }

    /// Opens the camera, which may take its time, in a thread of its own; viewers get their pictures meanwhile.
    fn open_in_thread(&mut self, params: &CaptureParams) -> Result<Box<dyn LiveCamera>, DeviceError> {
        let (devices, wake, started) = (self.parts.devices, self.parts.wake.clone(), Instant::now());
        let (done, opened) = bounded(1);
        std::thread::scope(|scope| {
            let open = move || {
                let _ = done.send(devices.open_camera(params, wake));
            };
            super::spawn(scope, "opening", open)?;
            loop {
                if started.elapsed() < MAX_OPENING {
                    self.parts.heartbeat.beat();
                }
                if let Some(output) = &mut self.output
                    && let Err(error) = output.idle()
                {
                    let unusable = std::io::ErrorKind::Other.into();
                    self.output_failed(error);
                    return Err(DeviceError::io("output", "show", unusable));
                }
                match opened.recv_timeout(SHOW_EVERY) {
                    Ok(camera) => return camera,
                    Err(RecvTimeoutError::Timeout) => {}
                    Err(RecvTimeoutError::Disconnected) => {
                        return Err(DeviceError::io("camera", "open", std::io::ErrorKind::Other.into()));
                    }
                }
            }
        })
    }

    /// Streams until something ends it.
    fn stream(&mut self) -> Event {
        let (Some(mut camera), Some(output)) = (self.camera.take(), self.output.as_mut()) else { return Event::StreamEnded };
        let Parts { settings, state, stop, heartbeat, store, .. } = self.parts;
        let activity = describe::stream_started(&*camera, &**output);
        heartbeat.set_activity(activity.clone(), Phase::Streaming);
        let prior = store.begin(CameraMode::of(&*camera), settings.pipeline.camera);
        let params = Params { camera: prior, ..state.live.params() };
        state.metrics.set_camera(describe::camera_info(&*camera));
        let (name, pixel, next_best) = (camera.name_and_bus(), camera.format().pixel, camera.next_best());
        self.recovery.begin(monotonic_ns(), next_best.is_some(), self.rejected.any(&name));
        let sent_before = state.metrics.frames_sent().0;
        let viewers = settings.output.on_demand.then(|| output.viewers().clone());
        let mut source = MonitoredSource {
            camera: &mut *camera,
            heartbeat,
            what: activity,
            viewers,
            recovery: &mut self.recovery,
            notes: Notes::default(),
            clock: monotonic_ns,
            failed: false,
            step: Step::GoOn,
        };
        let mut observer = Observers { heartbeat, inspector: output.inspector() };
        let ran = run_live(&mut source, &mut **output, &params, &state.live, stop, &mut observer);
        let (failed, step) = (source.failed, source.step);
        drop(camera);
        store.end(state.metrics.calibration().as_ref());
        state.metrics.clear_camera();
        if state.metrics.frames_sent().0 > sent_before {
            self.lifecycle.delivered();
        }
        if self.recovery.works() {
            self.rejected.forget(&name.0, &name.1, pixel);
        }
        match ran {
            Ok(totals) => {
                tracing::info!("stream ended: {}", describe::totals(&totals));
                self.choose_format(step, &name, pixel, next_best);
                Event::StreamEnded
            }
            Err(error) if failed => {
                self.recovery = Recovery::new();
                self.camera_failed(error)
            }
            Err(error) => self.output_failed(error),
        }
    }

    /// After a stream of the camera of this `name` in the format `pixel` ended for `step`: which formats the next one may have.
    fn choose_format(&mut self, step: Step, name: &(String, String), pixel: PixelFormat, next_best: Option<PixelFormat>) {
        let why = || {
            let (frames, reasons) = self.parts.heartbeat.stream();
            reasons.in_words(frames).unwrap_or_else(|| "no frames received".into())
        };
        match (step, next_best) {
            (Step::NextFormat, Some(next)) => {
                let why = why();
                tracing::warn!(camera = %name.0, "no usable frames in {pixel}: trying {next} instead ({why})");
                self.rejected.leave(name, pixel, why);
            }
            (Step::FirstFormat, _) => {
                let why = why();
                tracing::warn!(camera = %name.0, "no usable frames in {pixel} either: trying all formats again ({why})");
                self.rejected.leave(name, pixel, why);
                self.rejected.try_again(name);
            }
            _ => self.recovery = Recovery::new(),
        }
        self.parts.state.metrics.set_rejected_formats(self.rejected.for_status());
    }

    /// The camera is closed: waits for viewers.
    fn idle(&mut self) -> Event {
        let Some(output) = &mut self.output else { return Event::DevicesChanged };
        if self.last_format.take().is_some_and(|format| !output.suits(&format)) {
            // The programs that kept it in another camera's size have left.
            return Event::DevicesChanged;
        }
        if let Err(error) = output.clear() {
            return self.output_failed(error);
        }
        let name = output.name();
        tracing::info!(output = %name, "no viewers: camera closed");
        self.parts.heartbeat.set_activity(format!("no viewers at {name}, camera closed"), Phase::Idle);
        self.parts.state.ready();
        while !self.parts.stop.is_set() {
            if self.is_camera_wanted() {
                return Event::ViewersArrived;
            }
            let Some(output) = &mut self.output else { return Event::DevicesChanged };
            // Programs that only probe the device get a picture as well, and none gets an old one.
            if let Err(error) = output.refresh() {
                return self.output_failed(error);
            }
            match &self.parts.hotplug {
                Some(hotplug) if !output.has_loopback() => {
                    // It may be the loopback that appeared.
                    if hotplug.wait(self.parts.wake, SHOW_EVERY) == News::Devices {
                        self.parts.wake.wait(Duration::from_millis(100));
                        return Event::DevicesChanged;
                    }
                }
                _ => drop(self.parts.wake.wait(SHOW_EVERY)),
            }
            self.parts.heartbeat.beat();
        }
        Event::StopRequested
    }

    /// Waits before the next attempt, unless something happens before.
    fn wait(&mut self, pause: Duration) -> Event {
        self.report_waiting();
        let due = Instant::now() + pause;
        let companions = self.parts.companions;
        let connected = || companions.map_or(0, Companions::connected);
        let before = connected();
        while !self.parts.stop.is_set() {
            let left = due.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Event::RetryDue;
            }
            let news = match &self.parts.hotplug {
                Some(hotplug) => hotplug.wait(self.parts.wake, left.min(SHOW_EVERY)),
                None if self.parts.wake.wait(left.min(SHOW_EVERY)) => News::Notified,
                None => News::Nothing,
            };
            self.parts.heartbeat.beat();
            if let Some(output) = &mut self.output {
                // An output that fails here fails again when it is needed, and is handled then.
                let _ = output.idle();
            }
            // A companion connects when a user logs in, which may be never: a service without a loopback is ready for one.
            let awaits_companion = self.output.is_none() && companions.is_some();
            if awaits_companion || self.started.elapsed() > READY_WITHOUT_CAMERA {
                self.parts.state.ready();
            }
            if self.output.is_none() && connected() > before {
                return Event::CompanionConnected;
            }
            if news == News::Devices {
                return Event::DevicesChanged;
            }
            if self.parts.settings.output.on_demand && self.output.is_some() && !self.is_camera_wanted() {
                return Event::ViewersLeft;
            }
        }
        Event::StopRequested
    }

    /// Shows what is waited for in the status; logs it once, not with each attempt.
    fn report_waiting(&mut self) {
        let what = match (self.lifecycle.state(), self.parts.companions) {
            (State::WaitingForOutput, Some(_)) => "loopback, or for a PipeWire companion (`gimbald pipewire`)",
            (State::WaitingForOutput, None) => "loopback",
            _ => "camera",
        };
        let error = self.error.as_ref().map(ToString::to_string).unwrap_or_default();
        let text = format!("waiting for the {what}: {error}");
        self.parts.heartbeat.set_activity(text.clone(), Phase::Waiting);
        if text != self.logged {
            tracing::warn!("{text}");
            self.logged = text;
        }
    }
}
