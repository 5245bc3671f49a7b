//! The companion: a process in the user's session that keeps a PipeWire camera node for each daemon and hands it the daemon's pictures.
//!
//! The node outlives the daemon: programs that watch it keep their camera while the service restarts, and see its last picture
//! meanwhile. What is between both is [`crate::share`].

mod camera;
mod still;

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use crate::pipewire::{Library, Missing};
use crate::rt::notifier::Notifier;
use crate::rt::stop::Stop;
use crate::share::socket_paths;
use camera::Camera;

/// How often new daemons are looked for.
const LOOK_EVERY: Duration = Duration::from_secs(1);

/// A node is there after this long though no daemon is: the service may begin later than the session.
const WITHOUT_DAEMON: Duration = Duration::from_secs(3);

/// Nodes, at most: one for each daemon.
const MAX_NODES: usize = 16;

/// Keeps a node for each daemon until `stop` is set and `wake` notified.
///
/// # Errors
/// Where PipeWire's library, or what it needs, is not installed. A PipeWire that does not run is waited for.
pub fn run(stop: &Stop, wake: &Notifier) -> Result<(), Missing> {
    let library = Library::open()?;
    tracing::info!("PipeWire's library is version {}", library.version());
    let runtime = std::env::var_os("XDG_RUNTIME_DIR").map(PathBuf::from).filter(|path| path.is_absolute());
    let started = Instant::now();
    std::thread::scope(|scope| {
        let mut notifiers: Vec<(String, Notifier)> = Vec::new();
        while !stop.is_set() {
            let mut found: Vec<String> = daemons(runtime.as_deref()).into_iter().map(|(instance, _)| instance).collect();
            if found.is_empty() && notifiers.is_empty() && started.elapsed() >= WITHOUT_DAEMON {
                found.push(String::new());
            }
            for instance in found {
                if notifiers.len() >= MAX_NODES || notifiers.iter().any(|(known, _)| *known == instance) {
                    continue;
                }
                let Ok(notifier) = Notifier::new() else { continue };
                let camera = Camera::new(library, &instance, runtime.clone(), notifier.clone());
                let live = move || camera.live(stop);
                match std::thread::Builder::new().name("node".into()).spawn_scoped(scope, live) {
                    Ok(_) => notifiers.push((instance, notifier)),
                    Err(error) => tracing::warn!(%error, "no thread for another node"),
                }
            }
            wake.wait(LOOK_EVERY);
        }
        notifiers.iter().for_each(|(_, notifier)| notifier.notify());
    });
    Ok(())
}

/// The daemons there are: their instances, and where they listen.
fn daemons(runtime: Option<&Path>) -> Vec<(String, PathBuf)> {
    socket_paths(runtime)
}
