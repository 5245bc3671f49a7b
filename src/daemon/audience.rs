//! A thread that follows who watches the loopback, so that nobody on the frame path has to ask.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering::Relaxed};
use std::thread::JoinHandle;
use std::time::Duration;

use super::demand::Demand;
use crate::device::DeviceError;
use crate::device::v4l2::Viewers;
use crate::rt::clock::monotonic_ns;
use crate::rt::stop::Stop;
use crate::rt::wake::Wake;

/// Who watches one loopback, for as long as this lives.
#[derive(Debug)]
pub(super) struct Audience {
    known: Seats,
    over: Stop,
    bell: Wake,
    thread: Option<JoinHandle<()>>,
}

/// What is known of them, for any thread.
#[derive(Clone, Debug, Default)]
pub(super) struct Seats(Arc<Known>);

#[derive(Debug, Default)]
struct Known {
    count: AtomicU32,
    wanted: AtomicBool,
}

impl Audience {
    /// Follows who watches the loopback at `path`. `wake` is rung whenever an answer changes.
    ///
    /// # Errors
    /// Where it cannot be told.
    pub(super) fn follow(path: &Path, linger: Duration, wake: &Wake) -> Result<Self, DeviceError> {
        let bell = Wake::new().map_err(|error| DeviceError::io("eventfd", "create", error))?;
        let (known, over) = (Seats::default(), Stop::default());
        let mut viewers = Viewers::of(path)?;
        if !viewers.are_told() {
            tracing::info!(
                loopback = %path.display(),
                "this v4l2loopback is older than 0.13 and does not tell who watches: whoever holds it open counts"
            );
        }
        let follow = {
            let (known, over, bell, wake) = (known.clone(), over.clone(), bell.clone(), wake.clone());
            move || {
                let mut demand = Demand::new(linger);
                while !over.is_set() {
                    let count = match viewers.wait(&bell, demand.stands(monotonic_ns())) {
                        Ok(count) => count,
                        Err(error) => {
                            // Whoever writes to the device will find out what is wrong with it.
                            tracing::warn!(%error, "cannot tell any more who watches; the camera stays open");
                            known.set(1, true, &wake);
                            return;
                        }
                    };
                    let now_ns = monotonic_ns();
                    demand.see(count > 0, now_ns);
                    known.set(count, demand.wants(now_ns), &wake);
                }
            }
        };
        let thread = std::thread::Builder::new().name("audience".into()).spawn(follow);
        let thread = Some(thread.map_err(|error| DeviceError::io("audience thread", "start", error))?);
        Ok(Self { known, over, bell, thread })
    }

    /// What is known of them.
    pub(super) fn seats(&self) -> &Seats {
        &self.known
    }
}

impl Seats {
    /// Whether somebody watches now.
    pub(super) fn are_taken(&self) -> bool {
        self.count() > 0
    }

    /// How many watch, as [`Viewers::wait`] has it.
    pub(super) fn count(&self) -> u32 {
        self.0.count.load(Relaxed)
    }

    /// Whether the camera should be open for them.
    pub(super) fn want_camera(&self) -> bool {
        self.0.wanted.load(Relaxed)
    }

    fn set(&self, count: u32, wanted: bool, wake: &Wake) {
        let changed = (self.0.count.swap(count, Relaxed) > 0) != (count > 0);
        if self.0.wanted.swap(wanted, Relaxed) != wanted || changed {
            wake.ring();
        }
    }
}

impl Drop for Audience {
    fn drop(&mut self) {
        self.over.set();
        self.bell.ring();
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}
