//! A thread that follows who watches, the loopback or a PipeWire node, so that the frame path does not have to ask.

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
use crate::share::Companions;

/// Waiting without an end, for a poll that wants one.
const LONG: Duration = Duration::from_secs(3600);

/// Who watches, for as long as this lives.
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
    loopback: AtomicU32,
    companions: AtomicU32,
    wanted: AtomicBool,
}

impl Audience {
    /// Follows who watches the loopback at `loopback` and the nodes of `companions`. `wake` is rung whenever an answer changes.
    ///
    /// # Errors
    /// Where it cannot be told.
    pub(super) fn follow(
        loopback: Option<&Path>,
        companions: Option<&Companions>,
        linger: Duration,
        wake: &Wake,
    ) -> Result<Self, DeviceError> {
        let bell = Wake::new().map_err(|error| DeviceError::io("eventfd", "create", error))?;
        let (known, over) = (Seats::default(), Stop::default());
        let viewers = loopback.map(Viewers::of).transpose()?;
        if let (Some(path), Some(false)) = (loopback, viewers.as_ref().map(Viewers::are_told)) {
            tracing::info!(
                loopback = %path.display(),
                "this v4l2loopback is older than 0.13 and does not tell who watches: whoever holds it open counts"
            );
        }
        if let Some(companions) = companions {
            companions.tell(&bell);
            // Who was watching before is seen at once.
            bell.ring();
        }
        let ears = Ears { viewers, companions: companions.cloned(), bell: bell.clone() };
        let follow = {
            let (known, over, wake) = (known.clone(), over.clone(), wake.clone());
            move || ears.follow(linger, &known, &over, &wake)
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

/// What the thread listens to.
struct Ears {
    viewers: Option<Viewers>,
    companions: Option<Companions>,
    bell: Wake,
}

impl Ears {
    fn follow(mut self, linger: Duration, known: &Seats, over: &Stop, wake: &Wake) {
        // Programs look at a loopback to see what it is; a PipeWire node streams only for those who watch.
        let (mut loopback, mut nodes) = (Demand::new(linger), Demand::exact(linger));
        while !over.is_set() {
            let now_ns = monotonic_ns();
            let patience = [loopback.stands(now_ns), nodes.stands(now_ns)].into_iter().flatten().min();
            let count = match self.wait(patience) {
                Ok(count) => count,
                Err(error) => {
                    // Whoever writes to the device will find out what is wrong with it.
                    tracing::warn!(%error, "cannot tell any more who watches; the camera stays open");
                    known.set(1, 0, true, wake);
                    return;
                }
            };
            let watching = self.companions.as_ref().map_or(0, Companions::watching);
            let now_ns = monotonic_ns();
            loopback.see(count > 0, now_ns);
            nodes.see(watching > 0, now_ns);
            known.set(count, watching, loopback.wants(now_ns) || nodes.wants(now_ns), wake);
        }
    }

    /// Waits until something changes, but no longer than `patience`; says how many watch the loopback.
    fn wait(&mut self, patience: Option<Duration>) -> Result<u32, DeviceError> {
        match &mut self.viewers {
            Some(viewers) => viewers.wait(&self.bell, patience),
            None => {
                // Past the moment, not short of it.
                self.bell.wait(patience.map_or(LONG, |patience| patience + Duration::from_millis(1)));
                Ok(0)
            }
        }
    }
}

impl Seats {
    /// Whether somebody watches now.
    pub(super) fn are_taken(&self) -> bool {
        self.count() > 0
    }

    /// How many watch: the loopback, as [`Viewers::wait`] has it, and nodes that somebody watches.
    pub(super) fn count(&self) -> u32 {
        self.at_loopback() + self.0.companions.load(Relaxed)
    }

    /// How many of them watch the loopback.
    pub(super) fn at_loopback(&self) -> u32 {
        self.0.loopback.load(Relaxed)
    }

    /// Whether the camera should be open for them.
    pub(super) fn want_camera(&self) -> bool {
        self.0.wanted.load(Relaxed)
    }

    fn set(&self, loopback: u32, companions: u32, wanted: bool, wake: &Wake) {
        let before = self.are_taken();
        self.0.loopback.store(loopback, Relaxed);
        self.0.companions.store(companions, Relaxed);
        let changed = before != self.are_taken();
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
