//! A daemon in this process: its control socket, its socket for pictures, and its pipeline on a synthetic camera. A device that every user
//! may open stands for the camera.

#[path = "../common/paced.rs"]
mod paced;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::thread::JoinHandle;

use gimbald::config::Settings;
use gimbald::control::{self, BoundSocket, DaemonState, Limits, Phase, PipewireInfo};
use gimbald::device::FrameSource;
use gimbald::device::null::NullSink;
use gimbald::device::synthetic::{self, Motion, Synthetic};
use gimbald::frame::Frame;
use gimbald::image::PictureRef;
use gimbald::pipeline::{Observer, run_live};
use gimbald::rt::notifier::Notifier;
use gimbald::rt::stop::Stop;
use gimbald::share::{Companions, Inspector, Server};
use gimbald::systemd::Systemd;
use paced::Paced;

pub struct TestDaemon {
    pub state: Arc<DaemonState>,
    place: PathBuf,
    companions: Companions,
    stop: Stop,
    done: [Notifier; 2],
    threads: Vec<JoinHandle<()>>,
}

/// Gives each frame to the pages, and counts it.
struct Watcher(Inspector, Arc<DaemonState>);

impl Observer for Watcher {
    fn drawn(&mut self, frame: &Frame, output: PictureRef<'_>) {
        self.0.show(frame, output);
    }

    fn sent(&mut self, frame: &Frame) {
        self.1.metrics.sent(frame);
    }
}

impl TestDaemon {
    pub fn start(name: &str) -> Self {
        let place = std::env::temp_dir().join(format!("gimbald-view-{}-{name}", std::process::id()));
        std::fs::create_dir_all(&place).unwrap();
        let state = Arc::new(DaemonState::new(
            Settings::default(),
            Systemd::disconnected(),
            Box::new(|| Err("there is no file".into())),
        ));
        let control =
            control::Server::new(BoundSocket::bind(&place.join("control.sock"), 0o600, None).unwrap(), Limits::default())
                .unwrap();
        let pictures = Server::open(&place).unwrap();
        let companions = pictures.companions().clone();
        let counted = companions.clone();
        state.metrics.set_pipewire(Box::new(move || PipewireInfo { pages: counted.pages(), ..PipewireInfo::default() }));
        state.metrics.set_phase(Phase::Streaming, "synthetic camera (320x240)");
        let params =
            synthetic::Params { width: 320, height: 240, frames: 0, motion: Motion::Walk, ..synthetic::Params::default() };
        let camera = Synthetic::new(&params).unwrap();
        let format = camera.format();
        let _outlet = companions.outlet(&format);
        companions.camera_is(Path::new("/dev/null"));
        let done = [Notifier::new().unwrap(), Notifier::new().unwrap()];
        let stop = Stop::default();
        let (asked, bells) = (state.clone(), done.clone());
        let [first, second] = bells;
        let mut threads = vec![std::thread::spawn(move || control.serve(&asked, &first))];
        threads.push(std::thread::spawn(move || pictures.serve(&second, &|| Some("/dev/null".into()))));
        let mut watcher = Watcher(companions.inspector(&format), state.clone());
        let (over, running) = (stop.clone(), state.clone());
        threads.push(std::thread::spawn(move || {
            let mut source = Paced::new(Box::new(camera));
            let mut sink = NullSink::new(&format);
            let params = running.live.params();
            run_live(&mut source, &mut sink, &params, &running.live, &over, &mut watcher).unwrap();
        }));
        Self { state, place, companions, stop, done, threads }
    }

    pub fn socket(&self) -> String {
        self.place.join("control.sock").to_str().unwrap().to_owned()
    }

    pub fn companions(&self) -> &Companions {
        &self.companions
    }
}

impl Drop for TestDaemon {
    fn drop(&mut self) {
        self.stop.set();
        self.done.iter().for_each(Notifier::notify);
        self.threads.drain(..).for_each(|thread| drop(thread.join()));
        let _ = std::fs::remove_dir_all(&self.place);
    }
}
