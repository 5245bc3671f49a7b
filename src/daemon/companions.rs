//! The daemon's side of PipeWire companions: where its socket is, and which camera they must be allowed to open.

use std::path::{Path, PathBuf};

use super::cameras::Cameras;
use crate::config::Settings;
use crate::device::v4l2::{Direction, find};
use crate::share::Server;
use crate::systemd::Systemd;

/// The socket, unless the settings forbid it. A failure is logged and the loopback used without PipeWire.
pub(super) fn open(settings: &Settings) -> Option<Server> {
    if settings.output.pipewire == Some(false) {
        return None;
    }
    let Some(directory) = directory(&settings.control.socket, Systemd::runtime_directory(), user_directory()) else {
        tracing::info!("PipeWire output disabled: neither RUNTIME_DIRECTORY nor XDG_RUNTIME_DIR is set");
        return None;
    };
    match Server::open(&directory) {
        Ok(server) => {
            tracing::info!("listening for PipeWire companions at {}", server.path().display());
            Some(server)
        }
        Err(what) => {
            tracing::warn!("PipeWire output disabled: {what}");
            None
        }
    }
}

/// Where a daemon's sockets are: beside the control socket, if that has a place of its own, so that two daemons of one user do not
/// meet; else the service's directory, else the user's.
fn directory(control: &str, service: Option<PathBuf>, user: Option<PathBuf>) -> Option<PathBuf> {
    match control {
        "auto" | "off" => service.or(user),
        path => Path::new(path).parent().map(Path::to_path_buf),
    }
}

fn user_directory() -> Option<PathBuf> {
    if rustix::process::geteuid().is_root() {
        return Some(PathBuf::from("/run/gimbald"));
    }
    let runtime = PathBuf::from(std::env::var_os("XDG_RUNTIME_DIR")?);
    runtime.is_absolute().then(|| runtime.join("gimbald"))
}

/// The camera that would be opened; the one that was open before, where one was.
pub(super) fn locate(settings: &Settings, cameras: &Cameras) -> Option<PathBuf> {
    let params = cameras.params(settings.camera.params()).ok()?;
    params.nodes.into_iter().next().map(|sighting| sighting.node).or_else(|| find(&params.device, Direction::Capture).ok())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sockets_of_one_daemon_lie_together() {
        let (service, user) = (Some(PathBuf::from("/run/gimbald-desk")), Some(PathBuf::from("/run/user/7/gimbald")));
        assert_eq!(directory("auto", service.clone(), user.clone()), service);
        assert_eq!(directory("off", None, user.clone()), user);
        assert_eq!(directory("auto", None, None), None);
        assert_eq!(directory("/x/gimbald-a/s", service, user), Some(PathBuf::from("/x/gimbald-a")));
    }
}
