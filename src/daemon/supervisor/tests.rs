//! The supervisor with fake devices: cameras that are absent, unplugged or unsuitable, outputs that fail, viewers who come and go.

use std::collections::VecDeque;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};
use std::sync::{Arc, Mutex};

use super::super::monitored_source::Camera;
use super::super::viewers::ViewerStatus;
use super::*;
use crate::control::{Losses, Status};
use crate::device::null::NullSink;
use crate::device::{FrameSink, FrameSource, Lent, RawFrame};
use crate::frame::Stamp;
use crate::image::PictureMut;
use crate::systemd::Systemd;

const TIMEOUT: Duration = Duration::from_secs(60);

/// What happens when a device is opened.
#[derive(Clone, Copy)]
enum Open {
    /// It fails with this error.
    Fails(fn() -> DeviceError),
    /// It works for so many frames, then it is gone.
    Works(u64),
}

fn absent() -> DeviceError {
    DeviceError::io("/dev/fake", "open", std::io::ErrorKind::NotFound.into())
}

fn unsupported() -> DeviceError {
    DeviceError::Unsupported { path: "/dev/fake".into(), what: "it cannot".into() }
}

/// Devices that do what a script says; without a script, they work.
#[derive(Default)]
struct FakeDevices {
    cameras: Mutex<VecDeque<Open>>,
    outputs: Mutex<VecDeque<Open>>,
    viewers: ViewerStatus,
    /// Times each was opened.
    camera_opened: AtomicU64,
    output_opened: AtomicU64,
    /// Times an output was cleared.
    placeholders: Arc<AtomicU64>,
}

impl Devices for FakeDevices {
    fn probe_camera(&self, _: &CaptureParams) -> Result<(StreamFormat, PathBuf), DeviceError> {
        match self.cameras.lock().unwrap().front() {
            Some(Open::Fails(error)) => Err(error()),
            _ => Ok((format(), "/dev/fake".into())),
        }
    }

    fn open_camera(&self, _: &CaptureParams, _: Notifier) -> Result<Box<dyn LiveCamera>, DeviceError> {
        let frames = match self.cameras.lock().unwrap().pop_front() {
            Some(Open::Fails(error)) => return Err(error()),
            Some(Open::Works(frames)) => frames,
            None => u64::MAX,
        };
        self.camera_opened.fetch_add(1, Relaxed);
        Ok(Box::new(FakeCamera { bytes: vec![128; format().frame_bytes().unwrap()], given: 0, frames }))
    }

    fn open_output(
        &self,
        _: &Settings,
        format: &StreamFormat,
        _: Option<&Companions>,
        _: &Notifier,
    ) -> Result<Box<dyn Output>, DeviceError> {
        let frames = match self.outputs.lock().unwrap().pop_front() {
            Some(Open::Fails(error)) => return Err(error()),
            Some(Open::Works(frames)) => frames,
            None => u64::MAX,
        };
        self.output_opened.fetch_add(1, Relaxed);
        let (viewers, placeholders) = (self.viewers.clone(), self.placeholders.clone());
        Ok(Box::new(FakeOutput { sink: NullSink::new(format), frames, viewers, placeholders }))
    }
}

fn format() -> StreamFormat {
    StreamFormat::tight(64, 48, PixelFormat::Yuyv, (1, 30))
}

struct FakeCamera {
    bytes: Vec<u8>,
    given: u64,
    frames: u64,
}

impl FrameSource for FakeCamera {
    fn format(&self) -> StreamFormat {
        format()
    }

    fn lend(&mut self) -> Result<Lent<'_>, DeviceError> {
        if self.given == self.frames {
            return Err(DeviceError::Gone { path: "/dev/fake".into() });
        }
        std::thread::sleep(Duration::from_millis(2));
        let stamp = Stamp { time_ns: monotonic_ns(), sequence: self.given, ..Stamp::default() };
        self.given += 1;
        Ok(Lent::Frame(RawFrame { format: format(), bytes: &self.bytes, stamp }))
    }
}

impl Camera for FakeCamera {
    fn losses(&self) -> Losses {
        Losses::default()
    }

    fn restart(&mut self) -> Result<(), DeviceError> {
        Ok(())
    }
}

impl LiveCamera for FakeCamera {
    fn path(&self) -> &std::path::Path {
        std::path::Path::new("/dev/fake")
    }

    fn name_and_bus(&self) -> (String, String) {
        ("Fake".into(), "test".into())
    }

    fn next_best(&self) -> Option<PixelFormat> {
        None
    }
}

struct FakeOutput {
    sink: NullSink,
    frames: u64,
    viewers: ViewerStatus,
    placeholders: Arc<AtomicU64>,
}

impl FrameSink for FakeOutput {
    fn format(&self) -> StreamFormat {
        self.sink.format()
    }

    fn canvas(&mut self) -> Result<PictureMut<'_>, DeviceError> {
        self.sink.canvas()
    }

    fn submit(&mut self, stamp: &Stamp) -> Result<(), DeviceError> {
        if self.sink.submitted() == self.frames {
            return Err(DeviceError::Gone { path: "/dev/out".into() });
        }
        self.sink.submit(stamp)
    }
}

impl Output for FakeOutput {
    fn viewers(&self) -> &ViewerStatus {
        &self.viewers
    }

    fn suits(&self, format: &StreamFormat) -> bool {
        (self.format().width, self.format().height) == (format.width, format.height) || self.viewers.at_loopback() > 0
    }

    fn name(&self) -> String {
        "/dev/out".into()
    }

    fn has_loopback(&self) -> bool {
        true
    }

    fn clear(&mut self) -> Result<(), DeviceError> {
        self.placeholders.fetch_add(1, Relaxed);
        Ok(())
    }

    fn refresh(&mut self) -> Result<(), DeviceError> {
        Ok(())
    }

    fn close(self: Box<Self>, _: bool) {}
}

/// What a test sees of a supervisor that runs, and what it can do to it.
struct Rig<'a> {
    devices: &'a FakeDevices,
    has_ended: &'a AtomicBool,
    state: &'a DaemonState,
    wake: &'a Notifier,
}

impl Rig<'_> {
    fn until(&self, what: &str, is_so: impl Fn(&Status) -> bool) -> Status {
        let started = Instant::now();
        loop {
            let status = self.state.status();
            if is_so(&status) {
                return status;
            }
            assert!(started.elapsed() < TIMEOUT, "{what}: {status:?}");
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    fn watch(&self, viewers: u32) {
        self.devices.viewers.set(viewers, 0, viewers > 0, self.wake);
    }
}

/// Runs a supervisor, as a service or not, until `act` is through or it ended by itself.
fn supervise(devices: &FakeDevices, is_service: bool, act: impl FnOnce(&Rig<'_>)) -> Result<(), DeviceError> {
    let settings = Settings::default();
    let state = DaemonState::new(settings.clone(), Systemd::disconnected(), Box::new(|| Err("there is no file".into())));
    let (stop, wake, has_ended) = (Stop::default(), Notifier::new().unwrap(), AtomicBool::new(false));
    let (store, cameras, heartbeat) = (CalibrationStore::open(None), Cameras::default(), Heartbeat::new(&state));
    let parts = Parts {
        devices,
        settings: &settings,
        state: &state,
        stop: &stop,
        wake: &wake,
        heartbeat: &heartbeat,
        store: &store,
        cameras: &cameras,
        companions: None,
        hotplug: None,
        is_service,
    };
    std::thread::scope(|scope| {
        let has_ended = &has_ended;
        let running = scope.spawn(move || {
            let mut supervisor = Supervisor::new(parts);
            let ended = supervisor.run();
            has_ended.store(true, Relaxed);
            supervisor.close();
            ended
        });
        let rig = Rig { devices, has_ended, state: &state, wake: &wake };
        let acted = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| act(&rig)));
        stop.set();
        wake.notify();
        let ended = running.join().unwrap();
        acted.unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        ended
    })
}

#[test]
fn the_camera_is_open_while_there_are_viewers() {
    let devices = FakeDevices::default();
    let ended = supervise(&devices, true, |rig| {
        let idle = rig.until("idle at first", |status| status.state == "idle");
        assert_eq!((idle.cameras_opened, idle.camera), (0, None));
        rig.watch(1);
        let live = rig.until("frames for a viewer", |status| status.frames.sent > 5);
        assert_eq!((live.state.as_str(), live.camera.map(|camera| camera.name)), ("streaming", Some("Fake".into())));
        rig.watch(0);
        let idle = rig.until("idle again", |status| status.state == "idle");
        assert_eq!((idle.cameras_opened, idle.camera), (1, None));
        assert!(devices.placeholders.load(Relaxed) >= 2, "nothing of the camera's pictures is left to be seen");
    });
    assert!(ended.is_ok());
    assert_eq!(devices.output_opened.load(Relaxed), 1, "viewers never lose the output");
}

#[test]
fn a_service_waits_for_a_camera_and_takes_it_back_after_it_was_unplugged() {
    let script = [Open::Fails(absent), Open::Fails(unsupported), Open::Works(10), Open::Fails(absent)];
    let devices = FakeDevices { cameras: Mutex::new(script.into()), ..FakeDevices::default() };
    let ended = supervise(&devices, true, |rig| {
        rig.watch(1);
        rig.until("it waits and says why", |status| status.state == "waiting" && status.what.contains("/dev/fake"));
        rig.until("it streams for the second time", |status| status.cameras_opened == 2 && status.frames.sent > 12);
    });
    assert!(ended.is_ok());
    assert_eq!(devices.output_opened.load(Relaxed), 1, "viewers never lose the output");
}

#[test]
fn an_output_that_fails_is_opened_again() {
    let script = [Open::Fails(absent), Open::Works(5), Open::Fails(absent)];
    let devices = FakeDevices { outputs: Mutex::new(script.into()), ..FakeDevices::default() };
    let ended = supervise(&devices, true, |rig| {
        rig.watch(1);
        rig.until("it waits for the loopback", |status| status.what.starts_with("waiting for the loopback"));
        rig.until("it streams again", |status| status.frames.sent > 10);
    });
    assert!(ended.is_ok());
    assert_eq!(devices.output_opened.load(Relaxed), 2);
}

#[test]
fn in_a_terminal_a_device_that_cannot_do_what_is_asked_ends_the_run() {
    for (cameras, outputs) in [(Some(Open::Fails(unsupported)), None), (None, Some(Open::Fails(absent)))] {
        let devices = FakeDevices {
            cameras: Mutex::new(cameras.into_iter().collect()),
            outputs: Mutex::new(outputs.into_iter().collect()),
            ..FakeDevices::default()
        };
        let ended = supervise(&devices, false, |rig| {
            rig.until("it ends by itself", |_| rig.has_ended.load(Relaxed));
        });
        assert!(matches!(ended, Err(DeviceError::Unsupported { .. } | DeviceError::Io { .. })), "{ended:?}");
    }
}
