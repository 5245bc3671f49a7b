//! `gimbald view`: serves a page that shows a daemon's picture, or a recording, and its settings.

use std::fs::{self, Permissions};
use std::io::Write;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use super::client::Target;
use super::interrupt::stop_on_signal;
use super::print::{print, warn};
use super::{Exit, Failure, SettingsArgs};
use crate::rt::stop::Stop;
use crate::view::{Backend, DaemonBackend, RecordingBackend, Server};

/// The socket for pictures, in the same directory as the control socket.
const PICTURES: &str = "pictures.sock";

/// Arguments of `view`.
#[derive(Clone, Debug, clap::Args)]
pub struct Args {
    /// Recording to show: .gbr, y4m, or a video file (read with ffmpeg); default: the running service
    #[arg(value_name = "FILE", conflicts_with_all = ["instance", "socket"])]
    file: Option<PathBuf>,
    #[command(flatten)]
    target: Target,
    /// Override a setting for the recording, e.g. smooth.cutoff_hz=0.5; may be repeated
    #[arg(long = "set", value_name = "KEY=VALUE", requires = "file")]
    set: Vec<String>,
    /// Print the address of the page, but do not open a browser
    #[arg(long)]
    no_browser: bool,
    /// Port on 127.0.0.1; 0 picks a free one
    #[arg(long, value_name = "PORT", default_value_t = 0)]
    port: u16,
}

/// Runs the command, until SIGTERM or Ctrl-C.
///
/// # Errors
/// No such daemon or recording, or a port that is taken.
pub fn run(args: &Args) -> Result<(), Failure> {
    let stop = stop_on_signal(None)?;
    let open_server = || {
        let failure = |error| Failure::new(Exit::Unavailable, format!("cannot listen at 127.0.0.1:{}: {error}", args.port));
        Server::open(args.port).map_err(failure)
    };
    let config = &args.target.config;
    match &args.file {
        Some(path) => {
            // A search reads it from the start again.
            if path.as_os_str() == "-" || fs::metadata(path).is_ok_and(|about| !about.is_file()) {
                let what = format!(
                    "{}: not a regular file; the page reads a recording more than once, so save it first",
                    path.display()
                );
                return Err(Failure::new(Exit::Usage, what));
            }
            let settings = SettingsArgs { config: config.clone(), set: args.set.clone() }.read()?;
            let recording = RecordingBackend::open(path, settings, config.clone())?;
            serve(args, &open_server()?, &recording, || recording.run(&stop), &stop)
        }
        None => {
            let control = args.target.connect()?.path().to_path_buf();
            let daemon = daemon_backend(&args.target, &control);
            serve(args, &open_server()?, &daemon, || daemon.run(&stop), &stop)
        }
    }
}

/// The daemon whose control socket is at `control`.
pub(super) fn daemon_backend(target: &Target, control: &Path) -> DaemonBackend {
    let pictures = control.parent().unwrap_or(Path::new("/")).join(PICTURES);
    let again = target.clone();
    let connect = move || again.connect().map_err(|failure| failure.message);
    DaemonBackend::new(name_of(target), Box::new(connect), pictures, target.config.clone())
}

/// Serves the page while `work` runs in a thread of its own.
fn serve(args: &Args, server: &Server, backend: &dyn Backend, work: impl FnOnce() + Send, stop: &Stop) -> Result<(), Failure> {
    let address = server.address();
    print(&format!("{address}\n"))?;
    // The browser reads it some time after it has been started.
    let _redirect = if args.no_browser { None } else { open_browser(&address) };
    let served = std::thread::scope(|scope| {
        scope.spawn(work);
        let served = server.serve(backend, stop);
        stop.set();
        served
    });
    served.map_err(|error| Failure::new(Exit::Io, error.to_string()))
}

/// The daemon's name for the page.
fn name_of(target: &Target) -> String {
    match (&target.instance, &target.socket) {
        (Some(instance), _) => format!("gimbald@{instance}"),
        (None, Some(socket)) => socket.display().to_string(),
        (None, None) => "live".into(),
    }
}

/// Opens the page in the user's browser. The address contains the token, and every user can read the arguments of every process: the
/// browser gets the path of a private file that redirects to the address.
fn open_browser(address: &str) -> Option<tempfile::TempPath> {
    let path = match redirect(address) {
        Ok(path) => path,
        Err(error) => {
            warn(&format!("cannot write the page's address for the browser: {error}; open the address above"));
            return None;
        }
    };
    let started = Command::new("xdg-open").arg(&path).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).spawn();
    if let Err(error) = started {
        warn(&format!("cannot start xdg-open: {error}; open the address above in a browser"));
    }
    Some(path)
}

fn redirect(address: &str) -> std::io::Result<tempfile::TempPath> {
    let directory = std::env::var_os("XDG_RUNTIME_DIR").map_or_else(std::env::temp_dir, PathBuf::from);
    let mut file = tempfile::Builder::new().prefix("gimbald-view-").suffix(".html").tempfile_in(directory)?;
    fs::set_permissions(file.path(), Permissions::from_mode(0o600))?;
    write!(
        file,
        "<!doctype html><meta charset=utf-8><title>gimbald</title><meta http-equiv=refresh content=\"0;url={address}\">"
    )?;
    Ok(file.into_temp_path())
}
