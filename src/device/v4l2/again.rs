//! Finding the camera again that was open before, and never another one in its place.
//!
//! Node numbers are given to whatever is plugged in first, names are those of a kind of camera, and for some milliseconds udev's links
//! lead to what has taken the number of what they were made for. What tells cameras apart is in sysfs: the socket, and of USB the
//! model and the serial number, where each has its own.

use std::path::PathBuf;

use super::sighting::{Device, Roots, Sighting};

/// The camera that was open last, and the devices that were there together with it: none of those is it.
#[derive(Clone, Debug)]
pub struct Known {
    camera: Sighting,
    beside: Vec<Device>,
}

/// What is there now.
#[derive(Clone, Debug)]
pub struct There {
    nodes: Vec<Sighting>,
    /// The node that the setting leads to, where it is a number or a path.
    named_node: Option<Sighting>,
    /// Whether the setting's path leads anywhere.
    leads: bool,
}

/// Where to look for the camera.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Next {
    /// It is one of these nodes.
    Open(Vec<Sighting>),
    /// As the setting says, but at none of these nodes: they are of cameras that are known to be others.
    Search {
        /// The nodes.
        except: Vec<PathBuf>,
    },
    /// It is not there; why nothing else may be opened.
    Wait(String),
}

/// How the setting names a camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Naming {
    Auto,
    Name,
    /// A number, or the node of that number.
    Number,
    /// A link of /dev/v4l/by-path: whatever is in that socket.
    Socket,
    /// A link of /dev/v4l/by-id: the camera of that model and serial number.
    Identity,
    /// Another path.
    Path,
}

/// Whether a device is the camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Verdict {
    /// The camera that was opened before.
    Same,
    /// It was connected together with the camera, or is now.
    Other,
    /// It may be the camera or one that was connected together with it: they are alike, and both were unplugged.
    Unclear,
    /// It was never seen.
    New,
}

impl There {
    /// Looks around for `setting`, a value of camera.device.
    pub fn look(setting: &str, roots: &Roots) -> Self {
        let path = path_of(setting);
        let named_node = path.as_ref().and_then(|path| roots.at(path));
        let leads = path.as_ref().is_some_and(|path| roots.real(path).is_some());
        Self { nodes: roots.sightings(), named_node, leads }
    }

    /// Every video node.
    pub fn nodes(&self) -> &[Sighting] {
        &self.nodes
    }

    fn has(&self, device: &Device) -> bool {
        self.nodes.iter().any(|seen| seen.device.is_same(device))
    }
}

/// The path that `setting` names; `None` where it is a name or "auto".
fn path_of(setting: &str) -> Option<PathBuf> {
    let setting = setting.trim();
    if !setting.is_empty() && setting.bytes().all(|byte| byte.is_ascii_digit()) {
        return Some(PathBuf::from(format!("/dev/video{setting}")));
    }
    setting.starts_with('/').then(|| PathBuf::from(setting))
}

impl Naming {
    fn of(setting: &str) -> Self {
        let Some(path) = path_of(setting) else {
            let setting = setting.trim();
            return if setting.is_empty() || setting.eq_ignore_ascii_case("auto") { Self::Auto } else { Self::Name };
        };
        let number = path.to_str().and_then(|path| path.strip_prefix("/dev/video"));
        if number.is_some_and(|number| number.bytes().all(|byte| byte.is_ascii_digit())) {
            Self::Number
        } else if path.starts_with("/dev/v4l/by-path") {
            Self::Socket
        } else if path.starts_with("/dev/v4l/by-id") {
            Self::Identity
        } else {
            Self::Path
        }
    }
}

impl Known {
    /// What is known when `camera` is opened for the first time.
    pub fn new(camera: Sighting) -> Self {
        Self { camera, beside: Vec::new() }
    }

    /// The camera, as it was when it was open last.
    pub fn camera(&self) -> &Device {
        &self.camera.device
    }

    /// Whether `now` is certainly not the camera that was open last: of another model or serial number, in another place where only that
    /// tells, or one that was there beside it.
    pub fn is_another(&self, now: &Device) -> bool {
        let camera = &self.camera.device;
        let elsewhere = now.usb.is_none() && now.place != camera.place;
        now.usb != camera.usb || elsewhere || self.beside.iter().any(|other| other.is_same(now))
    }

    /// The camera was opened again, or another was taken in its place. What was beside it stays known.
    pub fn opened(&mut self, camera: Sighting) {
        self.beside.retain(|other| !other.is_same(&camera.device));
        self.camera = camera;
    }

    /// Notes what is there together with the camera; nothing, where it is away.
    pub fn look_around(&mut self, nodes: &[Sighting]) {
        if !nodes.iter().any(|seen| seen.device.is_same(&self.camera.device)) {
            return;
        }
        for seen in nodes {
            let device = &seen.device;
            if !device.is_same(&self.camera.device) && !self.beside.iter().any(|other| other.is_same(device)) {
                self.beside.push(device.clone());
            }
        }
    }

    /// Where to look for the camera that `setting` means. `waits`: it has not been away for long, and "auto" waits for it.
    pub fn next(&self, setting: &str, there: &There, waits: bool) -> Next {
        let naming = Naming::of(setting);
        match naming {
            Naming::Socket | Naming::Identity | Naming::Path => self.next_at_path(naming, there),
            Naming::Number | Naming::Name | Naming::Auto => {
                if let Some(found) = self.same_camera(there, waits) {
                    return found;
                }
                let except = self.other_nodes(there);
                match (naming, &there.named_node) {
                    (Naming::Number, Some(named_node)) if except.contains(&named_node.node) => {
                        Next::Wait(self.why_not(named_node, there))
                    }
                    (Naming::Auto, _) if waits => Next::Wait(format!("{} is not there", self.camera.device.described())),
                    // There is no other to be had by waiting.
                    (Naming::Auto, _) => Next::Search { except: Vec::new() },
                    _ => Next::Search { except },
                }
            }
        }
    }

    /// For a setting that is a path: what it leads to, unless that is another camera.
    fn next_at_path(&self, naming: Naming, there: &There) -> Next {
        let Some(named_node) = &there.named_node else {
            if there.leads {
                // No video node: opening it will say what it is.
                return Next::Search { except: Vec::new() };
            }
            // Without udev there are no links; the same camera in the same socket is the same camera.
            let same = there.nodes.iter().find(|seen| seen.is_same(&self.camera) && seen.device.serial().is_some());
            return match same {
                Some(same) => Next::Open(vec![same.clone()]),
                None => Next::Wait(self.why_nothing(there)),
            };
        };
        let verdict = self.verdict(&named_node.device, there);
        let camera = &self.camera.device;
        // Else udev has not yet taken away a link whose number is another camera's by now.
        let true_link = match naming {
            Naming::Socket => named_node.device.place == camera.place,
            Naming::Identity => named_node.device.usb == camera.usb,
            _ => true,
        };
        if true_link && matches!(verdict, Verdict::Same | Verdict::New) {
            Next::Open(vec![named_node.clone()])
        } else {
            Next::Wait(self.why_not(named_node, there))
        }
    }

    /// The camera, where it is connected under whatever number.
    fn same_camera(&self, there: &There, waits: bool) -> Option<Next> {
        let is_same_camera = |seen: &&Sighting| self.verdict(&seen.device, there) == Verdict::Same;
        let own: Vec<_> = there.nodes.iter().filter(is_same_camera).collect();
        let same = |seen: &&&Sighting| seen.function == self.camera.function && seen.index == self.camera.index;
        // Drivers that make several cameras of one device (vivid does) are told apart by the node alone: the one that the settings name,
        // then the one that it had.
        let named = |seen: &&&Sighting| there.named_node.as_ref().is_some_and(|named_node| named_node.node == seen.node);
        let before = |seen: &&&Sighting| self.camera.node == seen.node;
        let found = || own.iter().filter(same);
        if let Some(same) = found().find(named).or_else(|| found().find(before)).or_else(|| found().next()) {
            return Some(Next::Open(vec![(*same).clone()]));
        }
        if own.is_empty() {
            return None;
        }
        // Its nodes come one after the other.
        Some(if waits {
            Next::Wait(format!("{} is connected, but its video node has not appeared yet", self.camera.device.described()))
        } else {
            Next::Open(own.into_iter().cloned().collect())
        })
    }

    /// The nodes of devices that are not, or may not be, the camera's.
    fn other_nodes(&self, there: &There) -> Vec<PathBuf> {
        let is_not = |seen: &&Sighting| matches!(self.verdict(&seen.device, there), Verdict::Other | Verdict::Unclear);
        there.nodes.iter().filter(is_not).map(|seen| seen.node.clone()).collect()
    }

    fn verdict(&self, device: &Device, there: &There) -> Verdict {
        let camera = &self.camera.device;
        if device.is_same(camera) {
            return Verdict::Same;
        }
        if there.has(camera) || self.beside.iter().any(|other| other.is_same(device)) {
            return Verdict::Other;
        }
        if device.usb.is_none() {
            // Only its place tells it from others.
            return Verdict::New;
        }
        let alike = |other: &&Device| other.usb == device.usb;
        let twins: Vec<_> = self.beside.iter().filter(alike).collect();
        if device.usb != camera.usb {
            // A serial number goes wherever its camera is plugged in; of one without, any that is away may be it.
            let moved = twins.iter().any(|twin| twin.serial().is_some() || !there.has(twin));
            return if moved { Verdict::Other } else { Verdict::New };
        }
        // It is like the camera, in another port.
        if camera.serial().is_some() && twins.is_empty() {
            return Verdict::Same;
        }
        let claims = |seen: &&Sighting| seen.device.usb == camera.usb && !twins.iter().any(|twin| twin.is_same(&seen.device));
        let alone = there.nodes.iter().filter(claims).all(|seen| seen.device.is_same(device));
        if alone && twins.iter().all(|twin| there.has(twin)) { Verdict::Same } else { Verdict::Unclear }
    }

    /// Why there is nothing to open where the setting's path leads nowhere.
    fn why_nothing(&self, there: &There) -> String {
        let camera = &self.camera.device;
        let elsewhere = there.nodes.iter().find(|seen| camera.serial().is_some() && seen.device.usb == camera.usb);
        let place = elsewhere.map_or("is not plugged in".into(), |seen| {
            format!(
                "is in USB port {} now, as {}: plug it into its previous port, or correct camera.device",
                seen.device.socket(),
                seen.node.display()
            )
        });
        format!("no device found; {} {place}", camera.described())
    }

    /// Why the node that the setting leads to is not opened.
    fn why_not(&self, named_node: &Sighting, there: &There) -> String {
        let (node, other, camera) = (named_node.node.display(), named_node.device.described(), self.camera.device.described());
        let socket = named_node.device.socket();
        match self.verdict(&named_node.device, there) {
            Verdict::Unclear => format!(
                "{node} is {other}: the camera in use, or one of the same kind that was connected together with it; plug it into its \
                 previous port, or restart gimbald to use this one"
            ),
            Verdict::Other => format!(
                "{node} is {other} in USB port {socket}, which was connected together with the camera in use, {camera}; restart gimbald to use it"
            ),
            Verdict::Same | Verdict::New => format!("{node} is {other} in USB port {socket}, not the port of {camera}"),
        }
    }
}

#[cfg(test)]
mod tests;
