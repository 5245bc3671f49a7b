//! Which camera to open: the one that the settings name, and afterwards the same one again, never another that was connected with it.

use std::io;
use std::path::Path;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use crate::device::DeviceError;
use crate::device::v4l2::{CaptureParams, Device, Hotplug, Known, News, Next, Roots, There};
use crate::rt::notifier::Notifier;

/// "auto" waits this long for the camera that it had, before it takes another; any setting, for the node with its picture.
const MAX_ABSENCE: Duration = Duration::from_secs(10);

/// How long to sleep where nothing happens.
const LONG: Duration = Duration::from_secs(3600);

/// What is known of cameras. One thread asks where the camera is, another watches which others are connected.
#[derive(Debug, Default)]
pub(super) struct Cameras {
    roots: Roots,
    state: Mutex<Seen>,
}

#[derive(Debug, Default)]
struct Seen {
    known: Option<Known>,
    /// Since when the camera is known to be unplugged.
    away: Option<Instant>,
}

impl Cameras {
    fn state(&self) -> MutexGuard<'_, Seen> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What to ask for, where the settings ask for `asked`.
    ///
    /// # Errors
    /// Where the camera is not there, and nothing else may be opened for it.
    pub(super) fn params(&self, asked: CaptureParams) -> Result<CaptureParams, DeviceError> {
        let Seen { known, away } = &mut *self.state();
        let Some(known) = known else { return Ok(asked) };
        let there = There::look(&asked.device, &self.roots);
        known.look_around(there.nodes());
        let waits = away.is_none_or(|since| since.elapsed() < MAX_ABSENCE);
        let next = known.next(&asked.device, &there, waits);
        if matches!(next, Next::Open(_)) {
            *away = None;
        } else {
            away.get_or_insert_with(Instant::now);
        }
        match next {
            Next::Open(nodes) => Ok(CaptureParams { nodes, ..asked }),
            Next::Search { except } => Ok(CaptureParams { except, ..asked }),
            Next::Wait(why) => {
                let source = io::Error::new(io::ErrorKind::NotFound, why);
                Err(DeviceError::io(asked.device, "find the camera that was open", source))
            }
        }
    }

    /// The camera at `path` was opened, or looked at to be opened.
    pub(super) fn opened(&self, path: &Path) {
        let Seen { known, away } = &mut *self.state();
        *away = None;
        // Where sysfs does not tell, the settings' name is all there is.
        let Some(opened) = self.roots.at(path) else {
            *known = None;
            return;
        };
        match known {
            Some(known) => {
                if known.is_another(&opened.device) {
                    let named = |device: &Device| format!("{} in USB port {}", device.described(), device.socket());
                    let (before, now) = (named(known.camera()), named(&opened.device));
                    tracing::warn!(camera = %path.display(), "using another camera: {now}; {before} did not come back");
                }
                known.opened(opened);
            }
            None => *known = Some(Known::new(opened)),
        }
        self.look_around(known.as_mut());
    }

    fn look_around(&self, known: Option<&mut Known>) {
        if let Some(known) = known {
            known.look_around(&self.roots.sightings());
        }
    }

    /// Watches which cameras are connected while the camera in use is, until `notifier` is notified.
    pub(super) fn watch(&self, hotplug: &Hotplug, notifier: &Notifier) {
        loop {
            match hotplug.wait(notifier, LONG) {
                News::Notified => return,
                News::Devices => self.look_around(self.state().known.as_mut()),
                News::Nothing => {}
            }
        }
    }
}
