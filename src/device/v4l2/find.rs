//! Resolves a device setting to a device.

use std::io;
use std::path::{Path, PathBuf};

use v4l::v4l_sys::{V4L2_CAP_VIDEO_CAPTURE, V4L2_CAP_VIDEO_OUTPUT};

use super::super::DeviceError;
use super::enumerate::{kernel_name, nodes};
use super::mode::Wish;
use super::node::{Direction, Identity, Node};
use super::role::{ONLY_STAGES, Role};
use super::select::best;

/// The node that `device` means: a number (`0`), a path (`/dev/video0`), a card name or a part of one that only one device has
/// (`HD Pro Webcam C920`, `c920`), or `auto`: the first camera that is no loopback, for output the first loopback. Of a camera with
/// several nodes it is the one with the picture: in colour where one is, and in a format that gimbald reads.
///
/// # Errors
/// Where no device, or more than one, answers to it; the error lists those there are.
pub fn find(device: &str, direction: Direction) -> Result<PathBuf, DeviceError> {
    let found = candidates(device, direction, &[])?;
    if direction == Direction::Capture
        && found.len() > 1
        && let Ok(selected) = best(&found, &Wish::default(), &[])
    {
        return Ok(selected.node.path().to_path_buf());
    }
    found.into_iter().next().ok_or_else(|| DeviceError::Gone { path: PathBuf::from(device) })
}

/// The nodes to try for `device`, by number, at least one: as [`find`], with every node that may be meant. Those in `except` are not
/// looked at.
pub(super) fn candidates(device: &str, direction: Direction, except: &[PathBuf]) -> Result<Vec<PathBuf>, DeviceError> {
    let device = device.trim();
    if device.starts_with('/') {
        return Ok(vec![PathBuf::from(device)]);
    }
    if !device.is_empty() && device.bytes().all(|byte| byte.is_ascii_digit()) {
        return Ok(vec![PathBuf::from(format!("/dev/video{device}"))]);
    }
    let known: Vec<_> = nodes().into_iter().filter(|path| !except.contains(path)).map(|path| (identify(&path), path)).collect();
    pick(device, direction, &known, except)
}

/// The choice of [`candidates`] among `known` nodes.
fn pick(
    device: &str,
    direction: Direction,
    known: &[(Seen, PathBuf)],
    except: &[PathBuf],
) -> Result<Vec<PathBuf>, DeviceError> {
    let auto = device.is_empty() || device.eq_ignore_ascii_case("auto");
    let name = device.to_lowercase();
    let chosen = |fits: &dyn Fn(&Seen) -> bool| -> Vec<_> { known.iter().filter(|(seen, _)| fits(seen)).collect() };
    let found = if auto {
        let wanted = direction == Direction::Output;
        chosen(&|seen| seen.identity.is_some() && seen.serves(direction) && seen.is_loopback() == wanted)
    } else {
        let whole = chosen(&|seen| seen.serves(direction) && seen.card.to_lowercase() == name);
        let part = || chosen(&|seen| seen.serves(direction) && seen.card.to_lowercase().contains(&name));
        if whole.is_empty() { part() } else { whole }
    };
    // One camera often has several nodes, also of several names.
    let one = |found: &[&(Seen, PathBuf)]| found.windows(2).all(|two| two[0].0.same_bus(&two[1].0));
    if !found.is_empty() && (auto || one(&found)) {
        return Ok(found.into_iter().map(|(_, path)| path.clone()).collect());
    }
    let path = PathBuf::from(if auto { "auto" } else { device });
    if !found.is_empty() {
        let what = format!("more than one device matches: {}; use its number, path or full name", names(found));
        return Err(DeviceError::Unsupported { path, what });
    }
    Err(nothing(path, direction, known, except))
}

/// Nodes for people.
fn names<'a>(nodes: impl IntoIterator<Item = &'a (Seen, PathBuf)>) -> String {
    nodes.into_iter().map(|(seen, path)| format!("{} ({})", path.display(), seen.card)).collect::<Vec<_>>().join(", ")
}

/// Why there is no device for `path`, a setting.
fn nothing(path: PathBuf, direction: Direction, known: &[(Seen, PathBuf)], except: &[PathBuf]) -> DeviceError {
    let mut all: Vec<_> = known.iter().map(|(seen, node)| (node, seen.card.clone(), "")).collect();
    let name = path.to_string_lossy().to_lowercase();
    all.extend(except.iter().map(|node| {
        let card = kernel_name(node);
        // What has another name would not have been meant anyway.
        let why = if card.to_lowercase().contains(&name) {
            "; not used: it was connected together with the camera in use"
        } else {
            ""
        };
        (node, card, why)
    }));
    all.sort();
    let all: Vec<_> = all.iter().map(|(node, card, why)| format!("{} ({card}{why})", node.display())).collect();
    let there = if all.is_empty() { "no video devices found".into() } else { format!("there is {}", all.join(", ")) };
    if direction == Direction::Output {
        let what = format!("no loopback device matches; {there}; {}", super::LOAD_LOOPBACK);
        return DeviceError::Unsupported { path, what };
    }
    // It may be plugged in yet.
    let hint = if known.iter().any(|(seen, _)| seen.role == Some(Role::Camera)) {
        "; use its number, path or card name"
    } else if known.iter().any(|(seen, _)| seen.role == Some(Role::Stage)) {
        ONLY_STAGES
    } else {
        "; plug one in, or use its number, path or card name"
    };
    DeviceError::Io { path, doing: "find such a camera", hint, source: io::Error::new(io::ErrorKind::NotFound, there) }
}

/// A node as far as it can be told without its formats; what is `None` cannot be told: it could not be opened.
#[derive(Debug)]
struct Seen {
    card: String,
    identity: Option<Identity>,
    role: Option<Role>,
}

impl Seen {
    /// Whether frames can go that way; true where that cannot be told: opening it will say why not.
    fn serves(&self, direction: Direction) -> bool {
        match (self.role, direction) {
            // A loopback made with exclusive_caps says CAPTURE alone while a program writes to it.
            (None | Some(Role::Loopback), _) => true,
            (Some(role), Direction::Capture) => role == Role::Camera,
            (_, Direction::Output) => self.identity.as_ref().is_some_and(|identity| identity.caps & capability(direction) != 0),
        }
    }

    fn is_loopback(&self) -> bool {
        self.role == Some(Role::Loopback)
    }

    fn same_bus(&self, other: &Self) -> bool {
        match (&self.identity, &other.identity) {
            (Some(one), Some(two)) => one.bus == two.bus,
            _ => false,
        }
    }
}

fn identify(path: &Path) -> Seen {
    let opened =
        Node::open(path).ok().and_then(|node| node.identity().ok().map(|identity| (Role::of(&node, &identity), identity)));
    match opened {
        Some((role, identity)) => Seen { card: identity.card.clone(), identity: Some(identity), role: Some(role) },
        None => Seen { card: kernel_name(path), identity: None, role: None },
    }
}

pub(super) fn capability(direction: Direction) -> u32 {
    match direction {
        Direction::Capture => V4L2_CAP_VIDEO_CAPTURE,
        Direction::Output => V4L2_CAP_VIDEO_OUTPUT,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seen(number: u32, card: &str, role: Role, bus: &str) -> (Seen, PathBuf) {
        let caps = if role == Role::Loopback { V4L2_CAP_VIDEO_OUTPUT } else { V4L2_CAP_VIDEO_CAPTURE };
        let identity = Identity { driver: "some".into(), card: card.into(), bus: bus.into(), caps };
        let seen = Seen { card: card.into(), identity: Some(identity), role: Some(role) };
        (seen, PathBuf::from(format!("/dev/video{number}")))
    }

    fn desk() -> Vec<(Seen, PathBuf)> {
        vec![
            seen(0, "gimbald", Role::Loopback, "platform:v4l2loopback-000"),
            seen(2, "HD Pro Webcam C920", Role::Camera, "usb-1"),
            seen(3, "HD Pro Webcam C920", Role::Other, "usb-1"),
            seen(4, "Integrated Camera: Integrated C", Role::Camera, "usb-2"),
            seen(5, "Integrated Camera: Integrated I", Role::Camera, "usb-2"),
            seen(6, "Conference Camera", Role::Camera, "usb-3"),
        ]
    }

    fn paths(name: &str, direction: Direction, known: &[(Seen, PathBuf)]) -> Vec<String> {
        pick(name, direction, known, &[]).unwrap().iter().map(|path| path.display().to_string()).collect()
    }

    fn error(name: &str, direction: Direction, known: &[(Seen, PathBuf)]) -> String {
        pick(name, direction, known, &[]).unwrap_err().to_string()
    }

    #[test]
    fn by_number_and_path_nothing_is_searched() {
        assert_eq!(find("7", Direction::Capture).unwrap(), Path::new("/dev/video7"));
        assert_eq!(find("/dev/v4l/by-id/x", Direction::Capture).unwrap(), Path::new("/dev/v4l/by-id/x"));
    }

    #[test]
    fn by_name() {
        assert_eq!(paths("HD Pro Webcam C920", Direction::Capture, &desk()), ["/dev/video2"], "not its metadata node");
        assert_eq!(paths("c920", Direction::Capture, &desk()), ["/dev/video2"]);
        let both = ["/dev/video4", "/dev/video5"];
        assert_eq!(paths("Integrated Camera", Direction::Capture, &desk()), both, "its formats tell which has the picture");
        let infrared = "integrated camera: integrated i";
        assert_eq!(paths(infrared, Direction::Capture, &desk()), ["/dev/video5"], "the whole name goes first");
        assert_eq!(paths("gimbald", Direction::Output, &desk()), ["/dev/video0"]);
        let several = error("camera", Direction::Capture, &desk());
        assert!(several.contains("more than one") && several.contains("/dev/video6"), "{several}");
        let none = error("C270", Direction::Capture, &desk());
        assert!(none.contains("cannot find such a camera") && none.contains("Conference Camera"), "{none}");
        let except = [PathBuf::from("/dev/video9")];
        let left = pick("C270", Direction::Capture, &desk(), &except).unwrap_err().to_string();
        assert!(left.contains("/dev/video9"), "{left}");
    }

    #[test]
    fn by_itself() {
        let cameras = ["/dev/video2", "/dev/video4", "/dev/video5", "/dev/video6"];
        assert_eq!(paths("auto", Direction::Capture, &desk()), cameras, "no loopback");
        assert_eq!(paths("auto", Direction::Output, &desk()), ["/dev/video0"]);
        let none = error("auto", Direction::Output, &[]);
        assert!(none.contains("modprobe v4l2loopback"), "{none}");
        let none = error("auto", Direction::Capture, &[]);
        assert!(none.contains("plug one in"), "{none}");
    }

    /// A Raspberry Pi with nothing but a CSI camera.
    #[test]
    fn stages_of_a_csi_camera_are_passed_over_and_libcamera_is_named() {
        let pi = [
            seen(0, "rp1-cfe", Role::Stage, "platform:1f00110000.csi"),
            seen(13, "bcm2835-isp", Role::Stage, "platform:bcm2835-isp"),
            seen(20, "gimbald", Role::Loopback, "platform:v4l2loopback-000"),
        ];
        for name in ["auto", "isp", "rp1-cfe"] {
            let none = error(name, Direction::Capture, &pi);
            assert!(none.contains("libcamerasrc") && none.contains("/dev/video13"), "{none}");
        }
        let with_webcam =
            [pi, [seen(2, "Webcam", Role::Camera, "usb-1"), seen(3, "", Role::Other, ""), seen(4, "", Role::Other, "")]];
        let known: Vec<_> = with_webcam.into_iter().flatten().collect();
        assert_eq!(paths("auto", Direction::Capture, &known), ["/dev/video2"]);
    }
}
