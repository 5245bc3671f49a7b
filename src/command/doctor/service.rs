//! The checks of the service: what systemd and the running daemon report.

use std::process::Command;

use super::finding::Finding;
use crate::command::client::Target;
use crate::control::{RejectedFormat, Status, Unusable};
use crate::pipeline::Reason;

/// One unusable frame of so many is nothing to act upon.
const FEW: u64 = 100;

/// A camera that was opened gives its first frame within this time (seconds).
const SETTLED_S: f64 = 5.0;

/// What `systemctl show` says of the unit, as it prints it.
pub(super) fn systemctl_show(unit: &str) -> Option<String> {
    let properties = "LoadState,ActiveState,SubState,UnitFileState,NRestarts,Result,StatusText";
    let output = Command::new("systemctl").args(["show", unit, "--property", properties]).output().ok()?;
    output.status.success().then(|| String::from_utf8_lossy(&output.stdout).into_owned())
}

/// What that means.
pub(super) fn unit_finding(unit: &str, shown: Option<&str>) -> Finding {
    let Some(shown) = shown else {
        return Finding::note("service", "systemd is not available; run `gimbald run --config FILE` in a terminal instead");
    };
    let of = |name: &str| {
        let line = shown.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix('='));
        line.unwrap_or_default().to_owned()
    };
    let (active, status) = (of("ActiveState"), of("StatusText"));
    match (of("LoadState").as_str(), active.as_str()) {
        ("not-found", _) => {
            Finding::note("service", format!("{unit} is not installed; run `gimbald run` in a terminal instead"))
        }
        ("masked", _) => Finding::advice("service", format!("{unit} is masked"), format!("sudo systemctl unmask {unit}")),
        (_, "active" | "reloading") => {
            let restarts = of("NRestarts");
            let often =
                if restarts.is_empty() || restarts == "0" { String::new() } else { format!(", restarted {restarts} times") };
            let what = format!("{unit} is running{often}: {status}");
            if of("UnitFileState") == "disabled" {
                let mend = format!("sudo systemctl enable {unit}");
                return Finding::advice("service", format!("{what}; it is not started at boot"), mend);
            }
            Finding::good("service", what)
        }
        (_, "activating") => Finding::note("service", format!("{unit} is starting: {status}")),
        (_, "failed") => {
            let mend =
                format!("check the log with `journalctl -u {unit} -n 30`; when that is fixed: sudo systemctl restart {unit}");
            Finding::fault("service", format!("{unit} failed ({})", of("Result")), mend)
        }
        (load, active) => Finding::advice(
            "service",
            format!("{unit} is not running ({load}, {active})"),
            format!("sudo systemctl enable --now {unit}"),
        ),
    }
}

/// What the daemon says of its camera's frames, and of formats that it had to leave.
pub(super) fn frames(status: &Status) -> Vec<Finding> {
    let mut findings = Vec::new();
    let configured = status.settings.get("camera.format").map_or("\"auto\"", String::as_str);
    if let Some(Unusable { frames, of, reason, what }) = &status.unusable {
        let elsewhere = match (Reason::ALL.into_iter().find(|known| known.name() == reason), configured) {
            (Some(Reason::Size | Reason::Unsupported), _) => "choose another camera.format, or camera.width and camera.height",
            (_, "\"auto\"") => "try another cable, another port (no hub), or fewer devices on the same bus",
            _ => "set camera.format = \"auto\" to try the camera's other formats; or try another cable or port (no hub)",
        };
        findings.push(match () {
            () if frames == of => Finding::fault("frames", what, elsewhere),
            () if frames.saturating_mul(FEW) > *of => Finding::advice("frames", what, elsewhere),
            () => Finding::note("frames", what),
        });
    }
    if status.camera.is_some() && status.state == "streaming" && status.fps == 0.0 && status.since_s > SETTLED_S {
        let mend = "unplug the camera and plug it in again; `journalctl -u gimbald -n 30` shows what was tried";
        findings.push(Finding::fault("frames", "the camera is open but delivers no frames", mend));
    }
    for RejectedFormat { camera, format, what } in &status.formats_left {
        let what = format!("{format} of {camera} was rejected: {what}");
        let mend = format!(
            "once the cause is fixed: sudo systemctl restart gimbald; otherwise set camera.format to another format than {format}"
        );
        findings.push(Finding::advice("frames", what, mend));
    }
    findings
}

/// What the daemon says of itself; with its status where it answers.
pub(super) fn asked(target: &Target) -> (Finding, Option<Status>) {
    match target.connect().and_then(|mut connection| Ok(connection.status()?)) {
        Ok(status) => {
            let mut what = format!("running: {}, {}", status.state, status.what);
            if status.fps > 0.0 {
                what += &format!(", {:.1} fps", status.fps);
            }
            let finding = match (status.restart.as_slice(), status.version.as_str()) {
                (_, version) if version != env!("CARGO_PKG_VERSION") => {
                    let what =
                        format!("the daemon is version {version}, this program is version {}", env!("CARGO_PKG_VERSION"));
                    Finding::advice("daemon", what, "sudo systemctl restart gimbald")
                }
                ([], _) => Finding::good("daemon", what),
                (keys, _) => {
                    let what = format!("{what}\nneeds a restart to apply {}", keys.join(", "));
                    Finding::advice("daemon", what, "sudo systemctl restart gimbald")
                }
            };
            (finding, Some(status))
        }
        Err(failure) => (Finding::note("daemon", failure.message), None),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::command::doctor::finding::Severity;
    use crate::control::CameraInfo;

    #[test]
    fn frames_that_cannot_be_used_are_judged_by_their_share() {
        let frames_of = frames;
        let judged = |frames, of, reason: Reason, format: &str| {
            let unusable = Unusable { frames, of, reason: reason.name().into(), what: "why".into() };
            let settings = [("camera.format".to_owned(), format.to_owned())].into();
            let status = Status { unusable: Some(unusable), settings, ..Status::default() };
            let [finding] = frames_of(&status).try_into().unwrap();
            finding
        };
        assert_eq!(judged(30, 30, Reason::Damaged, "\"auto\"").severity, Severity::Fault);
        assert!(judged(30, 30, Reason::Damaged, "\"auto\"").mend.contains("cable"));
        assert!(judged(30, 30, Reason::Damaged, "\"mjpeg\"").mend.contains("camera.format = \"auto\""));
        assert!(judged(30, 30, Reason::Size, "\"mjpeg\"").mend.contains("camera.width"));
        assert_eq!(judged(6, 30, Reason::Marked, "\"auto\"").severity, Severity::Advice);
        assert_eq!(judged(1, 3000, Reason::Marked, "\"auto\"").severity, Severity::Note);
        let left = RejectedFormat { camera: "C".into(), format: "mjpeg".into(), what: "why".into() };
        let status = Status { formats_left: vec![left], ..Status::default() };
        assert!(frames_of(&status)[0].to_string().contains("mjpeg of C was rejected: why"));
        assert_eq!(frames_of(&Status::default()), []);
        let silent =
            Status { camera: Some(CameraInfo::default()), state: "streaming".into(), since_s: 9.0, ..Status::default() };
        assert!(frames_of(&silent)[0].what.contains("delivers no frames"));
        assert_eq!(frames_of(&Status { fps: 30.0, ..silent.clone() }), []);
        assert_eq!(frames_of(&Status { since_s: 1.0, ..silent }), [], "it was just opened");
    }

    #[test]
    fn each_state_has_its_judgement() {
        let show = |load: &str, active: &str, file: &str, restarts: &str| {
            format!("LoadState={load}\nActiveState={active}\nUnitFileState={file}\nNRestarts={restarts}\nStatusText=x to y\n")
        };
        for (shown, severity, words) in [
            (Some(show("loaded", "active", "enabled", "0")), Severity::Good, "x to y"),
            (Some(show("loaded", "active", "enabled", "3")), Severity::Good, "restarted 3 times"),
            (Some(show("loaded", "active", "disabled", "0")), Severity::Advice, "systemctl enable g"),
            (Some(show("loaded", "inactive", "disabled", "0")), Severity::Advice, "enable --now g"),
            (Some(show("loaded", "failed", "enabled", "10")), Severity::Fault, "journalctl -u g"),
            (Some(show("not-found", "inactive", "", "")), Severity::Note, "not installed"),
            (Some(String::new()), Severity::Advice, "is not running"),
            (None, Severity::Note, "systemd is not available"),
        ] {
            let finding = unit_finding("g", shown.as_deref());
            assert_eq!(finding.severity, severity, "{finding}");
            assert!(finding.to_string().contains(words), "{words} in {finding}");
        }
    }
}
