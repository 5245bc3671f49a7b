//! A desktop session without a desktop: a message bus, PipeWire and WirePlumber of one's own, in a folder of their own.

use std::fs::{self, File};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// One session at a time: the machine's time is what these tests measure in.
static ONE: Mutex<()> = Mutex::new(());

/// What has to be installed; `.ci/run` does.
const PROGRAMS: [&str; 6] = ["pipewire", "wireplumber", "dbus-daemon", "pw-dump", "wpctl", "gst-launch-1.0"];

pub struct Session {
    pub folder: PathBuf,
    bus: Option<Child>,
    pipewire: Option<Child>,
    wireplumber: Option<Child>,
    _one: MutexGuard<'static, ()>,
}

/// A session with PipeWire running; `None`, and it is said, where this machine lacks what it needs.
pub fn session(name: &str) -> Option<Session> {
    let mut session = silent_session(name)?;
    session.start_pipewire();
    Some(session)
}

/// The same before PipeWire runs.
pub fn silent_session(name: &str) -> Option<Session> {
    let found =
        |program: &str| std::env::split_paths(&std::env::var_os("PATH")?).map(|path| path.join(program)).find(|p| p.is_file());
    if let Some(missing) = PROGRAMS.into_iter().find(|program| found(program).is_none()) {
        println!("SKIPPED: {name}: {missing} is not installed");
        return None;
    }
    let one = ONE.lock().unwrap_or_else(PoisonError::into_inner);
    // Sockets' paths must be short.
    let folder = std::env::temp_dir().join(format!("gb-{}-{name}", std::process::id()));
    fs::create_dir_all(&folder).unwrap();
    fs::set_permissions(&folder, fs::Permissions::from_mode(0o700)).unwrap();
    let mut session = Session { folder, bus: None, pipewire: None, wireplumber: None, _one: one };
    let address = format!("--address=unix:path={}", session.folder.join("bus").display());
    session.bus = Some(session.start("dbus-daemon", &["--session", "--nofork", "--nopidfile", &address]));
    session.wait_for("bus");
    Some(session)
}

impl Session {
    /// A command in this session.
    pub fn command(&self, program: impl AsRef<Path>) -> Command {
        let mut command = Command::new(program.as_ref());
        command
            .env("XDG_RUNTIME_DIR", &self.folder)
            .env("DBUS_SESSION_BUS_ADDRESS", format!("unix:path={}", self.folder.join("bus").display()))
            .env("HOME", &self.folder)
            .env("XDG_CONFIG_HOME", self.folder.join("config"))
            .env("XDG_STATE_HOME", self.folder.join("state"))
            .env("XDG_CACHE_HOME", self.folder.join("cache"))
            // Scanning all plugins takes seconds: once is enough.
            .env("GST_REGISTRY", std::env::temp_dir().join("gimbald-gstreamer-registry"))
            .env("GIO_USE_VFS", "local")
            .env("DISABLE_RTKIT", "1")
            .env_remove("DISPLAY")
            .env_remove("WAYLAND_DISPLAY")
            .stdin(Stdio::null());
        command
    }

    fn start(&self, program: &str, arguments: &[&str]) -> Child {
        let log = File::create(self.folder.join(format!("{program}.log"))).unwrap();
        let mut command = self.command(program);
        command.args(arguments).stdout(log.try_clone().unwrap()).stderr(log).spawn().unwrap()
    }

    fn wait_for(&self, name: &str) {
        until(name, || self.folder.join(name).exists());
    }

    pub fn start_pipewire(&mut self) {
        self.pipewire = Some(self.start("pipewire", &[]));
        self.wait_for("pipewire-0");
        self.start_wireplumber();
    }

    pub fn start_wireplumber(&mut self) {
        self.wireplumber = Some(self.start("wireplumber", &[]));
        until("WirePlumber", || self.dump().iter().any(|object| object["info"]["props"]["application.name"] == "WirePlumber"));
    }

    pub fn kill_wireplumber(&mut self) {
        self.wireplumber.take().into_iter().for_each(end);
    }

    pub fn kill_pipewire(&mut self) {
        self.pipewire.take().into_iter().for_each(end);
        let _ = fs::remove_file(self.folder.join("pipewire-0"));
        self.kill_wireplumber();
    }

    /// What PipeWire has. (Where something changes meanwhile, `pw-dump` writes a second list with that.)
    pub fn dump(&self) -> Vec<serde_json::Value> {
        let output = self.command("pw-dump").stderr(Stdio::null()).output().unwrap();
        let lists = serde_json::Deserializer::from_slice(&output.stdout).into_iter::<Vec<serde_json::Value>>();
        lists.map_while(Result::ok).flatten().collect()
    }

    /// The node of that name.
    pub fn node(&self, name: &str) -> Option<serde_json::Value> {
        let is_it = |object: &&serde_json::Value| object["info"]["props"]["node.name"] == name;
        self.dump().iter().rfind(is_it).map(|object| object["info"].clone())
    }

    /// The companion, with what it says in a file.
    pub fn companion(&self) -> Running {
        let log = File::options().append(true).create(true).open(self.folder.join("companion.log")).unwrap();
        let mut command = self.command(env!("CARGO_BIN_EXE_gimbald"));
        Running(command.arg("pipewire").stdout(Stdio::null()).stderr(log).spawn().unwrap())
    }
}

impl Drop for Session {
    fn drop(&mut self) {
        for child in [self.wireplumber.take(), self.pipewire.take(), self.bus.take()] {
            child.into_iter().for_each(end);
        }
        if std::thread::panicking() {
            for entry in fs::read_dir(&self.folder).into_iter().flatten().flatten() {
                if entry.path().extension().is_some_and(|extension| extension == "log") {
                    println!("== {}\n{}", entry.path().display(), fs::read_to_string(entry.path()).unwrap_or_default());
                }
            }
        }
        let _ = fs::remove_dir_all(&self.folder);
    }
}

/// A process that is killed when this goes.
pub struct Running(pub Child);

impl Running {
    pub fn pid(&self) -> rustix::process::Pid {
        rustix::process::Pid::from_child(&self.0)
    }

    pub fn signal(&self, signal: rustix::process::Signal) {
        rustix::process::kill_process(self.pid(), signal).unwrap();
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn end(mut child: Child) {
    let _ = child.kill();
    let _ = child.wait();
}

pub fn until(what: &str, mut is_so: impl FnMut() -> bool) {
    let before = Instant::now();
    while !is_so() {
        assert!(before.elapsed() < Duration::from_secs(40), "{what} within 40 seconds");
        std::thread::sleep(Duration::from_millis(30));
    }
}
