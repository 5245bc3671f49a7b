//! The companion: a process in the user's session that keeps a PipeWire camera node for each daemon and hands it the daemon's pictures.
//!
//! The node outlives the daemon: programs that watch it keep their camera while the service restarts, and see its last picture
//! meanwhile. What is between both is [`crate::share`].

mod camera;
mod still;

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use crate::pipewire::{Library, Missing};
use crate::rt::stop::Stop;
use crate::rt::wake::Wake;
use crate::share::socket_paths;
use camera::Camera;

/// How often new daemons are looked for.
const LOOK_EVERY: Duration = Duration::from_secs(1);

/// A node is there after this long though no daemon is: the service may begin later than the session.
const WITHOUT_DAEMON: Duration = Duration::from_secs(3);

/// Nodes, at most: one for each daemon.
const MOST_NODES: usize = 16;

/// Keeps a node for each daemon until `stop` is set and `wake` rung.
///
/// # Errors
/// Where PipeWire's library, or what it needs, is not installed. A PipeWire that does not run is waited for.
pub fn run(stop: &Stop, wake: &Wake) -> Result<(), Missing> {
    let library = Library::open()?;
    tracing::info!("PipeWire's library is version {}", library.version());
    let runtime = std::env::var_os("XDG_RUNTIME_DIR").map(PathBuf::from).filter(|path| path.is_absolute());
    let started = Instant::now();
    std::thread::scope(|scope| {
        let mut bells: Vec<(String, Wake)> = Vec::new();
        while !stop.is_set() {
            let mut found: Vec<String> = daemons(runtime.as_deref()).into_iter().map(|(instance, _)| instance).collect();
            if found.is_empty() && bells.is_empty() && started.elapsed() >= WITHOUT_DAEMON {
                found.push(String::new());
            }
            for instance in found {
                if bells.len() >= MOST_NODES || bells.iter().any(|(known, _)| *known == instance) {
                    continue;
                }
                let Ok(bell) = Wake::new() else { continue };
                let camera = Camera::new(library, &instance, runtime.clone(), bell.clone());
                let live = move || camera.live(stop);
                match std::thread::Builder::new().name("node".into()).spawn_scoped(scope, live) {
                    Ok(_) => bells.push((instance, bell)),
                    Err(error) => tracing::warn!(%error, "no thread for another node"),
                }
            }
            wake.wait(LOOK_EVERY);
        }
        bells.iter().for_each(|(_, bell)| bell.ring());
    });
    Ok(())
}

/// The daemons there are: their instances, and where they listen.
fn daemons(runtime: Option<&Path>) -> Vec<(String, PathBuf)> {
    socket_paths(runtime)
}
