//! Parses one line from a client into a [`Request`]. Pure functions without sockets.

use serde::de::value::{Error as Plain, MapAccessDeserializer, MapDeserializer, StrDeserializer};
use serde::{Deserialize, Serialize};

/// Bytes of a request at most, its line end not counted.
pub const LONGEST_REQUEST: usize = 4096;
/// Characters of a client's text that an error repeats, at most.
const SHOWN: usize = 80;

/// One request. As JSON: `"status"`, `{"set":"crop.zoom=1.2"}`.
#[derive(Clone, Debug, Deserialize, Eq, PartialEq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Request {
    /// The state of the daemon; answered with [`Reply::Status`](super::Reply::Status).
    Status,
    /// The same for Prometheus; answered with [`Reply::Metrics`](super::Reply::Metrics).
    Prometheus,
    /// What happened to the last frames, from this number on; answered with [`Reply::History`](super::Reply::History).
    History(FrameNumber),
    /// Switch stabilization on; answered with [`Reply::Applied`](super::Reply::Applied).
    On,
    /// Switch it off; answered as `On`.
    Off,
    /// Change one setting until the configuration is read again; answered as `On`.
    Set(Assignment),
    /// Read the configuration file again; answered as `On`.
    Reload,
}

/// Number of a frame, counted since the daemon started. As JSON a number, or its digits as text.
#[derive(Clone, Copy, Debug, Default, Deserialize, Eq, PartialEq, Serialize)]
#[serde(try_from = "NumberOrText")]
pub struct FrameNumber(pub u64);

#[derive(Deserialize)]
#[serde(untagged, expecting = "expected the number of a frame, as in history 0")]
enum NumberOrText {
    Number(u64),
    Text(String),
}

impl TryFrom<NumberOrText> for FrameNumber {
    type Error = &'static str;

    fn try_from(written: NumberOrText) -> Result<Self, Self::Error> {
        match written {
            NumberOrText::Number(number) => Ok(Self(number)),
            NumberOrText::Text(text) => text.parse().map(Self).map_err(|_| "expected the number of a frame, as in history 0"),
        }
    }
}

/// One setting and its new value, written `KEY=VALUE`. Whether there is such a key and what it takes is not known here.
#[derive(Clone, Debug, Deserialize, Eq, PartialEq, Serialize)]
#[serde(try_from = "String", into = "String")]
pub struct Assignment {
    key: String,
    value: String,
}

impl Assignment {
    /// The key, without spaces around it.
    pub fn key(&self) -> &str {
        &self.key
    }

    /// The value as in the configuration file (text needs no quotes), without spaces around it.
    pub fn value(&self) -> &str {
        &self.value
    }
}

impl std::str::FromStr for Assignment {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (key, value) = text.split_once('=').ok_or("expected KEY=VALUE, as in set smooth.strength=0.5")?;
        Ok(Self { key: key.trim().to_owned(), value: value.trim().to_owned() })
    }
}

impl TryFrom<String> for Assignment {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl From<Assignment> for String {
    fn from(assignment: Assignment) -> Self {
        assignment.to_string()
    }
}

impl std::fmt::Display for Assignment {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}={}", self.key, self.value)
    }
}

/// Why a line is not a request.
#[derive(Clone, Debug, Eq, PartialEq, thiserror::Error)]
pub enum RequestError {
    /// More than [`LONGEST_REQUEST`] bytes.
    #[error("request too long: at most {LONGEST_REQUEST} bytes are allowed")]
    TooLong,
    /// Bytes that are not text.
    #[error("invalid request: expected a line of UTF-8 text")]
    NotText,
    /// Text that is no request; says which text and what was expected.
    #[error("invalid request {text}: {what}; expected status, prometheus, history NUMBER, on, off, set KEY=VALUE, reload")]
    Unknown {
        /// The beginning of what was sent.
        text: String,
        /// What is wrong with it.
        what: String,
    },
}

impl Request {
    /// Reads one line without its line end: words, as `status` or `set KEY=VALUE`, or the same as JSON, where the line begins with
    /// `{` or `"`.
    ///
    /// # Errors
    /// Where the line is too long, is not UTF-8, or is not one of the requests.
    pub fn read(line: &[u8]) -> Result<Self, RequestError> {
        if line.len() > LONGEST_REQUEST {
            return Err(RequestError::TooLong);
        }
        let line = std::str::from_utf8(line).map_err(|_| RequestError::NotText)?.trim();
        let read = if line.starts_with(['{', '"']) {
            serde_json::from_str(line).map_err(|error| error.to_string())
        } else {
            let (word, rest) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
            Self::from_words(word, rest.trim())
        };
        read.map_err(|what| RequestError::Unknown { text: quoted(line), what: shortened(&what) })
    }

    /// The line to send for it, without a line end. In words, which daemons of every version understand, where words can say it.
    pub fn line(&self) -> String {
        match self {
            Self::Set(assignment) if !assignment.to_string().contains(char::is_control) => format!("set {assignment}"),
            Self::Set(_) => self.json(),
            Self::History(FrameNumber(number)) => format!("history {number}"),
            _ => self.json().trim_matches('"').to_owned(),
        }
    }

    /// The same as JSON, which never contains a line end.
    pub fn json(&self) -> String {
        // Strings alone are in it: nothing that JSON could not say.
        serde_json::to_string(self).unwrap_or_default()
    }

    fn from_words(word: &str, rest: &str) -> Result<Self, String> {
        match (Self::deserialize(StrDeserializer::<Plain>::new(word)), rest) {
            (Ok(request), "") => Ok(request),
            (Ok(_), _) => Err(format!("{word} takes no arguments")),
            (Err(_), _) if word.is_empty() => Err("the line is empty".to_owned()),
            (Err(_), _) => {
                let pair = MapDeserializer::<_, Plain>::new(std::iter::once((word, rest)));
                Self::deserialize(MapAccessDeserializer::new(pair)).map_err(|error| error.to_string())
            }
        }
    }
}

/// `text` in quotes, without control characters, cut where it is long.
fn quoted(text: &str) -> String {
    format!("{:?}", shortened(text))
}

fn shortened(text: &str) -> String {
    let mut characters = text.chars().map(|c| if c.is_control() { ' ' } else { c });
    let mut short: String = characters.by_ref().take(SHOWN).collect();
    if characters.next().is_some() {
        short.push_str("...");
    }
    short
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn read(line: &str) -> Result<Request, String> {
        Request::read(line.as_bytes()).map_err(|error| error.to_string())
    }

    fn assignment(text: &str) -> Request {
        Request::Set(text.parse().unwrap())
    }

    #[test]
    fn every_request_is_read_from_words_and_from_json() {
        let set = assignment("crop.zoom=1.25");
        for (request, words, json) in [
            (Request::Status, "status", "\"status\""),
            (Request::Prometheus, "prometheus", "\"prometheus\""),
            (Request::History(FrameNumber(41)), "history 41", "{\"history\":41}"),
            (Request::On, "on", "\"on\""),
            (Request::Off, "off", "\"off\""),
            (set, "set crop.zoom=1.25", "{\"set\":\"crop.zoom=1.25\"}"),
            (Request::Reload, "reload", "\"reload\""),
        ] {
            assert_eq!(read(words).as_ref(), Ok(&request));
            assert_eq!(read(&format!("  {words}\r")).as_ref(), Ok(&request));
            assert_eq!(read(json).as_ref(), Ok(&request));
            assert_eq!((request.line().as_str(), request.json().as_str()), (words, json));
        }
        assert_eq!(read("set   crop.zoom = 1.25 "), read("set crop.zoom=1.25"));
        let Ok(Request::Set(text)) = read("set camera.device=a=b c") else { panic!("not a set") };
        assert_eq!((text.key(), text.value()), ("camera.device", "a=b c"));
    }

    #[test]
    fn what_is_no_request_is_named() {
        for (line, what) in [
            ("", "the line is empty"),
            ("STATUS", "\"STATUS\""),
            ("status now", "status takes no arguments"),
            ("set", "KEY=VALUE"),
            ("set crop.zoom", "KEY=VALUE"),
            ("\"set\"", "invalid request"),
            ("{\"set\":5}", "invalid type"),
            ("history", "expected the number of a frame"),
            ("history -1", "expected the number of a frame"),
            ("{\"history\":-1}", "expected the number of a frame"),
            ("{\"history\":[]}", "expected the number of a frame"),
            ("{\"set\":\"a=b\",\"on\":null}", "invalid request"),
            ("{\"status\":", "EOF"),
            ("\"status\" \"on\"", "trailing"),
            ("{\"launch\":1}", "launch"),
        ] {
            let error = read(line).unwrap_err();
            assert!(error.contains(what) && error.contains("expected status"), "{line}: {error}");
        }
        assert_eq!(Request::read(b"\xff\xfe"), Err(RequestError::NotText));
        assert_eq!(Request::read(&[b'x'; LONGEST_REQUEST + 1]), Err(RequestError::TooLong));
        let longest = format!("set a={}", "b".repeat(LONGEST_REQUEST - 6));
        assert!(read(&longest).is_ok());
    }

    proptest! {
        #[test]
        fn whatever_is_sent_the_answer_is_short_and_without_control_characters(
            line in proptest::collection::vec(any::<u8>(), 0..300)
        ) {
            if let Err(error) = Request::read(&line) {
                let text = error.to_string();
                prop_assert!(text.len() < 1200 && !text.contains(char::is_control), "{text}");
            }
        }

        #[test]
        fn what_is_read_is_written_so_that_it_is_read_again(key in "[^=]{0,20}", value in "\\PC{0,40}") {
            let request = assignment(&format!("{key}={value}"));
            prop_assert!(!request.line().contains('\n'));
            prop_assert_eq!(Request::read(request.line().as_bytes()), Ok(request.clone()));
            prop_assert_eq!(Request::read(request.json().as_bytes()), Ok(request));
        }
    }
}
