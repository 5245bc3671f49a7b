//! Executes a request and returns its reply.

use std::time::Instant;

use super::log_limiter::Subject;
use super::{Applied, DaemonState, RefusalKind, Reply, Request, exposition};

/// Does what is asked. `who` asked, for the log. [`Request::Reload`] takes as long as the configuration file does.
pub(super) fn answer(request: &Request, state: &DaemonState, who: &str) -> Reply {
    match request {
        Request::Status => Reply::Status { status: Box::new(state.status()) },
        Request::Prometheus => Reply::Metrics { text: exposition::text(&state.status(), &state.metrics) },
        Request::History(first) => Reply::History { history: state.metrics.history_since(first.0) },
        Request::On => set(state, "stabilize.enabled=true", who),
        Request::Off => set(state, "stabilize.enabled=false", who),
        Request::Set(assignment) => set(state, &assignment.to_string(), who),
        Request::Reload => match state.reload() {
            Ok(applied) => Reply::Applied(applied),
            Err(error) => Reply::refused(RefusalKind::Configuration, error),
        },
    }
}

fn set(state: &DaemonState, assignment: &str, who: &str) -> Reply {
    match state.set(assignment) {
        Ok(applied) => {
            if !applied.changed.is_empty() && state.may_log(Subject::Change, Instant::now()) {
                tracing::info!("set by {who}: {}", changes_text(state, &applied));
            }
            Reply::Applied(applied)
        }
        Err(error) => {
            if state.may_log(Subject::Refusal, Instant::now()) {
                tracing::warn!("refused a request of {who}: {error}");
            }
            Reply::refused(RefusalKind::Setting, error)
        }
    }
}

/// The new values, as they were understood: what a client writes may hold anything.
fn changes_text(state: &DaemonState, applied: &Applied) -> String {
    applied.changed.iter().map(|key| format!("{key}={}", state.value_text(key))).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::config::Settings;
    use crate::systemd::Systemd;

    /// A state without a file.
    pub(in super::super) fn bare_state() -> DaemonState {
        DaemonState::new(Settings::default(), Systemd::disconnected(), Box::new(|| Err("there is no file".into())))
    }

    #[test]
    fn each_request_has_its_reply() {
        let state = bare_state();
        let ask = |line: &str| answer(&Request::read(line.as_bytes()).unwrap(), &state, "a test");
        let Reply::Status { status } = ask("status") else { panic!("no status") };
        assert_eq!((status.state.as_str(), status.enabled, status.pid), ("starting", true, std::process::id()));
        assert_eq!(status.settings["crop.zoom"], "1.1");
        let changed = |key: &str| Reply::Applied(Applied { changed: vec![key.into()], restart: Vec::new() });
        assert_eq!(ask("off"), changed("stabilize.enabled"));
        assert_eq!(ask("off"), Reply::Applied(Applied::default()));
        assert_eq!(ask("set crop.zoom = 1.25"), changed("crop.zoom"));
        assert_eq!(state.live.params().crop.zoom, 1.25);
        assert!(matches!(ask("prometheus"), Reply::Metrics { text } if text.contains("gimbald_enabled 0")));
        assert_eq!(ask("on"), changed("stabilize.enabled"));
        for (wrong, kind, what) in [
            ("set crop.zoom=99", RefusalKind::Setting, "1 to 2"),
            ("set output.device=5", RefusalKind::Setting, "restart"),
            ("set a=", RefusalKind::Setting, "no such key"),
            ("reload", RefusalKind::Configuration, "there is no file"),
        ] {
            let Reply::Refused(refusal) = ask(wrong) else { panic!("{wrong}: done") };
            assert!(refusal.kind == kind && refusal.error.contains(what), "{wrong}: {refusal:?}");
        }
    }

    #[test]
    fn whatever_is_set_the_reply_is_one_short_line() {
        let state = bare_state();
        for text in ["a\nb=c", "crop.zoom=\"\"\"\n1\n\"\"\"", "\u{2028}=", "\u{0}=\u{0}", &format!("a={}", "x".repeat(100_000))]
        {
            let line = answer(&Request::Set(text.parse().unwrap()), &state, "a test").line();
            assert!(line.matches('\n').count() == 1 && line.len() < 2000, "{line}");
        }
    }
}
