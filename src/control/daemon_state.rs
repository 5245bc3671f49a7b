//! The settings of a running daemon, and the operations that change them.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use serde::{Deserialize, Serialize};

use super::log_limiter::{LogLimiter, Subject};
use super::reload::Reloads;
use super::{Metrics, Status, Unusable};
use crate::config::{Settings, keys};
use crate::pipeline::{Live, Reason};
use crate::systemd::Systemd;

/// Reads the configuration again; the error says what is wrong with it.
pub type Reread = Box<dyn Fn() -> Result<Settings, String> + Send + Sync>;

/// What a daemon's threads share: settings, counts.
pub struct DaemonState {
    /// The settings and counts of the pipeline.
    pub live: Live,
    /// What is counted.
    pub metrics: Metrics,
    configured: Mutex<Configured>,
    reread: Reread,
    /// The configuration file, for the status.
    configuration: Option<String>,
    pub(super) reloads: Reloads,
    log_limiter: Mutex<LogLimiter>,
    /// What was wrong with the configuration when it was read last.
    fault: Mutex<Option<String>>,
    systemd: Systemd,
    ready: AtomicBool,
}

struct Configured {
    /// What counts now.
    settings: Settings,
    /// Keys that have another value in the configuration.
    restart: Vec<String>,
}

/// What came of a change of settings.
#[derive(Clone, Debug, Default, Deserialize, PartialEq, Eq, Serialize)]
pub struct Applied {
    /// Keys that have a new value now.
    pub changed: Vec<String>,
    /// Keys whose new value needs a restart; the old one counts.
    pub restart: Vec<String>,
}

impl std::fmt::Debug for DaemonState {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("DaemonState").field("live", &self.live).field("metrics", &self.metrics).finish_non_exhaustive()
    }
}

impl DaemonState {
    /// The state of a daemon that starts with `settings`; `reread` loads the configuration again.
    pub fn new(settings: Settings, systemd: Systemd, reread: Reread) -> Self {
        Self {
            live: Live::new(&settings.pipeline),
            metrics: Metrics::default(),
            configured: Mutex::new(Configured { settings, restart: Vec::new() }),
            reread,
            configuration: None,
            reloads: Reloads::default(),
            log_limiter: Mutex::default(),
            fault: Mutex::default(),
            systemd,
            ready: AtomicBool::new(false),
        }
    }

    /// Names the configuration file in the status.
    #[must_use]
    pub fn with_configuration(self, path: Option<&Path>) -> Self {
        Self { configuration: path.map(|path| path.display().to_string()), ..self }
    }

    /// The settings that count now.
    pub fn settings(&self) -> Settings {
        self.configured().settings.clone()
    }

    /// The service manager.
    pub fn systemd(&self) -> Systemd {
        self.systemd
    }

    /// Tells the service manager that the service is ready, the first time. One atomic load otherwise.
    pub fn ready(&self) {
        if !self.ready.load(Ordering::Relaxed) && !self.ready.swap(true, Ordering::Relaxed) {
            self.systemd.ready();
        }
    }

    /// Takes one `KEY=VALUE`. Lasts until the configuration is reloaded.
    ///
    /// # Errors
    /// Why it cannot be: not such a key, not such a value, a key that no running daemon can change. Nothing has changed then.
    pub fn set(&self, assignment: &str) -> Result<Applied, String> {
        let mut configured = self.configured();
        let mut wanted = configured.settings.clone();
        wanted.set(assignment).map_err(|faults| {
            let faults: Vec<String> = faults.shown.iter().map(|fault| fault.bare()).collect();
            faults.join("; ")
        })?;
        let stuck: Vec<&str> = wanted.differing(&configured.settings).filter(|key| !key.live).map(|key| key.name).collect();
        if !stuck.is_empty() {
            let what = "cannot be changed at run time; set it in the configuration file and restart gimbald";
            return Err(format!("{}: {what}", stuck.join(", ")));
        }
        Ok(self.apply(&mut configured, &wanted))
    }

    /// A setting as it counts now, as TOML writes it.
    pub(super) fn value_text(&self, key: &str) -> String {
        keys::find(key).map_or_else(String::new, |key| key.value_text(&self.configured().settings))
    }

    /// Reads the configuration again and takes all of it that can change while gimbald runs; the service manager is told of both
    /// ends. Takes as long as the file does: [`DaemonState::reload_soon`] does not.
    ///
    /// # Errors
    /// What is wrong with the configuration; nothing has changed then.
    pub fn reload(&self) -> Result<Applied, String> {
        self.reload_and_say(true)
    }

    /// The same; the log says that nothing changed only where `aloud`.
    pub(super) fn reload_and_say(&self, aloud: bool) -> Result<Applied, String> {
        let ready = self.ready.load(Ordering::Relaxed);
        if ready {
            self.systemd.reloading();
        }
        let read = (self.reread)();
        let done = read.map(|wanted| {
            self.warn_of_retired(&wanted);
            let mut configured = self.configured();
            let applied = self.apply(&mut configured, &wanted);
            configured.restart.clone_from(&applied.restart);
            applied
        });
        // What is wrong with the file is said in any case, once: clients cannot make it something else again and again.
        let mut fault = self.fault.lock().unwrap_or_else(PoisonError::into_inner);
        let new_fault = done.as_ref().err().is_some_and(|what| fault.as_ref() != Some(what));
        *fault = done.as_ref().err().cloned();
        drop(fault);
        let news = aloud || done != Ok(Applied::default());
        if new_fault || (news && self.may_log(Subject::Reload, Instant::now())) {
            say_reloaded(&done);
        }
        if ready {
            self.systemd.ready();
        }
        done
    }

    /// Everything there is to tell.
    pub fn status(&self) -> Status {
        let (version, simd) = (env!("CARGO_PKG_VERSION").into(), crate::pipeline::simd().into());
        let mut status = Status { version, simd, pid: std::process::id(), ..Status::default() };
        self.metrics.fill(&mut status);
        let counts = self.live.counts();
        status.frames.captured = counts.frames_in;
        (status.drops.damaged, status.drops.cut, status.drops.behind) = (counts.damaged(), counts.cut, counts.dropped);
        let counted = Reason::ALL.into_iter().zip(counts.unusable).filter(|(_, count)| *count > 0);
        status.unusable_frames = counted.map(|(reason, count)| (reason.name().to_owned(), count)).collect();
        let (of, reasons) = self.live.stream();
        status.unusable = reasons.main().zip(reasons.in_words(of)).map(|(reason, what)| Unusable {
            frames: reasons.total(),
            of,
            reason: reason.name().to_owned(),
            what,
        });
        let configured = self.configured();
        status.enabled = configured.settings.pipeline.enabled;
        status.configuration.clone_from(&self.configuration);
        status.settings = keys::KEYS.iter().map(|key| (key.name.to_owned(), key.value_text(&configured.settings))).collect();
        status.restart.clone_from(&configured.restart);
        status
    }

    /// Says what `settings` has that has no effect any more.
    pub fn warn_of_retired(&self, settings: &Settings) {
        if !settings.retired.is_empty() && self.may_log(Subject::Reload, Instant::now()) {
            let retired: Vec<String> = settings.retired.iter().map(ToString::to_string).collect();
            tracing::warn!("{}", retired.join("; "));
        }
    }

    /// Takes what is live of `wanted`.
    fn apply(&self, configured: &mut Configured, wanted: &Settings) -> Applied {
        let mut applied = Applied::default();
        let before = configured.settings.clone();
        for key in wanted.differing(&before) {
            if key.live {
                key.copy(wanted, &mut configured.settings);
                applied.changed.push(key.name.to_owned());
            } else {
                applied.restart.push(key.name.to_owned());
            }
        }
        if !applied.changed.is_empty() {
            self.live.set(&configured.settings.pipeline);
            crate::log::set(configured.settings.log.level);
        }
        applied
    }

    fn configured(&self) -> MutexGuard<'_, Configured> {
        self.configured.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Whether a line that a client caused may go into the log now; where not, it is counted.
    pub(super) fn may_log(&self, about: Subject, now: Instant) -> bool {
        self.log_limiter().may_log(about, now)
    }

    /// Says how many lines were suppressed, when it is time.
    pub(super) fn flush_log_limiter(&self, now: Instant) {
        self.log_limiter().flush(now);
    }

    /// When it is time; `None` where nothing was suppressed.
    pub(super) fn log_limiter_due(&self) -> Option<Instant> {
        self.log_limiter().deadline()
    }

    fn log_limiter(&self) -> MutexGuard<'_, LogLimiter> {
        self.log_limiter.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// What came of a reading, for the log.
fn say_reloaded(done: &Result<Applied, String>) {
    match done {
        Ok(Applied { changed, restart }) => {
            let news = if changed.is_empty() { "no changes".into() } else { format!("changed: {}", changed.join(", ")) };
            let waiting = match restart.as_slice() {
                [] => String::new(),
                keys => format!("; takes effect after a restart: {}", keys.join(", ")),
            };
            tracing::info!("configuration reloaded, {news}{waiting}");
        }
        Err(what) => tracing::error!("configuration rejected, keeping the present settings: {what}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;

    fn state(file: &Arc<Mutex<String>>) -> DaemonState {
        let read = |text: &str| Settings::read(Some(("g.toml", text)), &[]).map_err(|faults| faults.to_string());
        let settings = read(&file.lock().unwrap()).unwrap();
        let file = file.clone();
        DaemonState::new(settings, Systemd::disconnected(), Box::new(move || read(&file.lock().unwrap())))
    }

    #[test]
    fn a_file_read_anew_changes_what_can_change_and_names_the_rest() {
        let file = Arc::new(Mutex::new("[crop]\nzoom = 1.2".to_owned()));
        let state = state(&file);
        assert_eq!(state.reload(), Ok(Applied::default()));
        *file.lock().unwrap() = "[crop]\nzoom = 1.3\n[camera]\ndevice = 4\n[smooth]\nstrength = 0.5".into();
        let applied = state.reload().unwrap();
        assert_eq!(
            (applied.changed.join(" "), applied.restart.join(" ")),
            ("smooth.strength crop.zoom".into(), "camera.device".into())
        );
        let params = state.live.params();
        assert_eq!((params.crop.zoom, params.smooth.strength), (1.3, 0.5));
        assert_eq!((state.settings().camera.device.as_str(), state.status().restart.len()), ("auto", 1), "the old one counts");
        *file.lock().unwrap() = "[crop]\nzoom = 77\n[smooth]\nstrength = 0.1".into();
        let error = state.reload().unwrap_err();
        assert!(error.contains("g.toml:2") && error.contains("77"), "{error}");
        assert_eq!(state.live.params(), params, "a wrong file changes nothing");
        *file.lock().unwrap() = "[crop]\nzoom = 1.3\n[smooth]\nstrength = 0.5".into();
        assert_eq!(state.reload(), Ok(Applied::default()));
        assert_eq!(state.status().restart, Vec::<String>::new(), "as it was again");
    }

    #[test]
    fn one_setting_is_taken_or_refused_whole() {
        let state = state(&Arc::default());
        assert_eq!(state.set("smooth.strength=0.25").unwrap().changed, ["smooth.strength"]);
        assert_eq!(state.set("stabilize.enabled=false").unwrap().changed, ["stabilize.enabled"]);
        assert_eq!(state.set("stabilize.enabled=false").unwrap(), Applied::default());
        assert_eq!(
            (state.live.params().smooth.strength, state.live.params().enabled, state.status().enabled),
            (0.25, false, false)
        );
        for (wrong, what) in [
            ("crop.zoom=9", "1 to 2"),
            ("crop.zooom=1.2", "did you mean crop.zoom"),
            ("camera.device=3", "restart gimbald"),
            ("nonsense", "no ="),
            ("", "no ="),
        ] {
            let error = state.set(wrong).unwrap_err();
            assert!(error.contains(what), "{wrong}: {error}");
        }
        assert_eq!(state.settings().pipeline.crop.zoom, 1.1);
    }
}
