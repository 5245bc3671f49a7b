//! The whole program, without a camera: what its log and its descriptors do while clients behave badly.

use std::fs::{self, File};
use std::io::{Read, Write};
use std::os::unix::net::UnixStream;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process};

use crate::rig::{LONG, Scratch, said};

/// `gimbald run` as a service that waits for devices that do not exist. Ended when it is dropped.
pub struct Daemon {
    pub scratch: Scratch,
    child: Child,
}

impl Daemon {
    /// Starts it in `scratch`, after the shell has done `before`.
    pub fn start(scratch: Scratch, before: &str, arguments: &[&str]) -> Self {
        let text = "[camera]\ndevice = \"/dev/no-such-camera\"\n[output]\ndevice = \"/dev/no-such-loopback\"\n";
        fs::write(scratch.config(), text).unwrap();
        let script = format!("{before}\nexec \"$0\" run --config \"$1\" \"${{@:2}}\"");
        let child = Command::new("bash")
            .args(["-c", &script, env!("CARGO_BIN_EXE_gimbald")])
            .arg(scratch.config())
            .args(arguments)
            // as a service, so that it waits; nobody is told
            .env("NOTIFY_SOCKET", scratch.0.join("notify"))
            .env("RUNTIME_DIRECTORY", &scratch.0)
            .env_remove("STATE_DIRECTORY")
            .env_remove("GIMBALD_LOG")
            .stdout(Stdio::null())
            .stderr(File::create(scratch.0.join("log")).unwrap())
            .spawn()
            .unwrap();
        Self { scratch, child }
    }

    /// The same, and waits until it listens.
    pub fn listening(name: &str) -> Self {
        let daemon = Self::start(Scratch::new(name), "", &[]);
        daemon.until_logged("listening on");
        daemon
    }

    pub fn log(&self) -> String {
        fs::read_to_string(self.scratch.0.join("log")).unwrap()
    }

    pub fn until_logged(&self, words: &str) {
        let begun = Instant::now();
        while !self.log().contains(words) {
            assert!(begun.elapsed() < LONG, "not in the log: {words}\n{}", self.log());
            std::thread::sleep(Duration::from_millis(10));
        }
    }

    fn signal(&self, signal: Signal) {
        let _ = kill_process(Pid::from_child(&self.child), signal);
    }

    /// Stops it, and waits until each of its threads has stopped: the signal reaches them one after the other.
    fn freeze(&self) {
        self.signal(Signal::STOP);
        let begun = Instant::now();
        let threads = format!("/proc/{}/task", self.child.id());
        let is_stopped = |status: String| status.contains("\nState:\tT");
        while !fs::read_dir(&threads)
            .unwrap()
            .all(|thread| fs::read_to_string(thread.unwrap().path().join("status")).is_ok_and(is_stopped))
        {
            assert!(begun.elapsed() < LONG, "it does not stop");
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    fn descriptors(&self) -> usize {
        fs::read_dir(format!("/proc/{}/fd", self.child.id())).unwrap().count()
    }

    fn memory_kb(&self) -> u64 {
        let status = fs::read_to_string(format!("/proc/{}/status", self.child.id())).unwrap();
        let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).unwrap();
        line.trim().trim_end_matches(" kB").parse().unwrap()
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        self.signal(Signal::TERM);
        let _ = self.child.wait();
    }
}

/// Sixteen connections that `set a=` without end: the log grows by ten lines a second at most, and says how many it left out.
#[test]
fn a_flood_does_not_fill_the_log() {
    let daemon = Daemon::listening("log");
    let streams: Vec<UnixStream> = (0..16).map(|_| daemon.scratch.connect()).collect();
    streams.iter().for_each(|stream| stream.set_nonblocking(true).unwrap());
    let (lines, begun) = (daemon.log().lines().count(), Instant::now());
    let (mut buffer, mut asked) = ([0; 65_536], 0);
    while begun.elapsed() < Duration::from_secs(3) {
        for mut stream in &streams {
            let _ = stream.write(&b"set a=\n".repeat(800));
            let _ = stream.read(&mut buffer);
        }
        asked += 1;
        if asked % 100 == 0 {
            assert!(said(&daemon.scratch.gimbald(&["status"])).contains("state "));
        }
    }
    assert!(said(&daemon.scratch.gimbald(&["reload"])).contains("no changes"));
    daemon.until_logged("more suppressed: refused requests");
    assert!(!daemon.log().contains("reloaded"), "who asked by the socket was answered there");
    let seconds = begun.elapsed().as_secs_f64();
    let log = daemon.log();
    let grown = log.lines().count() - lines;
    assert!(grown as f64 <= 10.0 * (seconds + 1.0), "{grown} lines in {seconds} s:\n{log}");
    assert!(log.contains("refused a request of process") && log.contains("no such key"), "{log}");
}

/// However many connect, and whatever they leave unfinished, descriptors and memory are bounded.
#[test]
fn many_connections_cost_little() {
    let daemon = Daemon::listening("many");
    said(&daemon.scratch.gimbald(&["status"]));
    let (descriptors, memory_kb) = (daemon.descriptors(), daemon.memory_kb());
    let mut held = Vec::new();
    for n in 0..2000 {
        let stream = daemon.scratch.connect();
        stream.set_nonblocking(true).unwrap();
        // half a request, or many whole ones whose answers nobody takes
        let text = if n % 2 == 0 { vec![b'x'; 4000] } else { b"prometheus\n".repeat(1000) };
        let _ = (&stream).write(&text);
        held.push(stream);
        if held.len() > 200 {
            held.remove(0);
        }
    }
    said(&daemon.scratch.gimbald(&["status"]));
    let (more, grown_kb) = (daemon.descriptors() - descriptors, daemon.memory_kb().saturating_sub(memory_kb));
    assert!(more <= 64, "{more} descriptors more");
    assert!(grown_kb < 16 * 1024, "{grown_kb} kB more");
}

/// A signal has no answer but the log.
#[test]
fn a_signal_has_the_configuration_read_again() {
    let daemon = Daemon::listening("signal");
    daemon.signal(Signal::HUP);
    daemon.until_logged("configuration reloaded, no changes");
    let text = fs::read_to_string(daemon.scratch.config()).unwrap();
    fs::write(daemon.scratch.config(), text.clone() + "[crop]\nzoom = 1.3\n").unwrap();
    daemon.signal(Signal::HUP);
    daemon.until_logged("configuration reloaded, changed: crop.zoom");
    fs::write(daemon.scratch.config(), text + "[crop]\nzoom = 13\n").unwrap();
    daemon.signal(Signal::HUP);
    daemon.until_logged("1 to 2");
    assert!(said(&daemon.scratch.gimbald(&["status", "--json"])).contains("\"crop.zoom\":\"1.3\""));
    // a daemon that does not answer is told from one that is not there
    daemon.freeze();
    let silent = daemon.scratch.gimbald(&["status"]);
    daemon.signal(Signal::CONT);
    assert!(String::from_utf8_lossy(&silent.stderr).contains("does not respond: no reply for 5 s"), "{silent:?}");
}

#[test]
fn a_retired_key_is_said_and_does_no_harm() {
    let daemon = Daemon::start(Scratch::new("retired"), "", &["--set", "metrics.listen=127.0.0.1:9464"]);
    daemon.until_logged("listening on");
    daemon.until_logged("gimbald status --prometheus");
    assert!(said(&daemon.scratch.gimbald(&["status", "--prometheus"])).contains("gimbald_uptime_seconds"));
}
