//! The checks of PipeWire: its library, the companion, the node, and what browsers need to see it.

use std::path::Path;
use std::process::Command;

use super::finding::Finding;
use crate::pipewire::Library;

/// The companion's unit.
const UNIT: &str = "gimbald-pipewire.service";

/// Where the package puts the rules that hide other nodes.
const EXAMPLES: &str = "/usr/share/doc/gimbald/examples/wireplumber";

/// What was seen of PipeWire.
#[derive(Clone, Debug, Default)]
struct Seen {
    /// The library's version, or what is missing.
    library: Option<Result<String, String>>,
    /// Whether the user's PipeWire runs; `None` without a login session (as with sudo).
    runs: Option<bool>,
    /// What `systemctl --user is-active` says of the companion; `None` where there is no such manager.
    unit: Option<String>,
    /// The objects that PipeWire has, where `pw-dump` is there to say so.
    objects: Option<Vec<serde_json::Value>>,
}

/// Whether there is a library to make PipeWire cameras with.
pub(super) fn is_usable() -> bool {
    Library::open().is_ok()
}

/// Looks at PipeWire as this user has it. `wanted`: the value of `output.pipewire`, `None` for "auto".
pub(super) fn looked_at(instance: Option<&str>, loopback: Option<&Path>, wanted: Option<bool>) -> Vec<Finding> {
    let runtime = std::env::var_os("XDG_RUNTIME_DIR");
    let runs = runtime.map(|runtime| Path::new(&runtime).join("pipewire-0").exists());
    let seen = Seen {
        library: Some(Library::open().map(Library::version).map_err(|missing| missing.to_string())),
        runs,
        unit: runs.and_then(|_| output_of("systemctl", &["--user", "is-active", UNIT])).map(|state| state.trim().to_owned()),
        objects: runs.filter(|runs| *runs).and_then(|_| output_of("pw-dump", &[])).map(|text| {
            let lists = serde_json::Deserializer::from_str(&text).into_iter::<Vec<serde_json::Value>>();
            lists.map_while(Result::ok).flatten().collect()
        }),
    };
    findings(&seen, instance, loopback, wanted)
}

/// What a program writes to its standard output, whatever its exit code; `None` where it is not there.
fn output_of(program: &str, arguments: &[&str]) -> Option<String> {
    let output = Command::new(program).args(arguments).output().ok()?;
    Some(String::from_utf8_lossy(&output.stdout).into_owned())
}

/// With `output.pipewire = "auto"` PipeWire may be absent without harm where there is a loopback; otherwise what is missing is advice, and a
/// fault where the library is missing that the setting `true` counts on.
fn findings(seen: &Seen, instance: Option<&str>, loopback: Option<&Path>, wanted: Option<bool>) -> Vec<Finding> {
    let note = |what: String| Finding::note("pipewire", what);
    let version = match &seen.library {
        Some(Ok(version)) => version,
        Some(Err(missing)) if wanted == Some(true) => {
            let mend = "install it, or set output.pipewire = \"auto\"";
            return vec![Finding::fault("pipewire", format!("no PipeWire camera: {missing}"), mend)];
        }
        Some(Err(missing)) => return vec![note(format!("no PipeWire camera: {missing}"))],
        None => return Vec::new(),
    };
    match seen.runs {
        None => {
            return vec![note(
                "PipeWire runs in a user's session; to check it, run `gimbald doctor` there, without sudo".into(),
            )];
        }
        Some(false) => return vec![note("PipeWire is not running in this session, so there is no PipeWire camera".into())],
        Some(true) => {}
    }
    let node = match instance {
        Some(instance) => format!("gimbald.{instance}"),
        None => "gimbald".into(),
    };
    let nodes: Vec<&serde_json::Value> = seen.objects.iter().flatten().map(|object| &object["info"]["props"]).collect();
    let mut findings = Vec::new();
    let is_there = nodes.iter().any(|props| props["node.name"] == node.as_str());
    match (is_there, seen.objects.is_some(), seen.unit.as_deref()) {
        (true, ..) => findings.push(Finding::good("pipewire", format!("the camera {node} is available (PipeWire {version})"))),
        (false, false, Some("active")) => {
            findings.push(Finding::good(
                "pipewire",
                format!("{UNIT} is running (PipeWire {version}); install pw-dump for more details"),
            ));
        }
        (false, true, Some("active")) => {
            let what = format!("{UNIT} is running, but PipeWire has no camera {node}");
            findings.push(Finding::advice("pipewire", what, format!("journalctl --user -u {UNIT} -n 30")));
        }
        (false, ..) => {
            let what = format!("PipeWire is running, but no companion offers the camera {node}");
            let mend = format!("systemctl --user enable --now {UNIT}");
            findings.push(if wanted.is_none() && loopback.is_some() {
                note(format!("{what}; to enable it: {mend}"))
            } else {
                Finding::advice("pipewire", what, mend)
            });
        }
    }
    if is_there {
        findings.push(browsers());
    }
    if let (Some(loopback), Some(_)) = (loopback, &seen.objects) {
        findings.push(twin(&nodes, loopback));
    }
    findings
}

/// What browsers need in order to list PipeWire cameras.
fn browsers() -> Finding {
    let what = "browsers: Chromium supports PipeWire cameras with --enable-features=WebRtcPipeWireCamera (chrome://flags), Firefox with \
                media.webrtc.camera.allow-pipewire = true (about:config; some distributions set it)";
    Finding::note("pipewire", what)
}

/// Whether PipeWire, which has these nodes, lists the loopback as well.
fn twin(nodes: &[&serde_json::Value], loopback: &Path) -> Finding {
    let shown = loopback.display();
    let is_listed =
        |props: &&serde_json::Value| props["api.v4l2.path"].as_str().is_some_and(|path| Path::new(path) == loopback);
    Finding::note(
        "pipewire",
        if nodes.iter().any(is_listed) {
            format!("PipeWire also lists the loopback {shown}; the rules in {EXAMPLES} hide it, and the real camera")
        } else {
            format!(
                "PipeWire does not list the loopback {shown}: WirePlumber started before it had a writer. If a program needs it through \
                 PipeWire: systemctl --user restart wireplumber"
            )
        },
    )
}

#[cfg(test)]
mod tests {
    use super::super::finding::Severity;
    use super::*;

    fn words(findings: &[Finding]) -> String {
        findings.iter().map(ToString::to_string).collect()
    }

    #[test]
    fn each_state_has_its_words() {
        let there = serde_json::json!({"info": {"props": {"node.name": "gimbald"}}});
        let twin = serde_json::json!({"info": {"props": {"node.name": "v4l2_input.x", "api.v4l2.path": "/dev/video9"}}});
        let seen = Seen {
            library: Some(Ok("1.4.2".into())),
            runs: Some(true),
            unit: Some("active".into()),
            objects: Some(vec![there, twin]),
        };
        let judge = |seen: &Seen| findings(seen, None, Some(Path::new("/dev/video9")), Some(true));
        let good = judge(&seen);
        assert!(
            good[0].severity == Severity::Good && good.iter().all(|finding| finding.severity <= Severity::Note),
            "{good:?}"
        );
        let text = words(&good);
        for part in ["WebRtcPipeWireCamera", "media.webrtc.camera.allow-pipewire", "lists the loopback /dev/video9"] {
            assert!(text.contains(part), "{part} in {text}");
        }
        let missed = findings(&seen, None, Some(Path::new("/dev/video8")), None);
        assert!(words(&missed).contains("restart wireplumber"));
        let other = findings(&seen, Some("desk"), None, None);
        assert!(other[0].severity == Severity::Advice && other[0].what.contains("gimbald.desk"), "{other:?}");
        let stopped_seen = Seen { unit: Some("inactive".into()), objects: Some(Vec::new()), ..seen.clone() };
        let stopped = judge(&stopped_seen);
        assert!(stopped[0].mend.contains("enable --now gimbald-pipewire"), "{stopped:?}");
        let automatic = findings(&stopped_seen, None, Some(Path::new("/dev/video9")), None);
        assert!(automatic[0].severity == Severity::Note && automatic[0].what.contains("to enable it"), "{automatic:?}");
        let alone = findings(&stopped_seen, None, None, None);
        assert!(alone[0].severity == Severity::Advice, "without a loopback it is the only output: {alone:?}");
        let lacking = Seen { library: Some(Err("install libpipewire".into())), ..seen.clone() };
        assert_eq!(judge(&lacking)[0].severity, Severity::Fault, "it was counted on");
        let judge = |seen: &Seen| findings(seen, None, Some(Path::new("/dev/video9")), None);
        for (seen, part) in [
            (lacking, "install libpipewire"),
            (Seen { runs: None, ..seen.clone() }, "without sudo"),
            (Seen { runs: Some(false), ..seen.clone() }, "is not running"),
        ] {
            let findings = judge(&seen);
            assert!(findings.len() == 1 && findings[0].severity == Severity::Note, "{findings:?}");
            assert!(findings[0].what.contains(part), "{part} in {findings:?}");
        }
    }
}
