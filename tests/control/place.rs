//! The socket's place as the whole program takes it. What may stand in its way is tested at its source, `src/control/socket.rs`.

use std::os::unix::fs::{MetadataExt, symlink};

use rustix::fs::inotify::{self, ReadFlags, WatchFlags};
use rustix::fs::{CWD, FileType, Mode, mknodat};

use crate::daemon::Daemon;
use crate::rig::{Scratch, said};

/// Under the widest umask: the socket appears in one step, with the mode that it keeps, and its lock with that of a secret.
#[test]
fn there_is_no_moment_with_wider_permissions() {
    let scratch = Scratch::new("umask");
    let events = inotify::init(inotify::CreateFlags::CLOEXEC | inotify::CreateFlags::NONBLOCK).unwrap();
    let wanted = WatchFlags::CREATE | WatchFlags::MOVED_TO | WatchFlags::ATTRIB | WatchFlags::MOVED_FROM;
    inotify::add_watch(&events, &scratch.0, wanted).unwrap();
    let daemon = Daemon::start(scratch, "umask 0", &["--set", "control.mode=0640"]);
    daemon.until_logged("listening on");
    let mode = |name: &str| std::fs::metadata(daemon.scratch.0.join(name)).unwrap().mode() & 0o777;
    assert_eq!((mode("control.sock"), mode("control.sock.lock")), (0o640, 0o600));
    let mut buffer = [std::mem::MaybeUninit::uninit(); 4096];
    let mut reader = inotify::Reader::new(&events, &mut buffer);
    let mut seen = Vec::new();
    // The daemon listens: all that happened before waits to be read, and nothing more is waited for.
    while let Ok(event) = reader.next() {
        let name = event.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        seen.push((name, event.events()));
    }
    let of = |name: &str| seen.iter().filter(|(of, _)| of == name).map(|(_, events)| *events).collect::<Vec<_>>();
    assert_eq!(of("control.sock"), [ReadFlags::MOVED_TO], "{seen:?}");
    assert_eq!(of("control.sock.lock"), [ReadFlags::CREATE], "{seen:?}");
}

/// A daemon whose socket cannot be made says so and does its work without; it neither waits nor touches what is there.
#[test]
fn what_stands_in_the_way_is_in_the_log() {
    for (name, what) in [("control.sock", "a FIFO"), ("control.sock.lock", "a FIFO"), ("control.sock", "a symbolic link")] {
        let scratch = Scratch::new(&format!("way{}{}", name.len(), what.len()));
        let there = scratch.0.join(name);
        match what {
            "a FIFO" => mknodat(CWD, &there, FileType::Fifo, Mode::RWXU, 0).unwrap(),
            _ => symlink("elsewhere", &there).unwrap(),
        }
        let daemon = Daemon::start(scratch, "", &[]);
        daemon.until_logged(&format!("{name}: {what} is in the place of"));
        daemon.until_logged("waiting for the loopback");
        assert!(std::fs::symlink_metadata(&there).is_ok() && !daemon.scratch.0.join("elsewhere").exists());
        assert!(!daemon.scratch.gimbald(&["status"]).status.success());
    }
}

#[test]
fn a_second_daemon_leaves_the_first_its_socket() {
    let first = Daemon::listening("second");
    let socket = first.scratch.socket().display().to_string();
    let second = Daemon::start(Scratch::new("second-b"), "", &["--set", &format!("control.socket={socket}")]);
    second.until_logged("in use by another daemon");
    assert!(said(&first.scratch.gimbald(&["status"])).contains("state "));
}
