//! Replies to clients: one line of JSON for each [`Reply`].

use serde::{Deserialize, Serialize};

use super::{Applied, HistoryPart, RequestError, Status};

/// One reply. On the wire it is an object with the fields below and `ok`, which is false for [`Reply::Refused`] alone.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
#[serde(untagged)]
pub enum Reply {
    /// The state of the daemon.
    Status {
        /// All of it.
        status: Box<Status>,
    },
    /// The state of the daemon for Prometheus.
    Metrics {
        /// In Prometheus' text format, version 0.0.4.
        text: String,
    },
    /// What happened to the last frames.
    History {
        /// Some of them.
        history: HistoryPart,
    },
    /// It was not done.
    Refused(Refusal),
    /// It was done; says what changed.
    Applied(Applied),
}

/// Why something was not done.
#[derive(Clone, Debug, Deserialize, Eq, PartialEq, Serialize)]
pub struct Refusal {
    /// For people: what is wrong, what was expected, what to do.
    pub error: String,
    /// For programs.
    #[serde(default)]
    pub kind: RefusalKind,
}

/// The kinds of refusal.
#[derive(Clone, Copy, Debug, Default, Deserialize, Eq, PartialEq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum RefusalKind {
    /// The line is no request.
    Request,
    /// The setting cannot be changed so.
    Setting,
    /// The configuration file was not taken; everything stays as it was.
    Configuration,
    /// Too much is asked at once; later it may work.
    Busy,
    /// The configuration file takes long to be read; it is taken when it has been.
    Late,
    /// Another, of a newer or older daemon.
    #[default]
    #[serde(other)]
    Other,
}

impl From<RequestError> for Refusal {
    fn from(error: RequestError) -> Self {
        Self { error: error.to_string(), kind: RefusalKind::Request }
    }
}

/// A reply with its `ok`.
#[derive(Deserialize, Serialize)]
struct Wire<R> {
    ok: bool,
    #[serde(flatten)]
    reply: R,
}

impl Reply {
    /// A refusal of the given kind.
    pub fn refused(kind: RefusalKind, error: impl Into<String>) -> Self {
        Self::Refused(Refusal { error: error.into(), kind })
    }

    /// The line to send for it, with its line end: JSON, which has no other.
    pub fn line(&self) -> String {
        let wire = Wire { ok: !matches!(self, Self::Refused(_)), reply: self };
        // Numbers, text and maps by text: nothing that JSON could not say (what is not a number becomes null).
        serde_json::to_string(&wire).unwrap_or_default() + "\n"
    }

    /// Reads a line, with or without its line end. Fields that are not known here are passed over.
    ///
    /// # Errors
    /// Where the line is not a reply.
    pub fn read(line: &str) -> Result<Self, String> {
        let Wire { ok, reply } = serde_json::from_str(line).map_err(|error| error.to_string())?;
        match reply {
            Self::Refused(_) if ok => Err("a refusal that says ok".to_owned()),
            Self::Status { .. } | Self::Metrics { .. } | Self::History { .. } | Self::Applied(_) if !ok => {
                Err("refused without a reason".to_owned())
            }
            reply => Ok(reply),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_reply_is_written_and_read() {
        let status = Status { state: "idle".into(), pid: 7, fps: 29.97, ..Status::default() };
        let applied = Applied { changed: vec!["crop.zoom".into()], restart: Vec::new() };
        let replies = [
            (Reply::Status { status: Box::new(status) }, "{\"ok\":true,\"status\":{"),
            (Reply::Metrics { text: "a 1\nb 2\n".into() }, "{\"ok\":true,\"text\":\"a 1\\nb 2\\n\"}\n"),
            (
                Reply::History { history: HistoryPart { frames: Vec::new(), next: 7 } },
                "{\"ok\":true,\"history\":{\"frames\":[],\"next\":7}}\n",
            ),
            (Reply::Applied(applied), "{\"ok\":true,\"changed\":[\"crop.zoom\"],\"restart\":[]}\n"),
            (
                Reply::refused(RefusalKind::Setting, "no\nsuch key"),
                "{\"ok\":false,\"error\":\"no\\nsuch key\",\"kind\":\"setting\"}\n",
            ),
        ];
        for (reply, begin) in replies {
            let line = reply.line();
            assert!(line.starts_with(begin) && line.matches('\n').count() == 1, "{line}");
            assert_eq!(Reply::read(&line), Ok(reply));
        }
        for kind in [
            RefusalKind::Request,
            RefusalKind::Setting,
            RefusalKind::Configuration,
            RefusalKind::Busy,
            RefusalKind::Late,
            RefusalKind::Other,
        ] {
            let reply = Reply::refused(kind, "x");
            assert_eq!(Reply::read(&reply.line()), Ok(reply));
        }
    }

    #[test]
    fn replies_of_other_versions_are_read_as_far_as_they_go() {
        let read = |line: &str| Reply::read(line);
        assert_eq!(read("{\"ok\":false,\"error\":\"x\"}"), Ok(Reply::refused(RefusalKind::Other, "x")));
        assert_eq!(read("{\"ok\":false,\"error\":\"x\",\"kind\":\"new\"}"), Ok(Reply::refused(RefusalKind::Other, "x")));
        assert_eq!(read("{\"ok\":true,\"changed\":[],\"restart\":[],\"new\":1}"), Ok(Reply::Applied(Applied::default())));
        for wrong in ["", "{}", "[]", "{\"ok\":true}", "{\"ok\":false}", "{\"ok\":false,\"changed\":[],\"restart\":[]}"] {
            assert!(read(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn numbers_that_json_does_not_have_do_not_break_the_line() {
        let status = Status { fps: f64::NAN, ..Status::default() };
        assert!(Reply::Status { status: Box::new(status) }.line().starts_with("{\"ok\":true"));
    }
}
