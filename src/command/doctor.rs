//! `gimbald doctor`: diagnoses problems and suggests fixes.

mod finding;
pub(super) mod machine;
mod pipewire;
mod processor;
mod service;

use std::path::{Path, PathBuf};

use super::client::Target;
use super::print::print;
use super::settings::text_of;
use super::{Exit, Failure};
use crate::config::Settings;
use crate::control::Status;
use crate::device::DeviceError;
use crate::device::v4l2::{DeviceInfo, Direction, LOAD_COMMAND as LOAD, LoopbackVersion, devices, find};
use finding::{Finding, Severity};
use machine::{Holder, Machine};

/// The configuration of the service.
const CONFIG: &str = "/etc/gimbald.toml";
/// The driver's name of a loopback.
const LOOPBACK: &str = "v4l2 loopback";
/// Buffers below which a slow reader's picture is overwritten while it reads.
const MIN_BUFFERS: u32 = 4;

/// Arguments of `doctor`.
#[derive(Clone, Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    target: Target,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Runs the command.
///
/// # Errors
/// With the exit code of the worst finding; all are told before.
pub fn run(args: &Args) -> Result<(), Failure> {
    let machine = Machine::at(Path::new("/"));
    let (unit, path) = match &args.target.instance {
        Some(name) => (format!("gimbald@{name}"), PathBuf::from(format!("/etc/gimbald/{name}.toml"))),
        None => ("gimbald".into(), args.target.config.clone().unwrap_or_else(|| CONFIG.into())),
    };
    let (configured, settings) = configuration(&path, args.target.config.is_some());
    let (daemon, status) = service::asked(&args.target);
    let mut findings = vec![configured, processor::looked_at(&settings, status.as_ref())];
    let wanted = settings.output.pipewire;
    findings.extend(module(&machine, wanted != Some(false) && pipewire::is_usable()));
    let known = devices();
    findings.extend(output(&machine, &settings, &known, status.as_ref()));
    findings.extend(camera(&machine, &settings, &known, status.as_ref()));
    let loopback = configured_device("output", &settings.output.device, Direction::Output, &known).ok().map(|(path, _)| path);
    if wanted != Some(false) {
        findings.extend(pipewire::looked_at(args.target.instance.as_deref(), loopback.as_deref(), wanted));
    }
    findings.push(service::unit_finding(&unit, service::systemctl_show(&unit).as_deref()));
    findings.push(daemon);
    findings.extend(status.iter().flat_map(service::frames));
    if args.json {
        let text = serde_json::to_string_pretty(&findings);
        print(&(text.map_err(|error| Failure::new(Exit::Io, format!("cannot write JSON: {error}")))? + "\n"))?;
    } else {
        print(&findings.iter().map(ToString::to_string).collect::<String>())?;
    }
    ended(&findings)
}

/// The end that the worst finding makes.
fn ended(findings: &[Finding]) -> Result<(), Failure> {
    let worst = findings.iter().map(|finding| finding.severity).max().unwrap_or(Severity::Good);
    let count = findings.iter().filter(|finding| finding.severity >= Severity::Advice).count();
    let exit = match worst {
        Severity::Good | Severity::Note => return Ok(()),
        Severity::Advice => Exit::Advised,
        Severity::Fault => Exit::Unavailable,
        Severity::Config => Exit::Config,
    };
    Err(Failure::new(exit, format!("{count} of {} checks need attention, see the suggestions (->) above", findings.len())))
}

/// The settings, where they are right, else the defaults.
fn configuration(path: &Path, asked: bool) -> (Finding, Settings) {
    let shown = path.display();
    if !asked && !path.exists() {
        let what = format!("{shown} does not exist, using defaults");
        return (Finding::note("config", what), Settings::default());
    }
    let read = text_of(path).and_then(|text| Ok(Settings::read(Some((&path.to_string_lossy(), &text)), &[])?));
    match read {
        Ok(settings) => match settings.retired.first() {
            None => (Finding::good("config", format!("{shown} is valid")), settings),
            Some(retired) => (Finding::advice("config", format!("{retired}"), format!("sudoedit {shown}")), settings),
        },
        Err(failure) => {
            let mend = format!("fix the file, then: gimbald check {shown}");
            (Finding { severity: Severity::Config, ..Finding::fault("config", failure.message, mend) }, Settings::default())
        }
    }
}

/// `pipewire`: whether PipeWire can be the output, so that no loopback is needed.
fn module(machine: &Machine, pipewire: bool) -> Vec<Finding> {
    let Some(version) = machine.loopback_version() else {
        if pipewire {
            let what = "v4l2loopback is not loaded, PipeWire is the only output. For programs that only support V4L2, install it: \
                        sudo apt-get install v4l2loopback-dkms";
            return vec![Finding::note("module", what)];
        }
        return vec![if machine.has_loopback_module() {
            let what = "v4l2loopback is installed but not loaded, and PipeWire cannot be used instead";
            Finding::fault("module", what, LOAD)
        } else {
            let install = "sudo apt-get install v4l2loopback-dkms linux-headers-$(uname -r)";
            let what = "v4l2loopback is not installed for the running kernel, and PipeWire cannot be used instead";
            Finding::fault("module", what, format!("{install} && {LOAD}"))
        }];
    };
    let mut findings = vec![Finding::good("module", format!("v4l2loopback {version} is loaded"))];
    if LoopbackVersion::parse(&version) < LoopbackVersion::REPORTS_VIEWERS {
        let what = "v4l2loopback before 0.13 does not report viewers: every program that has the device open counts as one";
        findings.push(Finding::note("module", what));
    }
    let buffers = machine.loopback_parameter("max_buffers").and_then(|count| count.parse::<u32>().ok());
    if let Some(buffers) = buffers.filter(|buffers| *buffers < MIN_BUFFERS) {
        let what = format!("max_buffers={buffers}: a slow reader may see a frame that is being overwritten");
        findings.push(Finding::advice("module", what, reload_module()));
    }
    findings
}

/// Reloads the module; all programs that use it have to be closed first.
fn reload_module() -> String {
    format!(
        "close all programs that use it, then: sudo systemctl stop gimbald; sudo modprobe -r v4l2loopback && {LOAD}; sudo systemctl start gimbald"
    )
}

/// The path that a setting means, and what is known of it; or why it means none.
fn configured_device<'a>(
    about: &'static str,
    device: &str,
    direction: Direction,
    known: &'a [DeviceInfo],
) -> Result<(PathBuf, Option<&'a DeviceInfo>), Finding> {
    let path = find(device, direction).map_err(|error| {
        let mend = match (direction, known.iter().any(|info| info.driver == LOOPBACK)) {
            (Direction::Output, false) => LOAD.to_owned(),
            (Direction::Output, true) => "list them with `gimbald devices`, and fix output.device".to_owned(),
            (Direction::Capture, _) => {
                "plug it in; or list the cameras with `gimbald devices`, and fix camera.device".to_owned()
            }
        };
        Finding::fault(about, error.to_string(), mend)
    })?;
    let path = path.canonicalize().unwrap_or(path);
    let info = known.iter().find(|info| info.path == path);
    Ok((path, info))
}

/// What is wrong with opening a device, if anything.
fn unopened(about: &'static str, path: &Path, info: Option<&DeviceInfo>) -> Option<Finding> {
    let Some(info) = info else {
        return Some(Finding::fault(
            about,
            format!("{} does not exist", path.display()),
            "list the devices with `gimbald devices`",
        ));
    };
    let problem = info.problem.as_ref()?;
    let denied = matches!(problem, DeviceError::Io { source, .. } if source.kind() == std::io::ErrorKind::PermissionDenied);
    Some(if denied {
        let mend = "sudo usermod -aG video \"$USER\", then log out and in again (the service is in the group already)";
        Finding::advice(about, format!("permission denied for {}", path.display()), mend)
    } else {
        Finding::fault(about, problem.to_string(), "gimbald devices; dmesg | tail")
    })
}

fn output(machine: &Machine, settings: &Settings, known: &[DeviceInfo], status: Option<&Status>) -> Vec<Finding> {
    let (path, info) = match configured_device("output", &settings.output.device, Direction::Output, known) {
        Ok(found) => found,
        Err(_) if machine.loopback_version().is_none() => return Vec::new(),
        Err(finding) => return vec![finding],
    };
    let shown = path.display();
    if let Some(finding) = unopened("output", &path, info) {
        return vec![finding];
    }
    let Some(info) = info else { return Vec::new() };
    if info.driver != LOOPBACK {
        let mend = "fix output.device; list the loopback devices with `gimbald devices`";
        return vec![Finding::fault(
            "output",
            format!("{shown} is not a loopback device but {} ({})", info.card, info.driver),
            mend,
        )];
    }
    let mut findings = Vec::new();
    if info.capture && info.output {
        let what = format!("{shown} ({}) has exclusive_caps=0: Chrome and others do not recognize it as a camera", info.card);
        findings.push(Finding::advice("output", what, reload_module()));
    } else {
        findings.push(Finding::good("output", format!("{shown} ({}) has exclusive_caps", info.card)));
    }
    let (holders, all) = machine.holders(&path);
    let daemon = status.map(|status| status.pid);
    let others: Vec<String> = holders.iter().filter(|holder| Some(holder.pid) != daemon).map(named).collect();
    if !others.is_empty() {
        findings.push(Finding::note("output", format!("{shown} is in use by {}", others.join(", "))));
    }
    if !all {
        findings.push(Finding::note("output", "some processes could not be inspected; run `sudo gimbald doctor` to see all"));
    }
    findings.extend(agreement(machine.loopback_format(&path).as_deref(), settings, status, &others));
    findings
}

/// Whether the format that the loopback has is the one that is wanted.
fn agreement(held: Option<&str>, settings: &Settings, status: Option<&Status>, others: &[String]) -> Option<Finding> {
    let held = held?;
    let (code, size) = held.split_once(':')?;
    let wanted = settings.output.format.to_string();
    let agrees = code.eq_ignore_ascii_case(&wanted) || (wanted.eq_ignore_ascii_case("i420") && code == "YU12");
    if agrees {
        return Some(Finding::good("format", format!("the loopback device is set to {code} {size}, as configured")));
    }
    let mend = if others.is_empty() && status.is_none() {
        "v4l2-ctl -d DEVICE -c keep_format=0, or reload the module".to_owned()
    } else {
        format!(
            "close {}, then: sudo systemctl restart gimbald",
            if others.is_empty() { "all readers".into() } else { others.join(", ") }
        )
    };
    Some(Finding::advice(
        "format",
        format!("the loopback device is set to {code} {size}, but output.format is {wanted}: a program holds the format"),
        mend,
    ))
}

fn camera(machine: &Machine, settings: &Settings, known: &[DeviceInfo], status: Option<&Status>) -> Vec<Finding> {
    let (path, info) = match configured_device("camera", &settings.camera.device, Direction::Capture, known) {
        Ok(found) => found,
        Err(finding) => return vec![finding],
    };
    if let Some(finding) = unopened("camera", &path, info) {
        return vec![finding];
    }
    let Some(info) = info else { return Vec::new() };
    let mut findings = vec![Finding::good("camera", format!("{} ({})", path.display(), info.card))];
    let (holders, _) = machine.holders(&path);
    let daemon = status.map(|status| status.pid);
    let others: Vec<String> =
        holders.iter().filter(|holder| Some(holder.pid) != daemon && holder.name != "gimbald").map(named).collect();
    if !others.is_empty() {
        let what = format!("{} is in use by {}: only one program can stream from it", path.display(), others.join(", "));
        findings.push(Finding::advice("camera", what, "select the virtual camera in these programs, or close them"));
    }
    if info.formats.iter().all(|format| format.pixel.is_none()) {
        let what = format!("{} offers no pixel format that gimbald can read", path.display());
        findings.push(Finding::fault("camera", what, "choose another camera; v4l2-ctl --list-formats-ext shows the formats"));
    } else if let Some(format) = settings.camera.format.filter(|wanted| info.formats.iter().all(|f| f.pixel != Some(*wanted))) {
        let what = format!("{} does not offer {format}, which camera.format requests", path.display());
        findings.push(Finding::fault("camera", what, "set camera.format = \"auto\"; `gimbald devices` lists the formats"));
    }
    findings
}

fn named(holder: &Holder) -> String {
    format!("{} (process {})", holder.name, holder.pid)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_worst_finding_ends_it() {
        let good = Finding::good("a", "b");
        let code = |findings: &[Finding]| ended(findings).map_err(|failure| failure.exit);
        assert_eq!(code(&[good.clone(), Finding::note("a", "b")]), Ok(()));
        let advice = Finding::advice("a", "b", "c");
        assert_eq!(code(&[good.clone(), advice.clone(), good.clone()]), Err(Exit::Advised));
        assert_eq!(code(&[Finding::fault("a", "b", "c"), advice.clone()]), Err(Exit::Unavailable));
        let (wrong, _) = configuration(Path::new("/no/such/file.toml"), true);
        assert_eq!(code(&[wrong, Finding::fault("a", "b", "c")]), Err(Exit::Config));
        assert_eq!(configuration(Path::new("/no/such/file.toml"), false).0.severity, Severity::Note);
    }

    #[test]
    fn formats_agree_or_not() {
        let settings = Settings::default();
        let judged = |held: Option<&str>, others: &[String]| agreement(held, &settings, None, others);
        assert_eq!(judged(None, &[]), None);
        assert_eq!(judged(Some("YUYV:640x480@30"), &[]).map(|finding| finding.severity), Some(Severity::Good));
        let held = judged(Some("NV12:640x480@30"), &["obs (process 7)".into()]).unwrap();
        assert!(held.severity == Severity::Advice && held.mend.contains("close obs"), "{held}");
    }

    #[test]
    fn without_the_module_it_says_how_to_get_it() {
        let nothing = Machine::at(Path::new("/no/such/root"));
        assert!(module(&nothing, true).iter().all(|finding| finding.severity == Severity::Note), "PipeWire needs none");
        let findings = module(&nothing, false);
        assert!(findings.len() == 1 && findings[0].mend.contains("apt-get install v4l2loopback-dkms"), "{findings:?}");
        assert_eq!(output(&nothing, &Settings::default(), &[], None).len(), 0, "said once");
        let camera = camera(&nothing, &Settings::default(), &[], None);
        assert!(camera.iter().all(|finding| finding.severity == Severity::Fault || finding.about == "camera"));
    }
}
