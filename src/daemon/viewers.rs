//! A thread that tracks the viewers of the loopback and of PipeWire nodes, so that the frame path does not have to ask.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering::Relaxed};
use std::thread::JoinHandle;
use std::time::Duration;

use super::demand::Demand;
use crate::device::DeviceError;
use crate::device::v4l2::Viewers;
use crate::rt::clock::monotonic_ns;
use crate::rt::notifier::Notifier;
use crate::rt::stop::Stop;
use crate::share::Companions;

/// Waiting without an end, for a poll that wants one.
const LONG: Duration = Duration::from_secs(3600);

/// Who watches, for as long as this lives.
#[derive(Debug)]
pub(super) struct ViewerMonitor {
    known: ViewerStatus,
    over: Stop,
    notifier: Notifier,
    thread: Option<JoinHandle<()>>,
}

/// Who watches, for any thread to read.
#[derive(Clone, Debug, Default)]
pub(super) struct ViewerStatus(Arc<Counts>);

#[derive(Debug, Default)]
struct Counts {
    loopback: AtomicU32,
    companions: AtomicU32,
    wanted: AtomicBool,
}

impl ViewerMonitor {
    /// Follows who watches the loopback at `loopback` and the nodes of `companions`. `wake` is notified whenever an answer changes.
    ///
    /// # Errors
    /// Where it cannot be told.
    pub(super) fn follow(
        loopback: Option<&Path>,
        companions: Option<&Companions>,
        linger: Duration,
        wake: &Notifier,
    ) -> Result<Self, DeviceError> {
        let notifier = Notifier::new().map_err(|error| DeviceError::io("eventfd", "create", error))?;
        let (known, over) = (ViewerStatus::default(), Stop::default());
        let viewers = loopback.map(Viewers::of).transpose()?;
        if let (Some(path), Some(false)) = (loopback, viewers.as_ref().map(Viewers::are_told)) {
            tracing::info!(
                loopback = %path.display(),
                "v4l2loopback before 0.13 does not report viewers: every program that has the device open counts as one"
            );
        }
        if let Some(companions) = companions {
            companions.tell(&notifier);
            // Who was watching before is seen at once.
            notifier.notify();
        }
        let events = ViewerEvents { viewers, companions: companions.cloned(), notifier: notifier.clone() };
        let follow = {
            let (known, over, wake) = (known.clone(), over.clone(), wake.clone());
            move || events.follow(linger, &known, &over, &wake)
        };
        let thread = std::thread::Builder::new().name("viewers".into()).spawn(follow);
        let thread = Some(thread.map_err(|error| DeviceError::io("viewers thread", "start", error))?);
        Ok(Self { known, over, notifier, thread })
    }

    /// What is known of them.
    pub(super) fn status(&self) -> &ViewerStatus {
        &self.known
    }
}

/// What the thread listens to.
struct ViewerEvents {
    viewers: Option<Viewers>,
    companions: Option<Companions>,
    notifier: Notifier,
}

impl ViewerEvents {
    fn follow(mut self, linger: Duration, known: &ViewerStatus, over: &Stop, wake: &Notifier) {
        // Programs look at a loopback to see what it is; a PipeWire node streams only for those who watch.
        let (mut loopback, mut nodes) = (Demand::new(linger), Demand::exact(linger));
        while !over.is_set() {
            let now_ns = monotonic_ns();
            let timeout = [loopback.stays_for(now_ns), nodes.stays_for(now_ns)].into_iter().flatten().min();
            let count = match self.wait(timeout) {
                Ok(count) => count,
                Err(error) => {
                    // The next write to the device reports the fault.
                    tracing::warn!(%error, "cannot detect viewers any more, keeping the camera open");
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

    /// Waits until something changes, but no longer than `timeout`; says how many watch the loopback.
    fn wait(&mut self, timeout: Option<Duration>) -> Result<u32, DeviceError> {
        match &mut self.viewers {
            Some(viewers) => viewers.wait(&self.notifier, timeout),
            None => {
                // Past the moment, not short of it.
                self.notifier.wait(timeout.map_or(LONG, |timeout| timeout + Duration::from_millis(1)));
                Ok(0)
            }
        }
    }
}

impl ViewerStatus {
    /// Whether a program watches now: the loopback, or a node.
    pub(super) fn any(&self) -> bool {
        self.at_loopback() + self.0.companions.load(Relaxed) > 0
    }

    /// How many watch the loopback, as [`Viewers::wait`] has it.
    pub(super) fn at_loopback(&self) -> u32 {
        self.0.loopback.load(Relaxed)
    }

    /// Whether the camera should be open for them.
    pub(super) fn wants_camera(&self) -> bool {
        self.0.wanted.load(Relaxed)
    }

    pub(super) fn set(&self, loopback: u32, companions: u32, wanted: bool, wake: &Notifier) {
        let before = self.any();
        self.0.loopback.store(loopback, Relaxed);
        self.0.companions.store(companions, Relaxed);
        let changed = before != self.any();
        if self.0.wanted.swap(wanted, Relaxed) != wanted || changed {
            wake.notify();
        }
    }
}

impl Drop for ViewerMonitor {
    fn drop(&mut self) {
        self.over.set();
        self.notifier.notify();
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}
