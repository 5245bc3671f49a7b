//! Which device a setting means.

use std::path::{Path, PathBuf};

use v4l::v4l_sys::{V4L2_CAP_VIDEO_CAPTURE, V4L2_CAP_VIDEO_OUTPUT};

use super::super::DeviceError;
use super::enumerate::{LOOPBACK_DRIVER, kernel_name, nodes};
use super::node::{Direction, Identity, Node};

/// The node that `device` means: a number (`0`), a path (`/dev/video0`), a card name (`HD Pro Webcam C920`, whole or the only one
/// beginning so), or `auto`: the first camera that is no loopback, for output the first loopback.
///
/// # Errors
/// Where no device, or more than one, answers to it; the error lists those there are.
pub fn find(device: &str, direction: Direction) -> Result<PathBuf, DeviceError> {
    let device = device.trim();
    if device.starts_with('/') {
        return Ok(PathBuf::from(device));
    }
    if !device.is_empty() && device.bytes().all(|byte| byte.is_ascii_digit()) {
        return Ok(PathBuf::from(format!("/dev/video{device}")));
    }
    let known: Vec<_> = nodes().into_iter().map(|path| (identify(&path), path)).collect();
    pick(device, direction, known)
}

/// The choice of [`find`] among `known` nodes.
fn pick(device: &str, direction: Direction, known: Vec<(Seen, PathBuf)>) -> Result<PathBuf, DeviceError> {
    let serves = |seen: &Seen| match &seen.identity {
        // A loopback made with exclusive_caps says CAPTURE alone while somebody writes to it; opening it tells.
        Some(identity) => identity.caps & capability(direction) != 0 || identity.driver == LOOPBACK_DRIVER,
        // One that cannot be opened may be the one that is meant: opening it will say why not.
        None => true,
    };
    let auto = device.is_empty() || device.eq_ignore_ascii_case("auto");
    let matches: Vec<_> = if auto {
        let loopback = |seen: &Seen| seen.identity.as_ref().is_some_and(|identity| identity.driver == LOOPBACK_DRIVER);
        let wanted = direction == Direction::Output;
        let mut fit = known.iter().filter(|(seen, _)| seen.identity.is_some() && serves(seen) && loopback(seen) == wanted);
        fit.next().into_iter().collect()
    } else {
        let name = device.to_lowercase();
        let whole: Vec<_> = known.iter().filter(|(seen, _)| serves(seen) && seen.card.to_lowercase() == name).collect();
        if whole.is_empty() {
            known.iter().filter(|(seen, _)| serves(seen) && seen.card.to_lowercase().starts_with(&name)).collect()
        } else {
            whole
        }
    };
    match matches.as_slice() {
        [(_, path)] => Ok(path.clone()),
        // A camera with several nodes of one name: the first is the picture.
        [(first, path), rest @ ..] if rest.iter().all(|(seen, _)| seen.card == first.card && seen.same_bus(first)) => {
            Ok(path.clone())
        }
        found => {
            let role = if direction == Direction::Capture { "camera" } else { "loopback device" };
            let listed = if found.is_empty() { known.iter().collect() } else { found.to_vec() };
            let names: Vec<_> = listed.iter().map(|(seen, path)| format!("{} ({})", path.display(), seen.card)).collect();
            let count = if found.is_empty() { "no" } else { "more than one" };
            let there = if names.is_empty() {
                "there is no video device at all".into()
            } else {
                format!("there is {}", names.join(", "))
            };
            let advice = match direction {
                Direction::Output if found.is_empty() => super::LOAD_LOOPBACK,
                _ => "name it by number, path or card name",
            };
            let what = format!("{count} {role} answers to this; {there}; {advice}");
            Err(DeviceError::Unsupported { path: PathBuf::from(if auto { "auto" } else { device }), what })
        }
    }
}

/// A node as far as it can be told without its formats.
#[derive(Debug)]
struct Seen {
    card: String,
    identity: Option<Identity>,
}

impl Seen {
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
        let find = |name: &str, direction| pick(name, direction, desk()).map(|path| path.display().to_string());
        assert_eq!(find("HD Pro Webcam C920", Direction::Capture).unwrap(), "/dev/video2", "not its metadata node");
        assert_eq!(find("hd pro", Direction::Capture).unwrap(), "/dev/video2");
        assert_eq!(find("Integrated Camera", Direction::Capture).unwrap(), "/dev/video4", "the whole name goes first");
        assert_eq!(find("gimbald", Direction::Output).unwrap(), "/dev/video0");
        let several = find("integ", Direction::Capture).unwrap_err().to_string();
        assert!(several.contains("more than one") && several.contains("/dev/video5"), "{several}");
        let none = find("C270", Direction::Capture).unwrap_err().to_string();
        assert!(none.contains("no camera") && none.contains("Integrated Camera IR"), "{none}");
    }

    #[test]
    fn by_itself() {
        assert_eq!(pick("auto", Direction::Capture, desk()).unwrap(), Path::new("/dev/video2"), "no loopback");
        assert_eq!(pick("auto", Direction::Output, desk()).unwrap(), Path::new("/dev/video0"));
        let none = pick("auto", Direction::Output, Vec::new()).unwrap_err().to_string();
        assert!(none.contains("modprobe v4l2loopback"), "{none}");
    }
}
