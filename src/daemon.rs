//! A life: devices, pipeline, READY, watch; the camera goes and comes back; STOPPING, and an end that leaves both devices usable.

mod calibration_store;
mod cameras;
mod companions;
mod demand;
mod heartbeat;
mod monitored_source;
mod output;
mod recovery;
mod viewers;
mod words;

use std::sync::Arc;
use std::time::{Duration, Instant};

use crossbeam_channel::{RecvTimeoutError, bounded};

use crate::config::Settings;
use crate::control::{DaemonState, Phase, Server};
use crate::device::v4l2::{Capture, CaptureParams, Hotplug, News};
use crate::device::{DeviceError, FrameSink, FrameSource, StreamFormat};
use crate::image::PixelFormat;
use crate::pipeline::{Params, run_live};
use crate::rt::clock::monotonic_ns;
use crate::rt::notifier::Notifier;
use crate::rt::stop::Stop;
use crate::share::{self, Companions};
use crate::systemd::Systemd;
#[cfg(feature = "fuzzing")]
#[doc(hidden)]
pub use calibration_store::fuzz as fuzz_calibration_store;
use calibration_store::{CalibrationStore, CameraMode};
use cameras::Cameras;
use heartbeat::{Heartbeat, run_watchdog};
use monitored_source::{MonitoredSource, Notes};
use output::{LiveOutput, SHOW_EVERY};
use recovery::{Recovery, RejectedFormats, Step};
use words::{camera_now, in_words, tell_of, tell_of_companions, told_stream};

/// From the first try again to the slowest.
const BACKOFF: (Duration, Duration) = (Duration::from_millis(100), Duration::from_secs(5));

/// The slowest against a camera that another program has: nothing tells when it is given back.
const BUSY: Duration = Duration::from_millis(300);

/// A service whose camera is not there is ready too, after this long: nothing that waits for it (the boot) is held up.
const READY_WITHOUT_CAMERA: Duration = Duration::from_secs(20);

/// A companion that runs already has connected after this long.
const FOR_COMPANIONS: Duration = Duration::from_millis(1500);

/// A device that came is tried after this long: udev gives it its links and permissions.
const SETTLED: Duration = Duration::from_millis(100);

/// A camera that takes longer than this to open is no sign of life.
const LONGEST_OPENING: Duration = Duration::from_secs(10);

/// Size and rate of a camera that was never seen.
const USUAL: (u32, u32, f64) = (1280, 720, 30.0);

/// What came of a life.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ExitReport {
    /// Frames sent.
    pub frames: u64,
    /// Of these, stabilized.
    pub stabilized: u64,
    /// Times the camera was opened.
    pub cameras: u64,
}

/// Stabilizes the camera's picture into the loopback, and for PipeWire companions, until `stop` is set (and `wake` notified, so that it is
/// seen at once).
///
/// The camera is open while somebody watches either (or always, if the settings say so). One that is absent, busy or goes away
/// is waited for; the loopback stays open meanwhile and shows a placeholder. A loopback that goes away is waited for as well, unless a
/// companion is connected, which needs none.
///
/// # Errors
/// Where the loopback or the camera cannot do what is configured from the beginning and nobody manages this as a service: a
/// service waits, and says for what.
pub fn run(state: &Arc<DaemonState>, stop: &Stop, wake: &Notifier) -> Result<ExitReport, DeviceError> {
    let systemd = Systemd::from_env();
    let settings = &state.settings();
    let heartbeat = Heartbeat::new(systemd, state);
    let store = CalibrationStore::open(Systemd::state_directory().as_deref());
    let done = Notifier::new().map_err(|error| DeviceError::io("eventfd", "create", error))?;
    let server = Server::open(&settings.control, Systemd::runtime_directory());
    let pictures = companions::open(settings);
    let served = Notifier::new().map_err(|error| DeviceError::io("eventfd", "create", error))?;
    let answered = Notifier::new().map_err(|error| DeviceError::io("eventfd", "create", error))?;
    let watched = Notifier::new().map_err(|error| DeviceError::io("eventfd", "create", error))?;
    let cameras = Cameras::default();
    std::thread::scope(|scope| {
        // Rings when this scope's own work ends, be it by a panic: the scope waits for its thread.
        let _done = NotifyOnDrop(&done);
        if systemd.listens() || store.is_enabled() {
            let attending = std::thread::Builder::new()
                .name("watchdog".into())
                .spawn_scoped(scope, || run_watchdog(&heartbeat, &store, &done));
            attending.map_err(|error| DeviceError::io("watchdog thread", "start", error))?;
        }
        let _answered = NotifyOnDrop(&answered);
        if let Some(server) = &server {
            let serving = || server.serve(state, &answered);
            let serving = std::thread::Builder::new().name("control".into()).spawn_scoped(scope, serving);
            serving.map_err(|error| DeviceError::io("control thread", "start", error))?;
        }
        let listen = || Hotplug::new().inspect_err(|error| tracing::warn!(%error, "devices that come are seen later")).ok();
        let hotplug = listen();
        let _watched = NotifyOnDrop(&watched);
        if let Some(plugs) = listen() {
            let (cameras, watched) = (&cameras, &watched);
            let watching = move || cameras.watch(&plugs, watched);
            let watching = std::thread::Builder::new().name("cameras".into()).spawn_scoped(scope, watching);
            watching.map_err(|error| DeviceError::io("cameras thread", "start", error))?;
        }
        let _served = NotifyOnDrop(&served);
        if let Some(pictures) = &pictures {
            tell_of_companions(pictures.companions(), state);
            let serving = || pictures.serve(&served, &|| companions::locate(settings, &cameras));
            let serving = std::thread::Builder::new().name("pictures".into()).spawn_scoped(scope, serving);
            serving.map_err(|error| DeviceError::io("pictures thread", "start", error))?;
        }
        let mut supervisor = Supervisor {
            settings,
            state,
            stop,
            wake,
            heartbeat: &heartbeat,
            store: &store,
            companions: pictures.as_ref().map(share::Server::companions),
            hotplug,
            patient: systemd.listens(),
            born: Instant::now(),
            output: None,
            cameras: &cameras,
            backoff: Backoff::default(),
            recovery: Recovery::new(),
            formats_left: RejectedFormats::default(),
            report: ExitReport::default(),
            latest: None,
        };
        let ended = supervisor.run();
        state.metrics.set_phase(Phase::Stopping, "stopping");
        systemd.stopping();
        supervisor.leave();
        let (frames, stabilized) = heartbeat.sent();
        ended.map(|()| ExitReport { frames, stabilized, ..supervisor.report })
    })
}

struct NotifyOnDrop<'a>(&'a Notifier);

impl Drop for NotifyOnDrop<'_> {
    fn drop(&mut self) {
        self.0.notify();
    }
}

/// Why the pipeline does not run.
enum StreamEnd {
    /// Nobody wants it to, for now or for good.
    NoViewers,
    /// The camera is not there now.
    CameraUnavailable(DeviceError),
    /// The loopback is not there now.
    OutputUnavailable(DeviceError),
    /// What it needs will not come by waiting.
    Failed(DeviceError),
}

struct Supervisor<'a> {
    settings: &'a Settings,
    state: &'a DaemonState,
    stop: &'a Stop,
    wake: &'a Notifier,
    heartbeat: &'a Heartbeat<'a>,
    store: &'a CalibrationStore,
    /// Those who take the picture to PipeWire, where they may.
    companions: Option<&'a Companions>,
    hotplug: Option<Hotplug>,
    /// Nobody sits by: what does not work is waited for from the beginning.
    patient: bool,
    born: Instant,
    /// Opened first and kept: who watches it never loses it.
    output: Option<LiveOutput>,
    cameras: &'a Cameras,
    backoff: Backoff,
    /// What is done where the camera's frames cannot be used, and the formats that were left for that.
    recovery: Recovery,
    formats_left: RejectedFormats,
    report: ExitReport,
    /// The format of the last stream, until the output has its size.
    latest: Option<StreamFormat>,
}

/// How long to wait for what is not there, and what was said of it.
#[derive(Debug)]
struct Backoff {
    pause: Duration,
    told: String,
}

impl Default for Backoff {
    fn default() -> Self {
        Self { pause: BACKOFF.0, told: String::new() }
    }
}

impl Supervisor<'_> {
    fn run(&mut self) -> Result<(), DeviceError> {
        while !self.stop.is_set() {
            let sent = self.heartbeat.sent().0;
            let ended = self.go_on();
            if self.heartbeat.sent().0 > sent {
                self.backoff = Backoff::default();
            }
            match ended {
                StreamEnd::NoViewers => {}
                StreamEnd::Failed(error) => return Err(error),
                StreamEnd::CameraUnavailable(error) => {
                    if matches!(error, DeviceError::Busy { .. }) {
                        self.backoff.pause = self.backoff.pause.min(BUSY);
                    }
                    self.tell(format!("waiting for the camera: {error}"));
                    self.wait();
                }
                StreamEnd::OutputUnavailable(error) => {
                    self.output = None;
                    self.state.metrics.clear_output();
                    let or = if self.companions.is_some() { ", or for a PipeWire companion (gimbald pipewire)" } else { "" };
                    self.tell(format!("waiting for the loopback{or}: {error}"));
                    self.wait();
                }
            }
        }
        Ok(())
    }

    /// Opens what is missing and streams, or rests, until something ends it.
    fn go_on(&mut self) -> StreamEnd {
        let output = self.output.as_ref();
        let kept = |format: &mut StreamFormat| output.is_some_and(|output| !output.suits(format));
        if !self.is_wanted() && self.latest.take_if(kept).is_some() {
            // Programs that held the size of another camera have left.
            self.output = None;
        }
        if self.output.is_none()
            && let Some(ended) = self.open_output()
        {
            return ended;
        }
        if self.is_wanted() { self.stream() } else { self.rest() }
    }

    /// Opens the loopback in the size that the camera would have, or in the likeliest where it cannot be asked. `None`: it is open.
    fn open_output(&mut self) -> Option<StreamEnd> {
        let probed = self.camera_params().and_then(|params| Capture::probe(&params));
        let format = match probed {
            Ok((format, path)) => {
                self.cameras.opened(&path);
                format
            }
            Err(error) => match self.classify_camera_error(error) {
                StreamEnd::Failed(error) => return Some(StreamEnd::Failed(error)),
                _ => self.likely_format(),
            },
        };
        if let (Some(companions), Some(camera)) = (self.companions, companions::locate(self.settings, self.cameras)) {
            companions.camera_is(&camera);
        }
        match LiveOutput::open(self.settings, &format, self.companions, self.wake) {
            Ok(output) => {
                tell_of(&output, self.state);
                self.output = Some(output);
                None
            }
            Err(error) if self.await_companion(&error) => Some(StreamEnd::NoViewers),
            Err(error) => Some(self.classify_output_error(error)),
        }
    }

    /// At the beginning, where there is no loopback and nobody manages this as a service: gives a companion, which needs none, a moment
    /// to connect. Says whether one did.
    fn await_companion(&mut self, error: &DeviceError) -> bool {
        let Some(companions) = self.companions.filter(|_| !self.patient && self.born.elapsed() < FOR_COMPANIONS) else {
            return false;
        };
        if companions.connected() == 0 {
            tracing::info!("{error}; or run gimbald pipewire in your session, which needs no loopback");
        }
        while !self.stop.is_set() && self.born.elapsed() < FOR_COMPANIONS && companions.connected() == 0 {
            self.wake.wait(Duration::from_millis(20));
        }
        companions.connected() > 0
    }

    /// The format of a camera that cannot be asked: as configured, else as it was last time.
    fn likely_format(&self) -> StreamFormat {
        let (width, height, fps) = self.store.latest().unwrap_or(USUAL);
        let asked = &self.settings.camera;
        let (width, height) = if asked.width > 0 && asked.height > 0 { (asked.width, asked.height) } else { (width, height) };
        let fps = if asked.fps > 0.0 { asked.fps } else { fps };
        let interval = if fps > 0.0 { (100, (100.0 * fps).round() as u32) } else { (1, 30) };
        StreamFormat::tight(width, height, PixelFormat::Yuyv, interval)
    }

    /// What to ask for: the camera of the settings, and once it was open, that one.
    fn camera_params(&self) -> Result<CaptureParams, DeviceError> {
        let asked = CaptureParams { avoid: self.formats_left.avoided(), ..self.settings.camera.params() };
        self.cameras.params(asked)
    }

    /// Whether the camera should be open.
    fn is_wanted(&self) -> bool {
        !self.settings.output.on_demand
            || self.output.as_ref().is_some_and(|output| output.viewer_monitor.status().wants_camera())
    }

    /// Streams until something ends it.
    fn stream(&mut self) -> StreamEnd {
        let camera = match self.open_camera() {
            Ok(camera) => camera,
            Err(ended) => return ended,
        };
        self.report.cameras += 1;
        self.cameras.opened(camera.path());
        let format = camera.format();
        self.latest = Some(format);
        if let Some(companions) = self.companions {
            companions.camera_is(camera.path());
        }
        if self.output.as_ref().is_some_and(|output| !output.suits(&format)) {
            // Nobody minds.
            self.output = None;
        }
        let output = match &mut self.output {
            Some(output) => output,
            none => match LiveOutput::open(self.settings, &format, self.companions, self.wake) {
                Ok(output) => {
                    tell_of(&output, self.state);
                    none.insert(output)
                }
                Err(error) => return self.classify_output_error(error),
            },
        };
        let what = told_stream(&camera, output);
        self.heartbeat.set_activity(what.clone(), Phase::Streaming);
        self.carry(camera, what)
    }

    /// Carries the camera's frames to the output, which is open.
    fn carry(&mut self, mut camera: Capture, what: String) -> StreamEnd {
        let Some(output) = &mut self.output else { return StreamEnd::NoViewers };
        let known = self.store.begin(CameraMode::of(&camera), self.settings.pipeline.camera);
        let params = Params { camera: known, ..self.state.live.params() };
        self.state.metrics.set_camera(camera_now(&camera));
        let mut observer = self.heartbeat;
        let viewers = self.settings.output.on_demand.then(|| output.viewer_monitor.status().clone());
        let (name, pixel, next_best) = (camera.name_and_bus(), camera.format().pixel, camera.next_best());
        self.recovery.begin(monotonic_ns(), next_best.is_some(), self.formats_left.any(&name));
        let mut monitored_source = MonitoredSource {
            camera: &mut camera,
            heartbeat: self.heartbeat,
            what,
            viewers,
            recovery: &mut self.recovery,
            notes: Notes::default(),
            clock: monotonic_ns,
            failed: false,
            step: Step::GoOn,
        };
        let ran = run_live(&mut monitored_source, output, &params, &self.state.live, self.stop, &mut observer);
        let (failed, step) = (monitored_source.failed, monitored_source.step);
        self.state.metrics.clear_camera();
        self.store.end(&self.heartbeat.take_calibration());
        drop(camera);
        if self.recovery.works() {
            self.formats_left.forget(&name.0, &name.1, pixel);
        }
        match ran {
            Ok(totals) => {
                tracing::info!("the stream ended: {}", in_words(&totals));
                self.choose_format(step, &name, pixel, next_best);
                StreamEnd::NoViewers
            }
            Err(error) if failed => {
                self.recovery = Recovery::new();
                self.classify_camera_error(error)
            }
            Err(error) => StreamEnd::OutputUnavailable(error),
        }
    }

    /// After a stream of the camera of this `name` in the format `pixel` ended for `step`: which formats the next one may have.
    fn choose_format(&mut self, step: Step, name: &(String, String), pixel: PixelFormat, next_best: Option<PixelFormat>) {
        let why = || {
            let (frames, reasons) = self.heartbeat.stream();
            reasons.in_words(frames).unwrap_or_else(|| "no frame came".into())
        };
        match (step, next_best) {
            (Step::NextFormat, Some(next)) => {
                let why = why();
                tracing::warn!(camera = %name.0, "{pixel} gives no usable frame: {next} is tried instead ({why})");
                self.formats_left.leave(name, pixel, why);
            }
            (Step::FirstFormat, _) => {
                let why = why();
                tracing::warn!(camera = %name.0, "{pixel} gives no usable frame either: all formats are tried again ({why})");
                self.formats_left.leave(name, pixel, why);
                self.formats_left.try_again(name);
            }
            _ => self.recovery = Recovery::new(),
        }
        self.state.metrics.set_rejected_formats(self.formats_left.told());
    }

    /// The camera was not opened. Where it was to be opened with a format in place of another, it is opened with that one again.
    fn not_opened(&mut self, error: DeviceError) -> StreamEnd {
        if matches!(error, DeviceError::Unsupported { .. }) && self.formats_left.try_all_again() {
            tracing::warn!("all formats are tried again: {error}");
            self.recovery.goes_round();
        }
        self.classify_camera_error(error)
    }

    /// Opens the camera, which may take its time; those who watch get their pictures meanwhile.
    fn open_camera(&mut self) -> Result<Capture, StreamEnd> {
        let params = self.camera_params().map_err(StreamEnd::CameraUnavailable)?;
        let (wake, started) = (self.wake.clone(), Instant::now());
        let (done, opened) = bounded(1);
        std::thread::scope(|scope| {
            let open = move || {
                let _ = done.send(Capture::open(&params, wake));
            };
            let opening = std::thread::Builder::new().name("opening".into()).spawn_scoped(scope, open);
            opening.map_err(|error| StreamEnd::CameraUnavailable(DeviceError::io("opening thread", "start", error)))?;
            loop {
                if started.elapsed() < LONGEST_OPENING {
                    self.heartbeat.beat();
                }
                self.show()?;
                match opened.recv_timeout(SHOW_EVERY) {
                    Ok(camera) => return camera.map_err(|error| self.not_opened(error)),
                    Err(RecvTimeoutError::Timeout) => {}
                    Err(RecvTimeoutError::Disconnected) => {
                        let error = std::io::ErrorKind::Other.into();
                        return Err(StreamEnd::CameraUnavailable(DeviceError::io("camera", "open", error)));
                    }
                }
            }
        })
    }

    /// Shows those who watch that they are not forgotten.
    fn show(&mut self) -> Result<(), StreamEnd> {
        self.output.as_mut().map_or(Ok(()), FrameSink::idle).map_err(StreamEnd::OutputUnavailable)
    }

    /// The camera is closed and nobody watches: waits until somebody does.
    fn rest(&mut self) -> StreamEnd {
        let Some(output) = &mut self.output else { return StreamEnd::NoViewers };
        if let Err(error) = output.clear() {
            return StreamEnd::OutputUnavailable(error);
        }
        let name = output.name();
        tracing::info!(output = %name, "nobody watches: the camera is closed");
        self.heartbeat.set_activity(format!("nobody watches {name}: the camera is closed"), Phase::Idle);
        self.heartbeat.ready();
        self.backoff = Backoff::default();
        while !self.stop.is_set() && !self.is_wanted() {
            // Who only looks in gets a picture as well, and who comes gets none that is old.
            if let Err(error) = self.output.as_mut().map_or(Ok(()), LiveOutput::rest) {
                return StreamEnd::OutputUnavailable(error);
            }
            let misses_loopback = self.output.as_ref().is_some_and(|output| output.loopback.is_none());
            match &self.hotplug {
                Some(hotplug) if misses_loopback && hotplug.wait(self.wake, SHOW_EVERY) == News::Devices => {
                    // It may be the loopback that came.
                    self.wake.wait(SETTLED);
                    self.output = None;
                    break;
                }
                Some(_) if misses_loopback => {}
                _ => drop(self.wake.wait(SHOW_EVERY)),
            }
            self.heartbeat.beat();
        }
        StreamEnd::NoViewers
    }

    /// Whether waiting can help against a camera's error. A camera that never worked as configured will not begin to.
    fn classify_camera_error(&self, error: DeviceError) -> StreamEnd {
        match error {
            DeviceError::Unsupported { .. } | DeviceError::Format { .. } if self.report.cameras == 0 && !self.patient => {
                StreamEnd::Failed(error)
            }
            error => StreamEnd::CameraUnavailable(error),
        }
    }

    /// The same against the loopback's.
    fn classify_output_error(&self, error: DeviceError) -> StreamEnd {
        let waits = self.patient || self.report.cameras > 0 || matches!(error, DeviceError::Busy { .. });
        if waits { StreamEnd::OutputUnavailable(error) } else { StreamEnd::Failed(error) }
    }

    /// Says once for each state, not for each try, what is waited for.
    fn tell(&mut self, state: String) {
        self.heartbeat.set_activity(state.clone(), Phase::Waiting);
        if state != self.backoff.told {
            tracing::warn!("{state}");
            self.backoff.told = state;
        }
    }

    /// Waits before the next try, longer each time; not when a device comes, goes or changes.
    fn wait(&mut self) {
        let mut until = Instant::now() + self.backoff.pause;
        let companions = self.companions;
        let connected = || companions.map_or(0, Companions::connected);
        let before = connected();
        while !self.stop.is_set() {
            let left = until.saturating_duration_since(Instant::now());
            if left.is_zero() {
                self.backoff.pause = (2 * self.backoff.pause).min(BACKOFF.1);
                break;
            }
            let news = match &self.hotplug {
                Some(hotplug) => hotplug.wait(self.wake, left.min(SHOW_EVERY)),
                None if self.wake.wait(left.min(SHOW_EVERY)) => News::Notified,
                None => News::Nothing,
            };
            self.heartbeat.beat();
            // What is wrong with the loopback is found out when it is needed.
            let _ = self.show();
            if self.output.is_none() && connected() > before {
                break;
            }
            // A companion comes when a user logs in, which may be never: a service without a loopback is ready for one.
            if self.born.elapsed() > READY_WITHOUT_CAMERA || (self.output.is_none() && self.companions.is_some()) {
                self.heartbeat.ready();
            }
            if news == News::Devices {
                // Soon, but not at once: links and permissions follow the node.
                self.backoff.pause = BACKOFF.0;
                until = Instant::now() + SETTLED;
            }
            if self.settings.output.on_demand && self.output.is_some() && !self.is_wanted() {
                break;
            }
        }
    }

    /// The end. Who watches may wait for the next start of the service, and keeps the picture until then.
    fn leave(&mut self) {
        if let Some(output) = self.output.take() {
            output.leave(self.patient);
        }
    }
}
