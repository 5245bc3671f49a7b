//! The socket of a daemon that runs: answers, and people who behave badly. (The daemon is a desk; it has no camera here.)

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::os::unix::net::UnixStream;
use std::path::PathBuf;
use std::process::{Command, Output};
use std::time::Duration;

use gimbald::command::Exit;
use gimbald::config::Settings;
use gimbald::control::{Connection, Desk, LONGEST_REQUEST, Place, Rules, Server, State, Status};
use gimbald::rt::wake::Wake;
use gimbald::systemd::Systemd;

/// A place of its own for each test.
struct Scratch(PathBuf);

impl Scratch {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("gimbald-control-{}-{name}", std::process::id()));
        std::fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    fn socket(&self) -> PathBuf {
        self.0.join("control.sock")
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// Serves while `act` runs.
fn served(name: &str, rules: Rules, act: impl FnOnce(&Scratch, &Desk, &str)) {
    let scratch = Scratch::new(name);
    let file = scratch.0.join("gimbald.toml");
    std::fs::write(&file, "").unwrap();
    let read = move || {
        let text = std::fs::read_to_string(&file).map_err(|error| error.to_string())?;
        Settings::read(Some(("gimbald.toml", &text)), &[]).map_err(|faults| faults.to_string())
    };
    let desk = Desk::new(read().unwrap(), Systemd::nobody(), Box::new(read));
    let place = Place::take(&scratch.socket(), 0o600, None).unwrap();
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let server = Server::new(place, Some(listener), rules).unwrap();
    let done = Wake::new().unwrap();
    struct Ring(Wake);
    impl Drop for Ring {
        fn drop(&mut self) {
            self.0.ring();
        }
    }
    std::thread::scope(|scope| {
        let _ring = Ring(done.clone());
        scope.spawn(|| server.serve(&desk, &done));
        act(&scratch, &desk, &address);
    });
    drop(server);
    assert!(!scratch.socket().exists(), "the socket goes with its server");
}

fn connected(scratch: &Scratch) -> UnixStream {
    let stream = UnixStream::connect(scratch.socket()).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(30))).unwrap();
    stream
}

fn gimbald(scratch: &Scratch, arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_gimbald"));
    command.args(&arguments[..1]).arg("--socket").arg(scratch.socket()).args(&arguments[1..]).output().unwrap()
}

fn said(output: &Output) -> String {
    assert!(output.status.success(), "{output:?}");
    String::from_utf8(output.stdout.clone()).unwrap()
}

#[test]
fn the_program_asks_and_changes() {
    served("program", Rules::default(), |scratch, desk, _| {
        desk.tally.is_at(State::Waiting, "for the camera");
        let text = said(&gimbald(scratch, &["status"]));
        assert!(text.starts_with("state          waiting for 0 s\n               for the camera\n"), "{text}");
        let json: serde_json::Value = serde_json::from_str(&said(&gimbald(scratch, &["status", "--json"]))).unwrap();
        assert_eq!((json["state"].as_str(), json["enabled"].as_bool()), (Some("waiting"), Some(true)));
        assert_eq!(said(&gimbald(scratch, &["off"])), "off\n");
        assert_eq!(said(&gimbald(scratch, &["off"])), "was off already\n");
        assert!(!desk.live.params().enabled);
        assert!(said(&gimbald(scratch, &["status"])).contains("switched off"));
        assert!(said(&gimbald(scratch, &["status", "--prometheus"])).contains("\ngimbald_enabled 0\n"));
        assert_eq!(said(&gimbald(scratch, &["on"])), "on\n");
        let set = said(&gimbald(scratch, &["set", "crop.zoom=1.3", "smooth.mode=iir"]));
        assert_eq!(set, "crop.zoom=1.3: set\nsmooth.mode=iir: set\n");
        assert_eq!(desk.live.params().crop.zoom, 1.3);
        let refused = gimbald(scratch, &["set", "crop.zoom=3"]);
        assert_eq!(refused.status.code(), Some(Exit::Config.code().into()));
        assert!(String::from_utf8_lossy(&refused.stderr).contains("1 to 2"), "{refused:?}");
        std::fs::write(scratch.0.join("gimbald.toml"), "[smooth]\nstrength = 0.5\n[camera]\nfps = 15").unwrap();
        let reloaded = said(&gimbald(scratch, &["reload"]));
        assert!(reloaded.contains("changed: smooth.mode, smooth.strength, crop.zoom\n"), "{reloaded}");
        assert!(reloaded.contains("need a restart") && reloaded.contains("camera.fps"), "{reloaded}");
        std::fs::write(scratch.0.join("gimbald.toml"), "[smooth]\nstrength = 7").unwrap();
        let refused = gimbald(scratch, &["reload"]);
        assert_eq!(refused.status.code(), Some(Exit::Config.code().into()));
        assert!(String::from_utf8_lossy(&refused.stderr).contains("gimbald.toml:2"), "{refused:?}");
        assert_eq!(desk.live.params().smooth.strength, 0.5);
    });
}

#[test]
fn where_nobody_listens_that_is_said() {
    let scratch = Scratch::new("nobody");
    let output = gimbald(&scratch, &["status"]);
    assert_eq!(output.status.code(), Some(Exit::Unavailable.code().into()));
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(text.contains("no gimbald listens") && text.contains("is it running?"), "{text}");
}

#[test]
fn who_sees_enough_may_go() {
    served("enough", Rules::default(), |scratch, _, _| {
        let script = format!(
            "set -o pipefail; '{0}' status --socket '{1}' --watch=0.1 | head -n 1 >/dev/null && '{0}' check --keys | head -n 1",
            env!("CARGO_BIN_EXE_gimbald"),
            scratch.socket().display()
        );
        let output = Command::new("bash").args(["-c", &script]).output().unwrap();
        assert!(output.status.success() && output.stderr.is_empty(), "{output:?}");
    });
}

#[test]
fn bad_company_keeps_nobody_waiting() {
    let rules = Rules { most_clients: 8, patience: Duration::from_secs(600), ..Rules::default() };
    served("company", rules, |scratch, desk, _| {
        // one who never ends a line, one who is silent, one who asks and never listens
        let mut endless = connected(scratch);
        endless.write_all(&[b'x'; 100]).unwrap();
        let _silent = connected(scratch);
        let deaf = connected(scratch);
        deaf.set_nonblocking(true).unwrap();
        let mut asked = 0;
        let mut deaf_writer = &deaf;
        while asked < 4_000_000 {
            match deaf_writer.write(&b"status\n".repeat(500)) {
                Ok(written) => asked += written,
                Err(_) => break,
            }
        }
        assert!(asked < 4_000_000, "what the deaf one asks is not taken without end");
        for _ in 0..20 {
            let mut connection = Connection::open(&scratch.socket()).unwrap();
            let status: Status = serde_json::from_value(connection.ask("status").unwrap()["status"].take()).unwrap();
            assert_eq!(status.pid, std::process::id());
        }
        assert!(desk.live.params().enabled);
    });
}

#[test]
fn too_long_a_line_is_refused_and_hung_up_on() {
    served("long", Rules::default(), |scratch, _, _| {
        let mut stream = connected(scratch);
        let _ = stream.write_all(&vec![b'x'; LONGEST_REQUEST + 1]);
        let mut answer = String::new();
        BufReader::new(&stream).read_line(&mut answer).unwrap();
        assert!(answer.contains("\"ok\":false") && answer.contains("4096"), "{answer}");
        // and then the end: by a hang-up or a reset
        assert!(!matches!((&stream).read(&mut [0; 8]), Ok(1..)));
    });
}

#[test]
fn more_than_may_talk_push_out_the_most_silent() {
    let rules = Rules { most_clients: 4, patience: Duration::from_secs(600), ..Rules::default() };
    served("many", rules, |scratch, _, _| {
        let mut first = connected(scratch);
        let others: Vec<_> = (0..30).map(|_| connected(scratch)).collect();
        let mut connection = Connection::open(&scratch.socket()).unwrap();
        assert!(connection.ask("status").is_ok());
        assert!(matches!(first.read(&mut [0; 8]), Ok(0) | Err(_)), "the first was hung up on");
        drop(others);
    });
}

#[test]
fn patience_ends() {
    let rules = Rules { most_clients: 4, patience: Duration::from_millis(50), ..Rules::default() };
    served("patience", rules, |scratch, _, _| {
        let mut stream = connected(scratch);
        stream.write_all(b"stat").unwrap();
        assert_eq!(stream.read(&mut [0; 8]).unwrap(), 0, "hung up on");
    });
}

#[test]
fn many_lines_at_once_have_their_answers_in_order() {
    served("lines", Rules::default(), |scratch, desk, _| {
        let mut stream = connected(scratch);
        stream.write_all(b"off\non\nset crop.zoom=1.5\r\nno such thing\n\xff\nstatus\n").unwrap();
        let answers: Vec<serde_json::Value> =
            BufReader::new(&stream).lines().take(6).map(|line| serde_json::from_str(&line.unwrap()).unwrap()).collect();
        let ok: Vec<bool> = answers.iter().map(|answer| answer["ok"].as_bool().unwrap()).collect();
        assert_eq!(ok, [true, true, true, false, false, true]);
        assert_eq!(answers[5]["status"]["settings"]["crop.zoom"], "1.5");
        assert_eq!(desk.live.params().crop.zoom, 1.5);
    });
}

#[test]
fn prometheus_is_answered() {
    served("prometheus", Rules::default(), |_, _, address| {
        let get = |request: &str| {
            let mut stream = TcpStream::connect(address).unwrap();
            stream.set_read_timeout(Some(Duration::from_secs(30))).unwrap();
            stream.write_all(request.as_bytes()).unwrap();
            let mut answer = String::new();
            stream.read_to_string(&mut answer).unwrap();
            answer
        };
        let answer = get("GET /metrics HTTP/1.1\r\nHost: x\r\n\r\n");
        let (head, body) = answer.split_once("\r\n\r\n").unwrap();
        assert!(head.starts_with("HTTP/1.1 200 OK\r\nContent-Type: text/plain; version=0.0.4"), "{head}");
        assert!(
            head.contains(&format!("Content-Length: {}", body.len())) && body.contains("\ngimbald_uptime_seconds "),
            "{answer}"
        );
        assert!(get("GET /etc/passwd HTTP/1.0\r\n\r\n").starts_with("HTTP/1.1 404"));
        assert!(get("POST /metrics HTTP/1.0\r\n\r\n").starts_with("HTTP/1.1 400"));
        // the socket's words do nothing here
        assert!(get("off\n\n").starts_with("HTTP/1.1 400"));
    });
}

#[test]
fn who_asks_without_end_waits_for_his_answers_and_gets_them_all() {
    let rules = Rules { most_answers: 20, ..Rules::default() };
    served("pace", rules, |scratch, _, _| {
        let stream = connected(scratch);
        let begun = std::time::Instant::now();
        let mut answers = BufReader::new(&stream).lines();
        for _ in 0..3 {
            // more at once than are given at once
            (&stream).write_all(&b"status\n".repeat(20)).unwrap();
            assert!((0..20).all(|_| answers.next().unwrap().unwrap().contains("\"ok\":true")));
        }
        // sixty answers, twenty a second: never sooner, on however slow a machine
        assert!(begun.elapsed() >= Duration::from_millis(1500), "{:?}", begun.elapsed());
    });
}
