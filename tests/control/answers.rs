//! Requests and replies, by the program and by hand.

use std::io::{BufRead, BufReader, Read, Write};
use std::os::unix::fs::PermissionsExt;
use std::process::Command;

use gimbald::command::Exit;
use gimbald::control::{
    Applied, Connection, FrameNumber, HistoryPart, LONGEST_REQUEST, Limits, Phase, RefusalKind, Reply, Request,
};

use crate::rig::{Scratch, reply, said, served};

#[test]
fn the_program_asks_and_changes() {
    served("program", Limits::default(), |scratch, state| {
        state.metrics.set_phase(Phase::Waiting, "for the camera");
        let text = said(&scratch.gimbald(&["status"]));
        assert!(text.starts_with("state          waiting for 0 s\n               for the camera\n"), "{text}");
        let json: serde_json::Value = serde_json::from_str(&said(&scratch.gimbald(&["status", "--json"]))).unwrap();
        assert_eq!((json["state"].as_str(), json["enabled"].as_bool()), (Some("waiting"), Some(true)));
        assert_eq!(said(&scratch.gimbald(&["off"])), "stabilization off\n");
        assert_eq!(said(&scratch.gimbald(&["off"])), "stabilization is already off\n");
        assert!(!state.live.params().enabled);
        assert!(said(&scratch.gimbald(&["status"])).contains("stabilization is off"));
        assert!(said(&scratch.gimbald(&["status", "--prometheus"])).contains("\ngimbald_enabled 0\n"));
        assert_eq!(said(&scratch.gimbald(&["on"])), "stabilization on\n");
        let set = said(&scratch.gimbald(&["set", "crop.zoom=1.3", "smooth.mode=iir"]));
        assert_eq!(set, "crop.zoom=1.3: set\nsmooth.mode=iir: set\n");
        assert_eq!(state.live.params().crop.zoom, 1.3);
        let refused = scratch.gimbald(&["set", "crop.zoom=3"]);
        assert_eq!(refused.status.code(), Some(Exit::Config.code().into()));
        assert!(String::from_utf8_lossy(&refused.stderr).contains("1 to 2"), "{refused:?}");
        let refused = scratch.gimbald(&["set", "crop.zoom"]);
        assert_eq!(refused.status.code(), Some(Exit::Usage.code().into()));
        assert!(String::from_utf8_lossy(&refused.stderr).contains("KEY=VALUE"), "{refused:?}");
    });
}

#[test]
fn the_program_has_the_configuration_read_again() {
    served("reload", Limits::default(), |scratch, state| {
        assert_eq!(said(&scratch.gimbald(&["set", "crop.zoom=1.3", "smooth.mode=iir"])).lines().count(), 2);
        std::fs::write(scratch.config(), "[smooth]\nstrength = 0.5\n[camera]\nfps = 15").unwrap();
        let reloaded = said(&scratch.gimbald(&["reload"]));
        assert!(reloaded.contains("changed: smooth.mode, smooth.strength, crop.zoom\n"), "{reloaded}");
        assert!(reloaded.contains("takes effect after a restart") && reloaded.contains("camera.fps"), "{reloaded}");
        std::fs::write(scratch.config(), "[smooth]\nstrength = 7").unwrap();
        let refused = scratch.gimbald(&["reload"]);
        assert_eq!(refused.status.code(), Some(Exit::Config.code().into()));
        assert!(String::from_utf8_lossy(&refused.stderr).contains("gimbald.toml:2"), "{refused:?}");
        assert_eq!(state.live.params().smooth.strength, 0.5);
    });
}

#[test]
fn where_nobody_listens_that_is_said() {
    let scratch = Scratch::new("nobody");
    let output = scratch.gimbald(&["status"]);
    assert_eq!(output.status.code(), Some(Exit::Unavailable.code().into()));
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(text.contains("no daemon running") && text.contains("start it with"), "{text}");
}

#[test]
fn who_sees_enough_may_go() {
    served("enough", Limits::default(), |scratch, _| {
        let script = format!(
            "set -o pipefail; '{0}' status --socket '{1}' --watch=0.1 | head -n 1 >/dev/null && '{0}' check --keys | head -n 1",
            env!("CARGO_BIN_EXE_gimbald"),
            scratch.socket().display()
        );
        let output = Command::new("bash").args(["-c", &script]).output().unwrap();
        assert!(output.status.success() && output.stderr.is_empty(), "{output:?}");
    });
}

/// Every request in words and as JSON, and what comes back as the typed client reads it.
#[test]
fn every_request_has_its_typed_reply() {
    served("typed", Limits::default(), |scratch, _| {
        let stream = scratch.connect();
        let mut client = Connection::open(&scratch.socket()).unwrap();
        let changed = |keys: &[&str]| Applied { changed: keys.iter().map(|key| (*key).to_owned()).collect(), restart: vec![] };
        for (request, words) in [
            (Request::Status, "status"),
            (Request::Prometheus, "prometheus"),
            (Request::History(FrameNumber(0)), "history 0"),
            (Request::Off, "off"),
            (Request::On, "on"),
            (Request::Set("crop.zoom=1.25".parse().unwrap()), "set crop.zoom = 1.25"),
            (Request::Reload, "reload"),
        ] {
            for line in [words.to_owned(), request.json(), request.line()] {
                (&stream).write_all(format!("{line}\n").as_bytes()).unwrap();
                match (&request, reply(&stream)) {
                    (Request::Status, Reply::Status { status }) => assert_eq!(status.pid, std::process::id()),
                    (Request::Prometheus, Reply::Metrics { text }) => assert!(text.contains("gimbald_uptime_seconds")),
                    (Request::History(_), Reply::History { history }) => assert_eq!(history, HistoryPart::default()),
                    (Request::On | Request::Off | Request::Set(_) | Request::Reload, Reply::Applied(_)) => {}
                    (_, other) => panic!("{line}: {other:?}"),
                }
            }
            assert!(client.ask(&request).is_ok(), "{request:?}");
        }
        assert_eq!(client.change(&Request::Off).unwrap(), changed(&["stabilize.enabled"]));
        assert_eq!(client.change(&Request::Reload).unwrap(), changed(&["stabilize.enabled"]));
        assert_eq!(client.status().unwrap().settings["crop.zoom"], "1.1");
        assert!(client.metrics().unwrap().ends_with('\n'));
        assert_eq!(client.history().unwrap(), []);
    });
}

#[test]
fn what_is_no_request_is_named_and_the_connection_goes_on() {
    served("unknown", Limits::default(), |scratch, _| {
        let stream = scratch.connect();
        for (line, kind, what) in [
            ("launch", RefusalKind::Request, "unknown variant `launch`"),
            ("{\"launch\":1}", RefusalKind::Request, "launch"),
            ("{\"set\":", RefusalKind::Request, "EOF"),
            ("", RefusalKind::Request, "the line is empty"),
            ("status please", RefusalKind::Request, "status takes no arguments"),
            ("set crop.zoom", RefusalKind::Request, "KEY=VALUE"),
            ("set crop.zooom=1.2", RefusalKind::Setting, "did you mean crop.zoom"),
            ("set camera.fps=15", RefusalKind::Setting, "restart"),
        ] {
            (&stream).write_all(format!("{line}\n").as_bytes()).unwrap();
            let Reply::Refused(refusal) = reply(&stream) else { panic!("{line}") };
            assert!(refusal.kind == kind && refusal.error.contains(what), "{line}: {refusal:?}");
        }
        (&stream).write_all(b"\xff\xfe\n\0\n").unwrap();
        assert!(matches!(reply(&stream), Reply::Refused(refusal) if refusal.error.contains("UTF-8")));
        assert!(matches!(reply(&stream), Reply::Refused(refusal) if refusal.kind == RefusalKind::Request));
        std::fs::write(scratch.config(), "[smooth]\nstrength = 7").unwrap();
        (&stream).write_all(b"reload\n").unwrap();
        let Reply::Refused(refusal) = reply(&stream) else { panic!("a wrong file was taken") };
        assert!(refusal.kind == RefusalKind::Configuration && refusal.error.contains("gimbald.toml:2"), "{refusal:?}");
    });
}

#[test]
fn many_lines_at_once_have_their_answers_in_order() {
    served("lines", Limits::default(), |scratch, state| {
        let mut stream = scratch.connect();
        stream.write_all(b"off\non\nset crop.zoom=1.5\r\nno such thing\n\xff\nreload\nset crop.zoom=1.4\nstatus\n").unwrap();
        // and says no more: what was asked is answered all the same
        stream.shutdown(std::net::Shutdown::Write).unwrap();
        let lines: Vec<String> = BufReader::new(&stream).lines().map(Result::unwrap).collect();
        let replies: Vec<Reply> = lines.iter().map(|line| Reply::read(line).unwrap()).collect();
        let done: Vec<bool> = replies.iter().map(|reply| !matches!(reply, Reply::Refused(_))).collect();
        assert_eq!(done, [true, true, true, false, false, true, true, true]);
        let Some(Reply::Status { status }) = replies.last() else { panic!("{replies:?}") };
        assert_eq!(status.settings["crop.zoom"], "1.4");
        assert_eq!(state.live.params().crop.zoom, 1.4);
        assert!(lines[0].starts_with("{\"ok\":true,\"changed\":[\"stabilize.enabled\"]"), "{}", lines[0]);
        assert!(lines[3].starts_with("{\"ok\":false,\"error\":"), "{}", lines[3]);
    });
}

#[test]
fn too_long_a_line_is_refused_and_hung_up_on() {
    served("long", Limits::default(), |scratch, _| {
        let mut stream = scratch.connect();
        let longest = format!("set a={}\n", "b".repeat(LONGEST_REQUEST - 6));
        stream.write_all(longest.as_bytes()).unwrap();
        assert!(matches!(reply(&stream), Reply::Refused(refusal) if refusal.kind == RefusalKind::Setting));
        let _ = stream.write_all(&vec![b'x'; LONGEST_REQUEST + 2]);
        assert!(matches!(reply(&stream), Reply::Refused(refusal) if refusal.error.contains("4096")));
        // and then the end: by a hang-up or a reset
        assert!(!matches!((&stream).read(&mut [0; 8]), Ok(1..)));
    });
}

#[test]
fn the_status_goes_into_a_file_that_is_never_old() {
    let path = Scratch::new("file");
    let file = path.0.join("gimbald.prom");
    let arguments = ["status", "--prometheus", "--output", file.to_str().unwrap()];
    served("output", Limits::default(), |scratch, _| {
        std::fs::write(&file, "old").unwrap();
        assert_eq!(said(&scratch.gimbald(&arguments)), "");
        let text = std::fs::read_to_string(&file).unwrap();
        assert!(text.starts_with("# HELP gimbald_info") && text.ends_with('\n'), "{text}");
        assert_eq!(std::fs::metadata(&file).unwrap().permissions().mode() & 0o777, 0o644);
        assert_eq!(std::fs::read_dir(&path.0).unwrap().count(), 1, "and nothing else is left there");
        let refused = scratch.gimbald(&["status", "--output", "/proc/no/such"]);
        assert_eq!(refused.status.code(), Some(Exit::CannotCreate.code().into()), "{refused:?}");
    });
    let refused = path.gimbald(&arguments);
    assert_eq!(refused.status.code(), Some(Exit::Unavailable.code().into()));
    assert!(!file.exists());
}
