//! A life: devices, pipeline, READY, watch; the camera goes and comes back; STOPPING, and an end that leaves both devices usable.

mod memory;
mod pulse;

use std::time::{Duration, Instant};

use crate::config::Settings;
use crate::control::{CameraNow, Desk, Lost, OutputNow, Server, State};
use crate::device::v4l2::{Capture, Loopback, LoopbackParams};
use crate::device::{DeviceError, FrameSink, FrameSource};
use crate::pipeline::{Params, run_live};
use crate::rt::stop::Stop;
use crate::rt::wake::Wake;
use crate::systemd::Systemd;
use memory::{Memory, Mode};
use pulse::{Attended, Pulse, attend};

/// From the first try again to the slowest.
const BACKOFF: (Duration, Duration) = (Duration::from_millis(250), Duration::from_secs(5));

/// A service whose camera is not there is ready too, after this long: nothing that waits for it (the boot) is held up.
const READY_WITHOUT_CAMERA: Duration = Duration::from_secs(20);

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

/// Stabilizes the camera's picture into the loopback until `stop` is set (and `wake` rung, so that it is seen at once).
///
/// A camera that is absent, busy or goes away is waited for; the loopback stays open meanwhile and shows the last picture.
///
/// # Errors
/// Where the loopback cannot be opened or fails, and where the camera cannot do what is configured.
pub fn run(desk: &Desk, stop: &Stop, wake: &Wake) -> Result<ExitReport, DeviceError> {
    let systemd = Systemd::from_env();
    let settings = &desk.settings();
    let pulse = Pulse::new(systemd, desk);
    let memory = Memory::open(Systemd::state_directory().as_deref());
    let done = Wake::new().map_err(|error| DeviceError::io("eventfd", "create", error))?;
    let server = Server::open(&settings.control, &settings.metrics.listen, Systemd::runtime_directory());
    let answered = Wake::new().map_err(|error| DeviceError::io("eventfd", "create", error))?;
    std::thread::scope(|scope| {
        // Rings when this scope's own work ends, be it by a panic: the scope waits for its thread.
        let _bell = RingAtEnd(&done);
        if systemd.listens() || memory.keeps() {
            let attending =
                std::thread::Builder::new().name("watchdog".into()).spawn_scoped(scope, || attend(&pulse, &memory, &done));
            attending.map_err(|error| DeviceError::io("watchdog thread", "start", error))?;
        }
        let _answered = RingAtEnd(&answered);
        if let Some(server) = &server {
            let serving = || server.serve(desk, &answered);
            let serving = std::thread::Builder::new().name("control".into()).spawn_scoped(scope, serving);
            serving.map_err(|error| DeviceError::io("control thread", "start", error))?;
        }
        let mut life =
            Life { settings, desk, stop, wake, pulse: &pulse, memory: &memory, loopback: None, report: ExitReport::default() };
        let ended = life.live();
        desk.tally.is_at(State::Stopping, "stopping");
        systemd.stopping();
        let (frames, stabilized) = pulse.sent();
        ended.map(|()| ExitReport { frames, stabilized, ..life.report })
    })
}

struct RingAtEnd<'a>(&'a Wake);

impl Drop for RingAtEnd<'_> {
    fn drop(&mut self) {
        self.0.ring();
    }
}

/// Why the pipeline does not run.
enum Ended {
    /// Nobody wants it to.
    Stopped,
    /// What it needs is not there now.
    Waiting(DeviceError),
    /// What it needs will not come by waiting.
    Failed(DeviceError),
}

struct Life<'a> {
    settings: &'a Settings,
    desk: &'a Desk,
    stop: &'a Stop,
    wake: &'a Wake,
    pulse: &'a Pulse<'a>,
    memory: &'a Memory,
    /// Opened with the first camera, in its size, and kept: who watches it never loses it.
    loopback: Option<Loopback>,
    report: ExitReport,
}

impl Life<'_> {
    fn live(&mut self) -> Result<(), DeviceError> {
        let born = Instant::now();
        let mut pause = BACKOFF.0;
        let mut told = String::new();
        while !self.stop.is_set() {
            let sent = self.pulse.sent().0;
            let error = match self.stream() {
                Ended::Stopped => break,
                Ended::Failed(error) => return Err(error),
                Ended::Waiting(error) => error,
            };
            if self.pulse.sent().0 > sent {
                pause = BACKOFF.0;
                told.clear();
            }
            // Once for each state, not for each try.
            let state = error.to_string();
            if state != told {
                tracing::warn!("waiting for the camera: {state}");
                self.pulse.doing(format!("waiting for the camera: {state}"), false);
                told = state;
            }
            self.wait(pause, born)?;
            pause = (2 * pause).min(BACKOFF.1);
        }
        Ok(())
    }

    /// Opens what is not open and streams until something ends it.
    fn stream(&mut self) -> Ended {
        let mut camera = match Capture::open(&self.settings.camera.params(), self.wake.clone()) {
            Ok(camera) => camera,
            Err(error) => return self.judge(error),
        };
        self.report.cameras += 1;
        let loopback = match &mut self.loopback {
            Some(loopback) => loopback,
            none => match Loopback::open(&loopback_params(self.settings, &camera)) {
                Ok(loopback) => none.insert(loopback),
                Err(error @ DeviceError::Busy { .. }) => return Ended::Waiting(error),
                Err(error) => return Ended::Failed(error),
            },
        };
        let format = camera.format();
        let (from, to) = (camera.path().display().to_string(), loopback.path().display().to_string());
        let mode = format!("{} {}x{}", format.pixel, format.width, format.height);
        tracing::info!(camera = %from, loopback = %to, %mode, "stabilizing");
        self.pulse.doing(format!("{from} ({mode}) to {to}"), true);
        let known = self.memory.begin(Mode::of(&camera), self.settings.pipeline.camera);
        let params = Params { camera: known, ..self.desk.live.params() };
        self.desk.tally.camera(camera_now(&camera));
        self.desk.tally.output(output_now(loopback));
        let mut observer = self.pulse;
        let mut attended = Attended { camera: &mut camera, pulse: self.pulse, told: Lost::default(), failed: false };
        let ran = run_live(&mut attended, loopback, &params, &self.desk.live, self.stop, &mut observer);
        self.desk.tally.no_camera();
        self.memory.end(&self.pulse.take_calibration());
        match ran {
            Ok(totals) => {
                tracing::info!(?totals, "the stream ended");
                Ended::Stopped
            }
            Err(error) if attended.failed => self.judge(error),
            Err(error) => Ended::Failed(error),
        }
    }

    /// Whether waiting can help against a camera's error. A camera that never worked as configured will not begin to.
    fn judge(&self, error: DeviceError) -> Ended {
        match error {
            DeviceError::Unsupported { .. } | DeviceError::Format { .. } if self.report.cameras == 0 => Ended::Failed(error),
            error => Ended::Waiting(error),
        }
    }

    /// Waits for `pause`, showing the last picture again, so that those who watch the loopback do not give it up.
    fn wait(&mut self, pause: Duration, born: Instant) -> Result<(), DeviceError> {
        let until = Instant::now() + pause;
        while !self.stop.is_set() {
            let left = until.saturating_duration_since(Instant::now());
            if left.is_zero() {
                break;
            }
            self.wake.wait(left.min(Duration::from_millis(500)));
            self.pulse.beat();
            if let Some(loopback) = &mut self.loopback {
                loopback.repeat()?;
            }
            if born.elapsed() > READY_WITHOUT_CAMERA {
                self.pulse.ready();
            }
        }
        Ok(())
    }
}

/// A camera as the status tells it.
fn camera_now(camera: &Capture) -> CameraNow {
    let format = camera.format();
    let (name, bus) = camera.name_and_bus();
    CameraNow {
        path: camera.path().display().to_string(),
        name,
        bus,
        format: format.pixel.to_string(),
        width: format.width,
        height: format.height,
        fps: format.rate(),
    }
}

/// The loopback as the status tells it.
fn output_now(loopback: &Loopback) -> OutputNow {
    let format = loopback.format();
    OutputNow {
        path: loopback.path().display().to_string(),
        format: format.pixel.to_string(),
        width: format.width,
        height: format.height,
    }
}

/// What the settings and the camera ask of the loopback: the camera's size (even), rate and colours.
fn loopback_params(settings: &Settings, camera: &Capture) -> LoopbackParams {
    let format = camera.format();
    LoopbackParams {
        device: settings.output.device.clone(),
        pixel: settings.output.format,
        width: format.width & !1,
        height: format.height & !1,
        interval: format.interval,
        colour: format.colour,
        buffers: 4,
    }
}
