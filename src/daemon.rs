//! The service: its threads, and what they share. [`lifecycle`] decides what happens next, [`supervisor`] does it.
//! [The plan](crate) lists the threads.

mod backoff;
mod calibration_store;
mod cameras;
mod companions;
mod demand;
mod describe;
mod devices;
mod heartbeat;
mod lifecycle;
mod monitored_source;
mod observers;
mod output;
mod recovery;
mod supervisor;
mod viewers;

use std::io;
use std::sync::Arc;
use std::thread::{Builder, Scope};

use crate::control::{DaemonState, Phase, Server};
use crate::device::DeviceError;
use crate::device::v4l2::Hotplug;
use crate::rt::notifier::Notifier;
use crate::rt::stop::Stop;
use crate::share;
use crate::systemd::Systemd;
use calibration_store::CalibrationStore;
#[cfg(feature = "fuzzing")]
pub use calibration_store::fuzz as fuzz_calibration_store;
use cameras::Cameras;
use devices::RealDevices;
use heartbeat::{Heartbeat, run_watchdog};
use supervisor::{Parts, Supervisor};

/// Totals of a daemon's run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ExitReport {
    /// Frames sent.
    pub frames: u64,
    /// Of these, stabilized.
    pub stabilized: u64,
    /// Times the camera was opened.
    pub cameras: u64,
}

/// Stabilizes the camera's picture into the loopback, and for PipeWire companions, until `stop` is set (and `wake` notified, so that it
/// is seen at once).
///
/// The camera is open while there are viewers (or always, if the settings say so). A camera that is absent, busy or unplugged is
/// waited for; the loopback stays open meanwhile and shows a placeholder. A loopback that is removed is waited for as well, unless a
/// companion is connected, which needs none.
///
/// # Errors
/// Where the loopback or the camera cannot do what is configured and this is not a systemd service: a service waits, and logs for what.
pub fn run(state: &Arc<DaemonState>, stop: &Stop, wake: &Notifier) -> Result<ExitReport, DeviceError> {
    let (systemd, settings) = (state.systemd(), &state.settings());
    let heartbeat = Heartbeat::new(state);
    let store = CalibrationStore::open(Systemd::state_directory().as_deref());
    let server = Server::open(&settings.control, Systemd::runtime_directory());
    let pictures = companions::open(settings);
    let cameras = Cameras::default();
    let done = Done::new()?;
    std::thread::scope(|scope| {
        // Also where this thread panics: the scope waits for the others.
        let _done = NotifyOnDrop(&done);
        if systemd.is_connected() || store.is_enabled() {
            spawn(scope, "watchdog", || run_watchdog(&heartbeat, &store, &done.watchdog))?;
        }
        if let Some(server) = &server {
            spawn(scope, "control", || server.serve(state, &done.control))?;
        }
        if let Some(hotplug) = hotplug() {
            let (cameras, done) = (&cameras, &done.cameras);
            spawn(scope, "cameras", move || cameras.watch(&hotplug, done))?;
        }
        if let Some(pictures) = &pictures {
            describe::companions(pictures.companions(), state);
            spawn(scope, "pictures", || pictures.serve(&done.pictures, &|| companions::locate(settings, &cameras)))?;
        }
        let mut supervisor = Supervisor::new(Parts {
            devices: &RealDevices,
            settings,
            state,
            stop,
            wake,
            heartbeat: &heartbeat,
            store: &store,
            cameras: &cameras,
            companions: pictures.as_ref().map(share::Server::companions),
            hotplug: hotplug(),
            is_service: systemd.is_connected(),
        });
        let ended = supervisor.run();
        state.metrics.set_phase(Phase::Stopping, "stopping");
        systemd.stopping();
        let cameras = supervisor.close();
        let (frames, stabilized) = state.metrics.frames_sent();
        ended.map(|()| ExitReport { frames, stabilized, cameras })
    })
}

/// Starts a thread that ends with the scope.
fn spawn<'scope>(scope: &'scope Scope<'scope, '_>, name: &str, work: impl FnOnce() + Send + 'scope) -> Result<(), DeviceError> {
    let spawned = Builder::new().name(name.into()).spawn_scoped(scope, work);
    spawned.map(drop).map_err(|error| DeviceError::io(format!("{name} thread"), "start", error))
}

/// Notices devices that are plugged in, where the system allows it.
fn hotplug() -> Option<Hotplug> {
    Hotplug::new().inspect_err(|error| tracing::warn!(%error, "hotplug detection unavailable, polling")).ok()
}

/// Ends the helper threads: each waits for its own notifier.
struct Done {
    watchdog: Notifier,
    control: Notifier,
    cameras: Notifier,
    pictures: Notifier,
}

impl Done {
    fn new() -> Result<Self, DeviceError> {
        let new = || Notifier::new().map_err(|error: io::Error| DeviceError::io("eventfd", "create", error));
        Ok(Self { watchdog: new()?, control: new()?, cameras: new()?, pictures: new()? })
    }
}

struct NotifyOnDrop<'a>(&'a Done);

impl Drop for NotifyOnDrop<'_> {
    fn drop(&mut self) {
        let Done { watchdog, control, cameras, pictures } = self.0;
        [watchdog, control, cameras, pictures].into_iter().for_each(Notifier::notify);
    }
}
