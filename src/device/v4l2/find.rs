//! Which device a setting means.

use std::io;
use std::path::{Path, PathBuf};

use v4l::v4l_sys::{V4L2_CAP_VIDEO_CAPTURE, V4L2_CAP_VIDEO_OUTPUT};

use super::super::DeviceError;
use super::enumerate::{LOOPBACK_DRIVER, kernel_name, nodes};
use super::node::{Direction, Identity, Node};

/// The node that `device` means: a number (`0`), a path (`/dev/video0`), a card name or a part of one that only one card has
/// (`HD Pro Webcam C920`, `c920`), or `auto`: the first camera that is no loopback, for output the first loopback.
///
/// # Errors
/// Where no device, or more than one, answers to it; the error lists those there are.
pub fn find(device: &str, direction: Direction) -> Result<PathBuf, DeviceError> {
    let found = candidates(device, direction)?.into_iter().next();
    found.ok_or_else(|| DeviceError::Gone { path: PathBuf::from(device) })
}

/// The camera of that name that was seen before, wherever it is now: on the bus where it was, else the only one of its name.
pub fn find_again(card: &str, bus: &str) -> Option<PathBuf> {
    let known: Vec<_> = nodes().into_iter().map(|path| (identify(&path), path)).collect();
    again(card, bus, &known)
}

/// The choice of [`find_again`] among `known` nodes.
fn again(card: &str, bus: &str, known: &[(Seen, PathBuf)]) -> Option<PathBuf> {
    let captures = |identity: &&Identity| identity.card == card && identity.caps & V4L2_CAP_VIDEO_CAPTURE != 0;
    let alike: Vec<_> =
        known.iter().filter_map(|(seen, path)| seen.identity.as_ref().filter(captures).map(|found| (found, path))).collect();
    let same = alike.iter().find(|(found, _)| found.bus == bus);
    // The same camera in another socket; of two alike, either may be meant.
    let moved = || alike.first().filter(|first| alike.iter().all(|(found, _)| found.bus == first.0.bus));
    same.or_else(moved).map(|(_, path)| (*path).clone())
}

/// The nodes to try for `device`, best first, at least one: as [`find`], with every loopback that `auto` may mean.
pub(super) fn candidates(device: &str, direction: Direction) -> Result<Vec<PathBuf>, DeviceError> {
    let device = device.trim();
    if device.starts_with('/') {
        return Ok(vec![PathBuf::from(device)]);
    }
    if !device.is_empty() && device.bytes().all(|byte| byte.is_ascii_digit()) {
        return Ok(vec![PathBuf::from(format!("/dev/video{device}"))]);
    }
    let known: Vec<_> = nodes().into_iter().map(|path| (identify(&path), path)).collect();
    pick(device, direction, &known)
}

/// The choice of [`find`] among `known` nodes.
fn pick(device: &str, direction: Direction, known: &[(Seen, PathBuf)]) -> Result<Vec<PathBuf>, DeviceError> {
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
    // One camera often has several nodes of one name: the first has the picture.
    let one =
        |found: &[&(Seen, PathBuf)]| found.windows(2).all(|two| two[0].0.card == two[1].0.card && two[0].0.same_bus(&two[1].0));
    if !found.is_empty() && (auto || one(&found)) {
        return Ok(found.into_iter().map(|(_, path)| path.clone()).collect());
    }
    let listed = if found.is_empty() { known.iter().collect() } else { found.clone() };
    let names: Vec<_> = listed.iter().map(|(seen, path)| format!("{} ({})", path.display(), seen.card)).collect();
    let there =
        if names.is_empty() { "there is no video device at all".into() } else { format!("there is {}", names.join(", ")) };
    let path = PathBuf::from(if auto { "auto" } else { device });
    if !found.is_empty() {
        let what = format!("more than one device answers to this: {there}; name it by number, path or whole name");
        return Err(DeviceError::Unsupported { path, what });
    }
    Err(match direction {
        Direction::Output => DeviceError::Unsupported {
            path,
            what: format!("no loopback device answers to this; {there}; {}", super::LOAD_LOOPBACK),
        },
        // It may be plugged in yet.
        Direction::Capture => {
            let source = io::Error::new(io::ErrorKind::NotFound, there);
            DeviceError::Io { path, doing: "find such a camera", hint: "; name it by number, path or card name", source }
        }
    })
}

/// A node as far as it can be told without its formats.
#[derive(Debug)]
struct Seen {
    card: String,
    identity: Option<Identity>,
}

impl Seen {
    /// Whether frames can go that way; true where that cannot be told: opening it will say why not.
    fn serves(&self, direction: Direction) -> bool {
        // A loopback made with exclusive_caps says CAPTURE alone while somebody writes to it.
        self.identity.as_ref().is_none_or(|identity| identity.caps & capability(direction) != 0 || self.is_loopback())
    }

    fn is_loopback(&self) -> bool {
        self.identity.as_ref().is_some_and(|identity| identity.driver == LOOPBACK_DRIVER)
    }

    fn same_bus(&self, other: &Self) -> bool {
        match (&self.identity, &other.identity) {
            (Some(one), Some(two)) => one.bus == two.bus,
            _ => false,
        }
    }
}

fn identify(path: &Path) -> Seen {
    match Node::open(path).ok().and_then(|node| node.identity().ok()) {
        Some(identity) => Seen { card: identity.card.clone(), identity: Some(identity) },
        None => Seen { card: kernel_name(path), identity: None },
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

    fn seen(number: u32, card: &str, driver: &str, bus: &str, caps: u32) -> (Seen, PathBuf) {
        let identity = Identity { driver: driver.into(), card: card.into(), bus: bus.into(), caps };
        (Seen { card: card.into(), identity: Some(identity) }, PathBuf::from(format!("/dev/video{number}")))
    }

    fn desk() -> Vec<(Seen, PathBuf)> {
        vec![
            seen(0, "gimbald", LOOPBACK_DRIVER, "platform:v4l2loopback-000", V4L2_CAP_VIDEO_OUTPUT),
            seen(2, "HD Pro Webcam C920", "uvcvideo", "usb-1", V4L2_CAP_VIDEO_CAPTURE),
            seen(3, "HD Pro Webcam C920", "uvcvideo", "usb-1", 0x0080_0000),
            seen(4, "Integrated Camera", "uvcvideo", "usb-2", V4L2_CAP_VIDEO_CAPTURE),
            seen(5, "Integrated Camera IR", "uvcvideo", "usb-2", V4L2_CAP_VIDEO_CAPTURE),
        ]
    }

    #[test]
    fn by_number_and_path_nothing_is_searched() {
        assert_eq!(find("7", Direction::Capture).unwrap(), Path::new("/dev/video7"));
        assert_eq!(find("/dev/v4l/by-id/x", Direction::Capture).unwrap(), Path::new("/dev/v4l/by-id/x"));
    }

    #[test]
    fn by_name() {
        let find = |name: &str, direction| pick(name, direction, &desk()).map(|paths| paths[0].display().to_string());
        assert_eq!(find("HD Pro Webcam C920", Direction::Capture).unwrap(), "/dev/video2", "not its metadata node");
        assert_eq!(find("c920", Direction::Capture).unwrap(), "/dev/video2");
        assert_eq!(find("Integrated Camera", Direction::Capture).unwrap(), "/dev/video4", "the whole name goes first");
        assert_eq!(find("gimbald", Direction::Output).unwrap(), "/dev/video0");
        let several = find("camera", Direction::Capture).unwrap_err().to_string();
        assert!(several.contains("more than one") && several.contains("/dev/video5"), "{several}");
        let none = find("C270", Direction::Capture).unwrap_err().to_string();
        assert!(none.contains("cannot find such a camera") && none.contains("Integrated Camera IR"), "{none}");
    }

    #[test]
    fn a_camera_is_found_again_on_its_bus_or_where_it_was_moved_to() {
        let again = |card: &str, bus: &str| again(card, bus, &desk()).map(|path| path.display().to_string());
        assert_eq!(again("HD Pro Webcam C920", "usb-1").as_deref(), Some("/dev/video2"), "not its metadata node");
        assert_eq!(again("HD Pro Webcam C920", "usb-7").as_deref(), Some("/dev/video2"), "in another socket");
        assert_eq!(again("C920", "usb-1"), None, "another camera");
        let twins = [
            seen(1, "Cam", "uvcvideo", "usb-1", V4L2_CAP_VIDEO_CAPTURE),
            seen(2, "Cam", "uvcvideo", "usb-2", V4L2_CAP_VIDEO_CAPTURE),
        ];
        assert_eq!(super::again("Cam", "usb-2", &twins).unwrap(), Path::new("/dev/video2"));
        assert_eq!(super::again("Cam", "usb-3", &twins), None, "either may be meant");
    }

    #[test]
    fn by_itself() {
        assert_eq!(pick("auto", Direction::Capture, &desk()).unwrap()[0], Path::new("/dev/video2"), "no loopback");
        assert_eq!(pick("auto", Direction::Output, &desk()).unwrap(), [Path::new("/dev/video0")]);
        let none = pick("auto", Direction::Output, &[]).unwrap_err().to_string();
        assert!(none.contains("modprobe v4l2loopback"), "{none}");
    }
}
