//! `gimbald status`, `on`, `off`, `set`, `reload`: requests to a running daemon.

use std::fs::Permissions;
use std::io::{IsTerminal, Write};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::thread::sleep;
use std::time::Duration;

use super::doctor::machine::Machine;
use super::print::print;
use super::settings::text_of;
use super::{Exit, Failure};
use crate::config::Settings;
use crate::control::{Assignment, ClientError, Connection, RefusalKind, Request, default_paths};

/// Which daemon is meant.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct Target {
    /// Talk to the service gimbald@NAME
    #[arg(short, long, value_name = "NAME", conflicts_with_all = ["socket", "config"])]
    pub instance: Option<String>,
    /// Talk to the daemon at this socket
    #[arg(long, value_name = "PATH", conflicts_with = "config")]
    pub socket: Option<PathBuf>,
    /// Talk to the daemon that uses this configuration file
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
}

/// Arguments of `status`.
#[derive(Clone, Debug, clap::Args)]
pub struct StatusArgs {
    #[command(flatten)]
    target: Target,
    /// Print JSON, on one line
    #[arg(long, conflicts_with = "prometheus")]
    json: bool,
    /// Print metrics in Prometheus text format; with --instance, each has the label service="NAME"
    #[arg(long)]
    prometheus: bool,
    /// Write to this file instead; it is replaced atomically, is readable by everyone, and is removed if no daemon is running
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Refresh every SECONDS (default 1) until Ctrl-C
    #[arg(short, long, value_name = "SECONDS", num_args = 0..=1, default_missing_value = "1", require_equals = true,
        value_parser = seconds)]
    watch: Option<f64>,
}

/// Arguments of `on`, `off`, `reload`.
#[derive(Clone, Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    target: Target,
}

/// Arguments of `set`.
#[derive(Clone, Debug, clap::Args)]
pub struct SetArgs {
    /// Setting to change, e.g. smooth.strength=0.5
    #[arg(value_name = "KEY=VALUE", required = true)]
    assignments: Vec<Assignment>,
    #[command(flatten)]
    target: Target,
}

fn seconds(text: &str) -> Result<f64, String> {
    let wrong = || "expected a number of seconds from 0.1 to 3600".to_owned();
    text.parse().ok().filter(|seconds| (0.1..=3600.0).contains(seconds)).ok_or_else(wrong)
}

impl Target {
    /// Sockets to try, in order: the first at which a daemon listens is used.
    fn sockets(&self) -> Result<Vec<PathBuf>, Failure> {
        if let Some(socket) = &self.socket {
            return Ok(vec![socket.clone()]);
        }
        if let Some(instance) = &self.instance {
            // A name that would lead elsewhere is none.
            let fits = !instance.is_empty() && instance.chars().all(|c| c.is_ascii_alphanumeric() || "-_.:\\".contains(c));
            let wrong = || {
                Failure::new(
                    Exit::Usage,
                    format!("{instance:?}: not a valid instance name; expected the NAME of a service gimbald@NAME"),
                )
            };
            return if fits { Ok(default_paths(Some(instance))) } else { Err(wrong()) };
        }
        let Some(path) = &self.config else { return Ok(default_paths(None)) };
        let settings = Settings::read(Some((&path.to_string_lossy(), &text_of(path)?)), &[])?;
        match settings.control.socket.as_str() {
            "auto" => Ok(default_paths(instance_of(path).as_deref())),
            "off" => {
                let what = format!(
                    "{}: control.socket is \"off\", so this daemon cannot be controlled; set it to \"auto\" and restart the daemon",
                    path.display()
                );
                Err(Failure::new(Exit::Unavailable, what))
            }
            socket => Ok(vec![PathBuf::from(socket)]),
        }
    }

    /// Connects.
    pub(super) fn connect(&self) -> Result<Connection, Failure> {
        let mut first = None;
        for path in self.sockets()? {
            match Connection::open(&path) {
                Ok(connection) => return Ok(connection),
                Err(ClientError::NotRunning { .. }) if first.is_some() => {}
                Err(error @ ClientError::NotRunning { .. }) => first = Some(error),
                Err(error) => return Err(error.into()),
            }
        }
        let mut failure = first.map_or_else(|| Failure::new(Exit::Unavailable, "no daemon running"), Failure::from);
        let others = if self.socket.is_none() { instances() } else { Vec::new() };
        failure.message += &match others.as_slice() {
            [] => match &self.instance {
                Some(name) => format!("; start it with `sudo systemctl start gimbald@{name}`"),
                None => "; start it with `sudo systemctl start gimbald`, or `gimbald run` in a terminal".to_owned(),
            },
            others => format!("; running instances: --instance {}", others.join(", --instance ")),
        };
        Err(failure)
    }
}

/// The instance whose configuration a path is: /etc/gimbald/NAME.toml.
fn instance_of(path: &Path) -> Option<String> {
    let of_instances = path.parent().is_some_and(|parent| parent == Path::new("/etc/gimbald"));
    path.file_stem().filter(|_| of_instances).map(|name| name.to_string_lossy().into_owned())
}

/// Services gimbald@NAME that run.
fn instances() -> Vec<String> {
    let entries = std::fs::read_dir("/run").into_iter().flatten().flatten();
    let names = entries.filter_map(|entry| entry.file_name().to_str()?.strip_prefix("gimbald-").map(str::to_owned));
    let mut names: Vec<String> = names.collect();
    names.sort();
    names
}

impl From<ClientError> for Failure {
    fn from(error: ClientError) -> Self {
        let exit = match &error {
            ClientError::Unknown { .. } => Exit::BadData,
            ClientError::Refused(refusal)
                if !matches!(refusal.kind, RefusalKind::Busy | RefusalKind::Late | RefusalKind::Request) =>
            {
                Exit::Config
            }
            _ => Exit::Unavailable,
        };
        Self::new(exit, error.to_string())
    }
}

/// Runs `status`.
///
/// # Errors
/// Where no daemon answers.
pub fn status(args: &StatusArgs) -> Result<(), Failure> {
    if let Some(path) = &args.output {
        return status_into(path, args);
    }
    let mut connection = args.target.connect()?;
    loop {
        let text = status_text(args, &mut connection)?;
        // A terminal shows it in place; a file gets one after the other.
        let in_place = args.watch.is_some() && !args.json && std::io::stdout().is_terminal();
        print(&if in_place { format!("\u{1b}[H\u{1b}[J{text}") } else { text })?;
        let Some(pause) = args.watch else { return Ok(()) };
        if std::io::stdout().is_terminal() || !reader_is_gone() {
            sleep(Duration::from_secs_f64(pause));
        } else {
            return Ok(());
        }
    }
}

/// Writes the status into a file, again and again where that is asked. It never holds what is not so any more.
fn status_into(path: &Path, args: &StatusArgs) -> Result<(), Failure> {
    loop {
        let text = args.target.connect().and_then(|mut connection| status_text(args, &mut connection));
        match (text, args.watch) {
            (Ok(text), _) => replace(path, &text).map_err(|error| Failure::creating(path, &error))?,
            (Err(failure), watch) => {
                match std::fs::remove_file(path) {
                    Err(error) if error.kind() != std::io::ErrorKind::NotFound => return Err(Failure::creating(path, &error)),
                    _ => {}
                }
                // A daemon that is restarted is back soon.
                if watch.is_none() {
                    return Err(failure);
                }
            }
        }
        let Some(pause) = args.watch else { return Ok(()) };
        sleep(Duration::from_secs_f64(pause));
    }
}

/// Replaces a file by one with this text, in one step.
fn replace(path: &Path, text: &str) -> std::io::Result<()> {
    let directory = path.parent().filter(|directory| !directory.as_os_str().is_empty()).unwrap_or(Path::new("."));
    // The collector of Prometheus' node exporter passes over names with another end.
    let mut file = tempfile::Builder::new().prefix(".gimbald-").suffix(".new").tempfile_in(directory)?;
    file.write_all(text.as_bytes())?;
    file.as_file().set_permissions(Permissions::from_mode(0o644))?;
    file.persist(path)?;
    Ok(())
}

/// Metrics with one more label, which tells several daemons apart.
fn labelled(metrics: &str, name: &str) -> String {
    let escaped = name.replace('\\', "\\\\").replace('"', "\\\"");
    let line = |line: &str| match line.find(['{', ' ']) {
        Some(_) if line.starts_with('#') => line.to_owned() + "\n",
        Some(end) if line[end..].starts_with('{') => format!("{}{{service=\"{escaped}\",{}\n", &line[..end], &line[end + 1..]),
        Some(end) => format!("{}{{service=\"{escaped}\"}}{}\n", &line[..end], &line[end..]),
        None => line.to_owned() + "\n",
    };
    metrics.lines().map(line).collect()
}

/// Whether standard output is a pipe whose reader has gone.
fn reader_is_gone() -> bool {
    use rustix::event::{PollFd, PollFlags, Timespec, poll};
    let out = std::io::stdout();
    let mut fds = [PollFd::new(&out, PollFlags::OUT)];
    let _ = poll(&mut fds, Some(&Timespec::default()));
    fds[0].revents().contains(PollFlags::ERR)
}

fn status_text(args: &StatusArgs, connection: &mut Connection) -> Result<String, Failure> {
    if args.prometheus {
        let metrics = connection.metrics()?;
        return Ok(match &args.target.instance {
            Some(name) => labelled(&metrics, name),
            None => metrics,
        });
    }
    let mut status = connection.status()?;
    if args.json {
        let text = serde_json::to_string(&status);
        return text.map(|text| text + "\n").map_err(|error| Failure::new(Exit::BadData, error.to_string()));
    }
    if let Some(output) = &status.output {
        let (holders, _) = Machine::at(Path::new("/")).holders(Path::new(&output.path));
        let others = holders.iter().filter(|holder| holder.pid != status.pid);
        status.open_in = others.map(|holder| format!("{} ({})", holder.name, holder.pid)).collect();
    }
    Ok(status.to_string())
}

/// Runs `on` (true) or `off`.
///
/// # Errors
/// Where no daemon answers.
pub fn switch(args: &Args, on: bool) -> Result<(), Failure> {
    let applied = args.target.connect()?.change(if on { &Request::On } else { &Request::Off })?;
    let state = if on { "on" } else { "off" };
    print(&if applied.changed.is_empty() {
        format!("stabilization is already {state}\n")
    } else {
        format!("stabilization {state}\n")
    })
}

/// Runs `set`.
///
/// # Errors
/// Where no daemon answers, and where it refuses one; those before it are set.
pub fn set(args: &SetArgs) -> Result<(), Failure> {
    let mut connection = args.target.connect()?;
    for assignment in &args.assignments {
        let applied = connection.change(&Request::Set(assignment.clone()))?;
        let what = if applied.changed.is_empty() { "unchanged" } else { "set" };
        print(&format!("{assignment}: {what}\n"))?;
    }
    Ok(())
}

/// Runs `reload`.
///
/// # Errors
/// Where no daemon answers, and where the configuration is wrong: then nothing has changed.
pub fn reload(args: &Args) -> Result<(), Failure> {
    let applied = args.target.connect()?.change(&Request::Reload)?;
    let mut text = match applied.changed.as_slice() {
        [] => "reloaded, no changes\n".to_owned(),
        changed => format!("reloaded; changed: {}\n", changed.join(", ")),
    };
    if !applied.restart.is_empty() {
        text += &format!("takes effect after a restart: {}\n", applied.restart.join(", "));
    }
    print(&text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn several_daemons_have_a_label() {
        let metrics = "# HELP a x y.\n# TYPE a gauge\na 1\nb{c=\"d e{\"} 2.5\n";
        let expected = "# HELP a x y.\n# TYPE a gauge\na{service=\"de\\\\sk\"} 1\nb{service=\"de\\\\sk\",c=\"d e{\"} 2.5\n";
        assert_eq!(labelled(metrics, "de\\sk"), expected);
    }

    #[test]
    fn names_lead_to_sockets() {
        let target = |instance: &str| Target { instance: Some(instance.into()), ..Target::default() };
        assert_eq!(target("desk").sockets().unwrap()[0], PathBuf::from("/run/gimbald-desk/control.sock"));
        assert!(target("../../tmp/x").sockets().is_err());
        assert_eq!(Target::default().sockets().unwrap()[0], PathBuf::from("/run/gimbald/control.sock"));
        let absent = target("not-there").connect().unwrap_err();
        assert!(absent.message.contains("gimbald@not-there") || absent.message.contains("running instances"), "{absent:?}");
        assert_eq!(instance_of(Path::new("/etc/gimbald/desk.toml")).as_deref(), Some("desk"));
        assert_eq!(instance_of(Path::new("/etc/gimbald.toml")), None);
        assert_eq!((seconds("0.5"), seconds("nan").is_err(), seconds("0").is_err()), (Ok(0.5), true, true));
    }
}
