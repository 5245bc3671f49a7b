//! Video nodes and the devices that they belong to, read from sysfs without opening a node.

use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};

/// A video node and what sysfs says of it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Sighting {
    /// /dev/videoN.
    pub node: PathBuf,
    /// The device that it belongs to.
    pub device: Device,
    /// Which of the device's functions it is (of USB its configuration and interface, `1.0`): a laptop's colour and infrared
    /// cameras are often two functions of one device.
    pub function: String,
    /// Which of the function's nodes it is; udev's links end in it (`-video-index0`).
    pub index: u32,
}

/// A device with video nodes, as far as it can be told from others of its kind.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Device {
    /// Its folder below /sys/devices: the socket that it is plugged into.
    pub place: PathBuf,
    /// Of a USB device, what its descriptor says.
    pub usb: Option<Usb>,
    /// The name of its first node, for people.
    pub name: String,
}

/// What a USB device's descriptor says of it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Usb {
    /// idVendor and idProduct, four hexadecimal digits each.
    pub model: (String, String),
    /// The serial number; `None` where it has none. Cheap cameras of one kind often all have the same.
    pub serial: Option<String>,
}

impl Device {
    /// Whether both are the same device in the same socket.
    pub fn is_same(&self, other: &Self) -> bool {
        self.place == other.place && self.usb == other.usb
    }

    /// The serial number, of a USB device that has one.
    pub fn serial(&self) -> Option<&str> {
        self.usb.as_ref()?.serial.as_deref()
    }

    /// The name of the socket that it is plugged into.
    pub fn socket(&self) -> String {
        self.place.file_name().unwrap_or_default().to_string_lossy().into_owned()
    }

    /// What people call it: `HD Pro Webcam C920 (serial 1234ABCD)`.
    pub fn described(&self) -> String {
        self.serial().map_or_else(|| self.name.clone(), |serial| format!("{} (serial {serial})", self.name))
    }
}

impl Sighting {
    /// Whether both are the same node of the same device in the same socket; its number may have changed.
    pub fn is_same(&self, other: &Self) -> bool {
        self.device.is_same(&other.device) && self.function == other.function && self.index == other.index
    }
}

/// Where devices are looked for; the tests have folders of their own.
#[derive(Clone, Debug)]
pub struct Roots {
    /// /dev.
    pub dev: PathBuf,
    /// /sys/class/video4linux.
    pub class: PathBuf,
}

impl Default for Roots {
    fn default() -> Self {
        Self { dev: "/dev".into(), class: "/sys/class/video4linux".into() }
    }
}

impl Roots {
    /// Every video node that is there, by number.
    pub fn sightings(&self) -> Vec<Sighting> {
        let numbers = numbers(&self.class);
        numbers.into_iter().filter_map(|number| self.sighting(&format!("video{number}"))).collect()
    }

    /// The node that `path` (a node, or a link to one) leads to.
    pub fn at(&self, path: &Path) -> Option<Sighting> {
        let node = self.real(path)?;
        self.sighting(node.file_name()?.to_str()?).filter(|seen| seen.node == node)
    }

    /// Where `path` below /dev leads to, through all links; `None` where nothing is there.
    pub fn real(&self, path: &Path) -> Option<PathBuf> {
        let below = path.strip_prefix("/dev").map_or_else(|_| path.to_path_buf(), |below| self.dev.join(below));
        let real = fs::canonicalize(below).ok()?;
        let dev = fs::canonicalize(&self.dev).ok()?;
        Some(real.strip_prefix(dev).map(|below| Path::new("/dev").join(below)).unwrap_or(real))
    }

    /// The links below /dev/v4l (by-id, by-path) that lead to a node: names that stay with the camera, and with the socket.
    pub fn links(&self, node: &Path) -> Vec<PathBuf> {
        let leads = |link: &PathBuf| self.real(link).is_some_and(|real| real == node);
        let mut links = Vec::new();
        for folder in ["v4l/by-id", "v4l/by-path"] {
            let Ok(entries) = fs::read_dir(self.dev.join(folder)) else { continue };
            let shown = entries.flatten().map(|entry| Path::new("/dev").join(folder).join(entry.file_name()));
            links.extend(shown.filter(leads));
        }
        links.sort();
        links
    }

    /// The node of that name, where both its device and its file are there: udev or a container may keep it away.
    fn sighting(&self, name: &str) -> Option<Sighting> {
        let entry = fs::canonicalize(self.class.join(name)).ok()?;
        if !self.dev.join(name).exists() {
            return None;
        }
        // A virtual device has no parent: it is a place of its own.
        let function = fs::canonicalize(entry.join("device")).unwrap_or_else(|_| entry.clone());
        let usb_device = function.ancestors().find(|folder| folder.join("idVendor").exists());
        let usb = usb_device.map(|folder| Usb {
            model: (line(&folder.join("idVendor")), line(&folder.join("idProduct"))),
            serial: Some(line(&folder.join("serial"))).filter(|serial| !serial.is_empty()),
        });
        let file_name = function.file_name().map(OsStr::to_string_lossy).unwrap_or_default();
        // 1-1:1.0 is interface 1.0 of the device in socket 1-1.
        let interface = usb_device.and_then(|_| file_name.split_once(':')).map_or(&*file_name, |(_, interface)| interface);
        let device = Device { place: usb_device.unwrap_or(&function).to_path_buf(), usb, name: line(&entry.join("name")) };
        let index = line(&entry.join("index")).parse().unwrap_or(0);
        Some(Sighting { node: Path::new("/dev").join(name), device, function: interface.to_string(), index })
    }
}

/// The numbers N of all entries videoN of a folder, ascending.
pub(super) fn numbers(folder: &Path) -> Vec<u32> {
    let Ok(entries) = fs::read_dir(folder) else { return Vec::new() };
    let number = |name: &OsStr| name.to_str()?.strip_prefix("video")?.parse().ok();
    let mut numbers: Vec<u32> = entries.flatten().filter_map(|entry| number(&entry.file_name())).collect();
    numbers.sort_unstable();
    numbers
}

/// The one line of a file of sysfs; empty where it cannot be read.
fn line(path: &Path) -> String {
    fs::read(path).map(|bytes| String::from_utf8_lossy(&bytes).trim().to_string()).unwrap_or_default()
}
