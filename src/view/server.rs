//! The web server: threads that check and answer requests.

use std::io::{self, Read};
use std::net::{Ipv4Addr, SocketAddr};
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::time::Duration;

use serde_json::{Value, json};
use tiny_http::{Header, Method, Request, Response, StatusCode};

use super::access::{Access, RequestInfo};
use super::backend::{Backend, is_offered, offered};
use super::config_file;
use super::preview::{self, Cursor, Preview};
use crate::config::{Key, Settings, keys};
use crate::report::MotionNames;
use crate::rt::stop::Stop;

/// Requests that are answered at a time. Each page has one that waits for its next picture.
const THREADS: usize = 16;
/// Interval at which the stop flag is checked.
const CHECK_STOP: Duration = Duration::from_millis(200);
/// How long a request waits for the next picture.
const TIMEOUT: Duration = Duration::from_millis(1000);
/// Maximum bytes of a request's body.
const MAX_BODY: u64 = 4096;

const HTML: &str = include_str!("page/page.html");
const STYLE: &str = include_str!("page/style.css");
const SCRIPT: &str = include_str!("page/script.js");

/// A server on the loopback interface.
pub struct Server {
    http: tiny_http::Server,
    access: Access,
    /// The page. Its script and style carry the nonce of `policy`.
    page: String,
    policy: String,
    failed: AtomicBool,
}

impl std::fmt::Debug for Server {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Server").finish_non_exhaustive()
    }
}

impl Server {
    /// Listens at `port` of 127.0.0.1; 0 picks a free one.
    ///
    /// # Errors
    /// A port that is taken, or no random numbers.
    pub fn open(port: u16) -> io::Result<Self> {
        let http = tiny_http::Server::http(SocketAddr::from((Ipv4Addr::LOCALHOST, port))).map_err(io::Error::other)?;
        let address = http.server_addr().to_ip().ok_or_else(|| io::Error::other("no address"))?;
        let access = Access::new(address.port())?;
        let nonce = Access::new(0)?.token().to_owned();
        let page = HTML.replace("NONCE", &nonce).replace("/*STYLE*/", STYLE).replace("/*SCRIPT*/", SCRIPT);
        let policy = format!(
            "default-src 'none'; script-src 'nonce-{nonce}'; style-src 'nonce-{nonce}'; img-src blob: data:; connect-src 'self'; \
             base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
        );
        Ok(Self { http, access, page, policy, failed: AtomicBool::new(false) })
    }

    /// The page's address, with the token.
    pub fn address(&self) -> String {
        self.access.address()
    }

    /// Answers requests about `backend` until `stop` is set.
    ///
    /// # Errors
    /// When no more requests can be received.
    pub fn serve(&self, backend: &dyn Backend, stop: &Stop) -> io::Result<()> {
        std::thread::scope(|scope| {
            for _ in 1..THREADS {
                let answering = std::thread::Builder::new().name("page".into());
                // If a thread cannot be started, the others end as well.
                answering
                    .spawn_scoped(scope, || self.answer_all(backend, stop))
                    .inspect_err(|_| self.failed.store(true, Relaxed))?;
            }
            self.answer_all(backend, stop);
            Ok::<_, io::Error>(())
        })?;
        if self.failed.load(Relaxed) { Err(io::Error::other("the web server ended")) } else { Ok(()) }
    }

    fn answer_all(&self, backend: &dyn Backend, stop: &Stop) {
        while !stop.is_set() && !self.failed.load(Relaxed) {
            match self.http.recv_timeout(CHECK_STOP) {
                Ok(Some(request)) => self.answer(request, backend),
                Ok(None) => {}
                Err(_) => self.failed.store(true, Relaxed),
            }
        }
    }

    fn answer(&self, mut request: Request, backend: &dyn Backend) {
        let is_post = *request.method() == Method::Post;
        let known = is_post || *request.method() == Method::Get;
        let info = RequestInfo {
            target: request.url(),
            is_post,
            host: only(&request, "Host"),
            origin: only(&request, "Origin"),
            fetch_site: only(&request, "Sec-Fetch-Site"),
        };
        let checked = if known { self.access.check(&info).map(str::to_owned) } else { Err(405) };
        let answer = match checked {
            Err(status) => Answer { status, kind: "text/plain", bytes: Vec::new() },
            Ok(what) => {
                let mut text = String::new();
                if is_post && request.as_reader().take(MAX_BODY).read_to_string(&mut text).is_err() {
                    text.clear();
                }
                self.content(&what, is_post, text.trim(), backend)
            }
        };
        // An error here is a browser that has disconnected.
        let _ = request.respond(self.response(answer));
    }

    /// The answer to a request for `what` with the body `text`.
    fn content(&self, what: &str, is_post: bool, text: &str, backend: &dyn Backend) -> Answer {
        let (name, query) = what.split_once('?').unwrap_or((what, ""));
        match (name, is_post) {
            ("", false) => Answer { status: 200, kind: "text/html; charset=utf-8", bytes: self.page.clone().into_bytes() },
            ("about", false) => Answer::json(&about(backend)),
            ("state", false) => Answer::json(&state(backend)),
            ("preview", false) => match backend.preview(cursor(query), TIMEOUT) {
                Some(preview) => Answer { status: 200, kind: "application/octet-stream", bytes: packed(&preview) },
                None => Answer { status: 204, kind: "text/plain", bytes: Vec::new() },
            },
            ("set", true) => Answer::outcome(backend.set(text).map(|()| json!({}))),
            ("play", true) => Answer::outcome(backend.play(text).map(|()| json!({}))),
            ("write", true) => Answer::json(&written(backend, text)),
            _ => Answer { status: 404, kind: "text/plain", bytes: Vec::new() },
        }
    }

    fn response(&self, answer: Answer) -> Response<io::Cursor<Vec<u8>>> {
        let response = Response::from_data(answer.bytes).with_status_code(StatusCode(answer.status));
        // Sent with its length, at any length.
        let mut response = response.with_chunked_threshold(usize::MAX);
        for (name, value) in [
            ("Content-Type", answer.kind),
            ("Content-Security-Policy", self.policy.as_str()),
            ("Cache-Control", "no-store"),
            ("Referrer-Policy", "no-referrer"),
            ("X-Content-Type-Options", "nosniff"),
            ("Cross-Origin-Resource-Policy", "same-origin"),
            ("Cross-Origin-Opener-Policy", "same-origin"),
        ] {
            if let Ok(header) = Header::from_bytes(name, value) {
                response.add_header(header);
            }
        }
        response
    }
}

/// The value of a header; `None` unless there is exactly one.
fn only<'a>(request: &'a Request, name: &'static str) -> Option<&'a str> {
    let mut found = request.headers().iter().filter(|header| header.field.equiv(name)).map(|header| header.value.as_str());
    found.next().filter(|_| found.next().is_none())
}

struct Answer {
    status: u16,
    kind: &'static str,
    bytes: Vec<u8>,
}

impl Answer {
    fn json(value: &Value) -> Self {
        Self { status: 200, kind: "application/json", bytes: value.to_string().into_bytes() }
    }

    fn outcome(result: Result<Value, String>) -> Self {
        Self::json(&match result {
            Ok(value) => json!({"ok": true, "value": value}),
            Err(error) => json!({"ok": false, "error": error}),
        })
    }
}

fn about(backend: &dyn Backend) -> Value {
    let model = backend.settings().unwrap_or_default().pipeline.shutter.model;
    let axes = MotionNames::of(model).axes.iter();
    json!({
        "name": backend.name(),
        "recording": backend.is_recording(),
        "version": env!("CARGO_PKG_VERSION"),
        "keys": offered(backend),
        "axes": axes.map(|axis| json!({"name": axis.name, "meaning": axis.meaning, "unit": axis.unit})).collect::<Vec<_>>(),
        "configuration": backend.configuration().map(|path| path.to_string_lossy().into_owned()),
    })
}

fn state(backend: &dyn Backend) -> Value {
    let settings = match backend.settings() {
        Ok(settings) => {
            let all = keys::KEYS.iter().map(|key| (key.name.to_owned(), Value::from(key.value_text(&settings))));
            Value::Object(all.collect())
        }
        Err(_) => Value::Null,
    };
    json!({"state": backend.state(), "settings": settings})
}

/// What a page has received, from its query.
fn cursor(query: &str) -> Cursor {
    let number = |name: &str| {
        let words = query.split('&').filter_map(|word| word.split_once('='));
        words.filter(|(key, _)| *key == name).find_map(|(_, value)| value.parse().ok())
    };
    Cursor { picture: number("seen").unwrap_or(0), epoch: number("epoch").unwrap_or(0), frame: number("since") }
}

/// A preview as bytes: length of the JSON, JSON, JPEG.
fn packed(preview: &Preview) -> Vec<u8> {
    let frames: Vec<Value> = preview.frames.iter().chain([&preview.shown]).map(preview::json).collect();
    let head = json!({
        "number": preview.number, "epoch": preview.epoch, "size": preview.size, "input": preview.input, "frames": frames,
    });
    let head = head.to_string().into_bytes();
    [&(head.len() as u32).to_le_bytes()[..], &head, &preview.jpeg].concat()
}

/// Writes the settings in `text`, one `KEY=VALUE` per line, to the configuration file.
fn written(backend: &dyn Backend, text: &str) -> Value {
    let (keys, wanted) = match chosen(backend, text) {
        Ok(chosen) => chosen,
        Err(error) => return json!({"ok": false, "error": error}),
    };
    let lines: String = keys.iter().map(|key| format!("{} = {}\n", key.name, key.value_text(&wanted))).collect();
    let written = match backend.configuration() {
        Some(path) => config_file::write(&path, &keys, &wanted),
        None => Err("no configuration file is known: start with --config FILE, or copy these lines".to_owned()),
    };
    match written {
        Ok(path) => json!({"ok": true, "path": path.to_string_lossy(), "lines": lines}),
        Err(error) => json!({"ok": false, "error": error, "lines": lines}),
    }
}

/// The keys in lines of `KEY=VALUE`, and settings with these values.
fn chosen(backend: &dyn Backend, text: &str) -> Result<(Vec<&'static Key>, Settings), String> {
    let mut wanted = backend.settings()?;
    let mut chosen = Vec::new();
    for line in text.lines() {
        wanted.set(line).map_err(|faults| faults.to_string())?;
        let key = line.split_once('=').and_then(|(name, _)| keys::find(name.trim()));
        chosen.extend(key.filter(|key| is_offered(key)));
    }
    if chosen.is_empty() { Err("no settings to write".into()) } else { Ok((chosen, wanted)) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_is_one_file_without_external_resources() {
        let server = Server::open(0).unwrap();
        for mark in ["/*STYLE*/", "/*SCRIPT*/", "NONCE", "http://", "https://", "@import", "url("] {
            assert!(!server.page.contains(mark), "{mark} in the page");
        }
        assert!(server.policy.contains("default-src 'none'") && server.address().starts_with("http://127.0.0.1:"));
        assert_eq!(server.page.matches("<script").count(), 1);
    }

    #[test]
    fn the_cursor_of_a_page_is_read() {
        let Cursor { picture, epoch, frame } = cursor("seen=7&epoch=2&since=41");
        assert_eq!((picture, epoch, frame), (7, 2, Some(41)));
        let Cursor { picture, epoch, frame } = cursor("seen=-1&since=x&&=");
        assert_eq!((picture, epoch, frame), (0, 0, None));
    }
}
