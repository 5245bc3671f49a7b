//! One request, one answer: what the lines of the socket mean. Knows nothing of sockets.

use serde_json::{Value, json};

use super::{Desk, exposition};

/// Bytes of a request at most, its line end not counted.
pub const LONGEST_REQUEST: usize = 4096;

/// Answers one line. `who` asked, for the log.
pub(super) fn answer(line: &[u8], desk: &Desk, who: &str) -> String {
    let answered = std::str::from_utf8(line).map_err(|_| "a request is a line of UTF-8 text".to_owned());
    let value = answered
        .and_then(|line| understood(line.trim(), desk, who))
        .unwrap_or_else(|error| json!({ "ok": false, "error": error }));
    // One line: serde_json escapes line ends in strings and adds none.
    value.to_string()
}

fn understood(line: &str, desk: &Desk, who: &str) -> Result<Value, String> {
    let (word, rest) = line.split_once(char::is_whitespace).map_or((line, ""), |(word, rest)| (word, rest.trim()));
    let set = |assignment: &str| {
        let applied = desk.set(assignment).inspect_err(|error| tracing::warn!("refused to {who}: {error}"))?;
        if !applied.changed.is_empty() {
            tracing::info!("set by {who}: {}", assignment.trim());
        }
        json_of(&applied)
    };
    match (word, rest) {
        ("status", "") => Ok(json!({ "ok": true, "status": json_of(&desk.status())? })),
        ("prometheus", "") => Ok(json!({ "ok": true, "text": exposition::text(&desk.status(), &desk.tally) })),
        ("on", "") => set("stabilize.enabled=true"),
        ("off", "") => set("stabilize.enabled=false"),
        ("set", _) if rest.contains('=') => set(rest),
        ("set", _) => Err("write: set KEY=VALUE, as set smooth.strength=0.5".into()),
        ("reload", "") => desk.reload().and_then(|applied| json_of(&applied)),
        _ => Err("the requests are: status, prometheus, on, off, set KEY=VALUE, reload".into()),
    }
    .map(|mut value| {
        if let Value::Object(fields) = &mut value {
            fields.insert("ok".into(), true.into());
        }
        value
    })
}

fn json_of(value: &impl serde::Serialize) -> Result<Value, String> {
    serde_json::to_value(value).map_err(|error| format!("cannot be told as JSON: {error}"))
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::config::Settings;
    use crate::control::{Applied, Status};
    use crate::systemd::Systemd;

    /// A desk without a file.
    pub(in super::super) fn bare_desk() -> Desk {
        Desk::new(Settings::default(), Systemd::nobody(), Box::new(|| Err("there is no file".into())))
    }

    #[test]
    fn each_request_has_its_answer() {
        let desk = bare_desk();
        let ask = |line: &str| serde_json::from_str::<Value>(&answer(line.as_bytes(), &desk, "a test")).unwrap();
        let status = ask("status");
        assert_eq!(status["ok"], true);
        let status: Status = serde_json::from_value(status["status"].clone()).unwrap();
        assert_eq!((status.state.as_str(), status.enabled, status.pid), ("starting", true, std::process::id()));
        assert_eq!(status.settings["crop.zoom"], "1.1");
        let off: Applied = serde_json::from_value(ask("off\r")).unwrap();
        assert_eq!(off.changed, ["stabilize.enabled"]);
        assert_eq!(ask(" set   crop.zoom = 1.25 ")["changed"][0], "crop.zoom");
        assert_eq!(desk.live.params().crop.zoom, 1.25);
        assert!(ask("prometheus")["text"].as_str().unwrap().contains("gimbald_enabled 0"));
        for (wrong, what) in [
            ("", "the requests are"),
            ("STATUS", "the requests are"),
            ("status now", "the requests are"),
            ("set", "KEY=VALUE"),
            ("set crop.zoom=99", "1 to 2"),
            ("set output.device=5", "restart"),
            ("reload", "there is no file"),
        ] {
            let refused = ask(wrong);
            assert_eq!(refused["ok"], false, "{wrong}");
            assert!(refused["error"].as_str().unwrap().contains(what), "{wrong}: {refused}");
        }
        assert!(answer(b"\xff\xfe", &desk, "a test").contains("UTF-8"));
    }

    #[test]
    fn whatever_is_asked_the_answer_is_one_line() {
        let desk = bare_desk();
        for line in ["set a\nb=c", "set crop.zoom=\"\"\"\n1\n\"\"\"", "\u{2028}", "set \u{0}=\u{0}", &"x".repeat(100_000)] {
            let answer = answer(line.as_bytes(), &desk, "a test");
            assert!(!answer.contains('\n') && serde_json::from_str::<Value>(&answer).is_ok(), "{answer}");
            assert!(answer.len() < 2000, "{}", answer.len());
        }
    }
}
