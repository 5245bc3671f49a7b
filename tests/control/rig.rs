//! A socket that is served in this process (a daemon without a camera), and ways to talk to it.

use std::io::{BufRead, BufReader, Write};
use std::os::unix::net::UnixStream;
use std::path::PathBuf;
use std::process::{Command, Output};
use std::sync::Arc;
use std::time::Duration;

use gimbald::config::Settings;
use gimbald::control::{BoundSocket, DaemonState, Limits, Reply, Reread, Server};
use gimbald::rt::notifier::Notifier;
use gimbald::systemd::Systemd;

/// Long enough on any machine.
pub const LONG: Duration = Duration::from_secs(60);

/// A directory of its own for each test.
pub struct Scratch(pub PathBuf);

impl Scratch {
    pub fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("gimbald-control-{}-{name}", std::process::id()));
        std::fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    pub fn socket(&self) -> PathBuf {
        self.0.join("control.sock")
    }

    pub fn config(&self) -> PathBuf {
        self.0.join("gimbald.toml")
    }

    /// A connection to the socket.
    pub fn connect(&self) -> UnixStream {
        let stream = UnixStream::connect(self.socket()).unwrap();
        stream.set_read_timeout(Some(LONG)).unwrap();
        stream
    }

    /// What `gimbald COMMAND --socket ... ARGUMENTS` does.
    pub fn gimbald(&self, arguments: &[&str]) -> Output {
        let mut command = Command::new(env!("CARGO_BIN_EXE_gimbald"));
        command.args(&arguments[..1]).arg("--socket").arg(self.socket()).args(&arguments[1..]).output().unwrap()
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// Says aloud what is not tested here: the test harness keeps what is printed to itself.
pub fn skipped(what: &str) {
    let _ = writeln!(std::io::stderr(), "SKIPPED: {what}");
}

/// What a command said that went well.
pub fn said(output: &Output) -> String {
    assert!(output.status.success(), "{output:?}");
    String::from_utf8(output.stdout.clone()).unwrap()
}

/// The next reply on a connection.
pub fn reply(stream: &UnixStream) -> Reply {
    let mut line = String::new();
    BufReader::with_capacity(1, stream).read_line(&mut line).unwrap();
    Reply::read(&line).unwrap_or_else(|error| panic!("{line:?}: {error}"))
}

struct NotifyOnDrop(Notifier);

impl Drop for NotifyOnDrop {
    fn drop(&mut self) {
        self.0.notify();
    }
}

/// Serves a daemon state whose configuration is [`Scratch::config`], while `act` runs.
pub fn served(name: &str, limits: Limits, act: impl FnOnce(&Scratch, &Arc<DaemonState>)) {
    let scratch = Scratch::new(name);
    let file = scratch.config();
    std::fs::write(&file, "").unwrap();
    let read = move || {
        let text = std::fs::read_to_string(&file).map_err(|error| error.to_string())?;
        Settings::read(Some(("gimbald.toml", &text)), &[]).map_err(|faults| faults.to_string())
    };
    served_with(scratch, 0o600, limits, Box::new(read), act);
}

/// The same with all there is to choose.
pub fn served_with(scratch: Scratch, mode: u32, limits: Limits, read: Reread, act: impl FnOnce(&Scratch, &Arc<DaemonState>)) {
    let state = Arc::new(DaemonState::new(Settings::default(), Systemd::disconnected(), read));
    let place = BoundSocket::bind(&scratch.socket(), mode, None).unwrap();
    let server = Server::new(place, limits).unwrap();
    let done = Notifier::new().unwrap();
    std::thread::scope(|scope| {
        let _notify = NotifyOnDrop(done.clone());
        scope.spawn(|| server.serve(&state, &done));
        act(&scratch, &state);
    });
    drop(server);
    assert!(!scratch.socket().exists(), "the socket goes with its server");
}
