//! USB ports with cameras, as files in a temporary directory, and what is found on it.

use std::fs;
use std::os::unix::fs::symlink;
use std::path::Path;

use super::*;

/// A tree of sysfs and /dev.
struct UsbPorts {
    root: tempfile::TempDir,
    roots: Roots,
}

/// A camera: the socket that it is in, its model, its serial number.
type Camera = (&'static str, &'static str, &'static str);

const OURS: Camera = ("1-1", "0001", "TEST0001");
const TWIN: Camera = ("1-2", "0001", "TEST0002");
const BY_ID: &str = "/dev/v4l/by-id/usb-Test_TEST0001-video-index0";
const BY_PATH: &str = "/dev/v4l/by-path/pci-usb-0:1:1.0-video-index0";

impl UsbPorts {
    fn new() -> Self {
        let root = tempfile::tempdir().unwrap();
        let roots = Roots { dev: root.path().join("dev"), class: root.path().join("sys/class/video4linux") };
        for folder in [roots.dev.join("v4l/by-id"), roots.dev.join("v4l/by-path"), roots.class.clone()] {
            fs::create_dir_all(folder).unwrap();
        }
        Self { root, roots }
    }

    /// Plugs a camera in: a node with the picture, and one with metadata behind it, from `number`.
    fn plug(&self, (socket, model, serial): Camera, number: u32) {
        let usb = self.root.path().join("sys/devices/usb1").join(socket);
        let interface = usb.join(format!("{socket}:1.0"));
        for (index, number) in [(0, number), (1, number + 1)] {
            let node = format!("video{number}");
            let entry = interface.join("video4linux").join(&node);
            fs::create_dir_all(&entry).unwrap();
            fs::write(entry.join("name"), "Test\n").unwrap();
            fs::write(entry.join("index"), format!("{index}\n")).unwrap();
            symlink(&interface, entry.join("device")).unwrap();
            symlink(&entry, self.roots.class.join(&node)).unwrap();
            fs::write(self.roots.dev.join(&node), "").unwrap();
        }
        fs::write(usb.join("idVendor"), "1209\n").unwrap();
        fs::write(usb.join("idProduct"), format!("{model}\n")).unwrap();
        if !serial.is_empty() {
            fs::write(usb.join("serial"), format!("{serial}\n")).unwrap();
        }
    }

    fn unplug(&self, (socket, ..): Camera) {
        let usb = self.root.path().join("sys/devices/usb1").join(socket);
        for number in super::super::sighting::numbers(&usb.join(format!("{socket}:1.0/video4linux"))) {
            let node = format!("video{number}");
            fs::remove_file(self.roots.class.join(&node)).unwrap();
            fs::remove_file(self.roots.dev.join(&node)).unwrap();
        }
        fs::remove_dir_all(usb).unwrap();
    }

    /// What udev does.
    fn link(&self, link: &str, number: u32) {
        let path = self.roots.dev.join(link.strip_prefix("/dev/").unwrap());
        let _ = fs::remove_file(&path);
        symlink(format!("../../video{number}"), path).unwrap();
    }

    fn unlink(&self, link: &str) {
        fs::remove_file(self.roots.dev.join(link.strip_prefix("/dev/").unwrap())).unwrap();
    }

    /// Opens the camera at a node, with all that is there.
    fn open(&self, number: u32) -> Known {
        let mut known = Known::new(self.roots.at(&PathBuf::from(format!("/dev/video{number}"))).unwrap());
        known.look_around(&self.roots.sightings());
        known
    }

    fn next(&self, known: &Known, setting: &str, waits: bool) -> Next {
        known.next(setting, &There::look(setting, &self.roots), waits)
    }

    /// The node that would be opened; "search" or "wait" where none is known.
    fn finds(&self, known: &Known, setting: &str) -> String {
        match self.next(known, setting, true) {
            Next::Open(nodes) => nodes[0].node.display().to_string(),
            Next::Search { except } if except.is_empty() => "search".into(),
            Next::Search { except } => format!("search, not {}", except[0].display()),
            Next::Wait(_) => "wait".into(),
        }
    }
}

#[test]
fn nodes_are_read_off_sysfs() {
    let ports = UsbPorts::new();
    ports.plug(OURS, 3);
    ports.link(BY_ID, 3);
    let seen = ports.roots.sightings();
    assert_eq!(seen.iter().map(|seen| seen.node.display().to_string()).collect::<Vec<_>>(), ["/dev/video3", "/dev/video4"]);
    assert_eq!((seen[1].index, seen[1].function.as_str(), seen[1].device.serial()), (1, "1.0", Some("TEST0001")));
    assert_eq!(ports.roots.at(Path::new(BY_ID)).as_ref(), Some(&seen[0]));
    ports.link(BY_PATH, 3);
    assert_eq!(ports.roots.links(&seen[0].node), [Path::new(BY_ID), Path::new(BY_PATH)]);
    assert!(ports.roots.links(&seen[1].node).is_empty());
    assert_eq!(ports.roots.at(Path::new("/dev/v4l/by-id")), None, "a folder");
    assert!(seen[0].device.place.ends_with("1-1") && seen[0].device.described() == "Test (serial TEST0001)");
    fs::remove_file(ports.roots.dev.join("video4")).unwrap();
    assert_eq!(ports.roots.sightings().len(), 1, "a node that a container does not have");
}

/// Our camera, opened by its number 0, and its twin; udev's links lead to ours.
fn two_alike() -> (UsbPorts, Known) {
    let ports = UsbPorts::new();
    ports.plug(OURS, 0);
    ports.plug(TWIN, 2);
    ports.link(BY_ID, 0);
    ports.link(BY_PATH, 0);
    let known = ports.open(0);
    (ports, known)
}

/// By every kind of name: ours goes, and comes back under another number, while its twin stays.
#[test]
fn ours_is_found_under_another_number_and_its_twin_is_left_alone() {
    let (ports, known) = two_alike();
    ports.unplug(OURS);
    ports.unlink(BY_ID);
    ports.unlink(BY_PATH);
    assert_eq!(ports.finds(&known, "0"), "search, not /dev/video2", "nothing has that number");
    assert_eq!(ports.finds(&known, "Test"), "search, not /dev/video2");
    for setting in [BY_ID, BY_PATH, "auto", ""] {
        assert_eq!(ports.finds(&known, setting), "wait", "{setting}");
    }
    assert_eq!(ports.next(&known, "auto", false), Next::Search { except: vec![] }, "in the end auto takes another");
    ports.plug(OURS, 4);
    // udev has made no link yet; that it is ours is plain all the same.
    for setting in ["0", "/dev/video0", "Test", "auto", BY_ID, BY_PATH] {
        assert_eq!(ports.finds(&known, setting), "/dev/video4", "{setting}");
    }
}

#[test]
fn the_twin_that_takes_our_number_is_not_opened() {
    let (ports, known) = two_alike();
    ports.unplug(OURS);
    ports.unplug(TWIN);
    ports.plug(TWIN, 0);
    // For some milliseconds the links of ours lead to it, too.
    for setting in ["0", BY_ID, BY_PATH, "/dev/video0", "auto"] {
        assert_eq!(ports.finds(&known, setting), "wait", "{setting}");
    }
    let Next::Wait(why) = ports.next(&known, "0", true) else { panic!() };
    assert!(why.contains("TEST0002") && why.contains("TEST0001") && why.contains("restart gimbald"), "{why}");
    assert_eq!(ports.finds(&known, "Test"), "search, not /dev/video0");
    ports.plug(OURS, 2);
    ports.link(BY_ID, 2);
    for setting in ["0", "Test", "auto", BY_ID] {
        assert_eq!(ports.finds(&known, setting), "/dev/video2", "{setting}");
    }
}

/// A link that is stale leads to a camera that was never seen before.
#[test]
fn a_stale_link_is_not_followed_to_a_new_camera() {
    let ports = UsbPorts::new();
    ports.plug(OURS, 0);
    ports.link(BY_ID, 0);
    ports.link(BY_PATH, 0);
    let known = ports.open(0);
    ports.unplug(OURS);
    ports.plug(TWIN, 0);
    assert_eq!(ports.finds(&known, BY_ID), "wait");
    assert_eq!(ports.finds(&known, BY_PATH), "wait");
    assert_eq!(ports.finds(&known, "0"), "search", "by number a new camera is as good as ours was");
}

#[test]
fn the_two_change_sockets() {
    let ports = UsbPorts::new();
    ports.plug(OURS, 0);
    ports.plug(TWIN, 2);
    let known = ports.open(0);
    ports.unplug(OURS);
    ports.unplug(TWIN);
    ports.plug(("1-1", "0001", "TEST0002"), 0);
    ports.plug(("1-2", "0001", "TEST0001"), 2);
    ports.link(BY_ID, 2);
    ports.link(BY_PATH, 0);
    for setting in ["0", "Test", "auto", BY_ID] {
        assert_eq!(ports.finds(&known, setting), "/dev/video2", "{setting}");
    }
    assert_eq!(ports.finds(&known, BY_PATH), "wait", "its socket has the twin");
    ports.unplug(("1-1", "0001", "TEST0002"));
    ports.plug(("1-1", "0001", "TEST0003"), 0);
    assert_eq!(ports.finds(&known, BY_PATH), "/dev/video0", "a new one in its socket is what was asked for");
}

/// Cheap cameras have no serial number, or all the same.
#[test]
fn twins_without_a_serial_number_are_told_apart_by_their_sockets() {
    for serial in ["", "SAME"] {
        let ports = UsbPorts::new();
        let (ours, twin, elsewhere) = (("1-1", "0001", serial), ("1-2", "0001", serial), ("1-3", "0001", serial));
        ports.plug(ours, 0);
        ports.plug(twin, 2);
        ports.link(BY_PATH, 0);
        let known = ports.open(0);
        ports.unplug(ours);
        // The link by identity is of both; udev gives it to the one that is there.
        ports.link(BY_ID, 2);
        assert_eq!(ports.finds(&known, BY_ID), "wait");
        assert_eq!(ports.finds(&known, "2"), "wait");
        ports.plug(elsewhere, 4);
        assert_eq!(ports.finds(&known, "auto"), "/dev/video4", "it was moved: the other is where it was");
        ports.unplug(twin);
        assert_eq!(ports.finds(&known, "auto"), "wait", "it may be either");
        ports.plug(ours, 6);
        for setting in ["0", "Test", "auto"] {
            assert_eq!(ports.finds(&known, setting), "/dev/video6", "{setting}");
        }
    }
}

/// The twin came while ours was open, and went before ours did.
#[test]
fn whoever_was_beside_ours_at_any_time_is_known() {
    let ports = UsbPorts::new();
    ports.plug(OURS, 0);
    let mut known = ports.open(0);
    ports.plug(TWIN, 2);
    known.look_around(&ports.roots.sightings());
    ports.unplug(TWIN);
    known.look_around(&ports.roots.sightings());
    ports.unplug(OURS);
    known.look_around(&ports.roots.sightings());
    ports.plug(("1-5", "0001", "TEST0002"), 0);
    assert_eq!(ports.finds(&known, "0"), "wait", "its serial number goes with it");
    assert_eq!(ports.finds(&known, "Test"), "search, not /dev/video0");
    ports.plug(("1-6", "0001", "TEST0009"), 2);
    assert_eq!(ports.finds(&known, "Test"), "search, not /dev/video0", "a new one may be taken");
}

#[test]
fn a_camera_that_moved_is_found_by_its_serial_number() {
    let ports = UsbPorts::new();
    ports.plug(OURS, 0);
    let mut known = ports.open(0);
    ports.unplug(OURS);
    ports.plug(("1-7", "0001", "TEST0001"), 0);
    assert_eq!(ports.finds(&known, "Test"), "/dev/video0");
    known.opened(ports.roots.at(Path::new("/dev/video0")).unwrap());
    assert!(known.camera().place.ends_with("1-7"));
    ports.unplug(("1-7", "0001", "TEST0001"));
    ports.plug(("1-1", "0002", "TEST0001"), 0);
    assert_eq!(ports.finds(&known, "auto"), "wait", "another model with the same serial number");
}

/// The node with the picture is there a moment after the first of its camera.
#[test]
fn the_node_that_had_the_picture_is_waited_for() {
    let ports = UsbPorts::new();
    ports.plug(OURS, 0);
    let known = ports.open(1);
    ports.unplug(OURS);
    ports.plug(OURS, 4);
    assert_eq!(ports.finds(&known, "auto"), "/dev/video5");
    fs::remove_file(ports.roots.dev.join("video5")).unwrap();
    assert_eq!(ports.finds(&known, "auto"), "wait");
    assert!(matches!(ports.next(&known, "auto", false), Next::Open(nodes) if nodes.len() == 1));
}

#[test]
fn what_is_no_usb_device_is_told_by_its_place() {
    let ports = UsbPorts::new();
    let vivid = |number: u32, name: &str| {
        let platform = ports.root.path().join("sys/devices/platform").join(name);
        let entry = platform.join(format!("video4linux/video{number}"));
        fs::create_dir_all(&entry).unwrap();
        fs::write(entry.join("name"), "vivid\n").unwrap();
        symlink(&platform, entry.join("device")).unwrap();
        symlink(&entry, ports.roots.class.join(format!("video{number}"))).unwrap();
        fs::write(ports.roots.dev.join(format!("video{number}")), "").unwrap();
    };
    vivid(0, "vivid.0");
    vivid(1, "vivid.1");
    let known = ports.open(0);
    fs::remove_file(ports.roots.class.join("video0")).unwrap();
    assert_eq!(ports.finds(&known, "1"), "wait");
    vivid(2, "vivid.0");
    for setting in ["0", "1", "vivid", "auto"] {
        assert_eq!(ports.finds(&known, setting), "/dev/video2", "{setting}");
    }
}

#[test]
fn a_path_that_is_no_video_node_is_left_to_be_opened() {
    let ports = UsbPorts::new();
    ports.plug(OURS, 0);
    let known = ports.open(0);
    fs::write(ports.roots.dev.join("null"), "").unwrap();
    assert_eq!(ports.finds(&known, "/dev/null"), "search");
}

#[test]
fn another_camera_is_known_as_one() {
    for serials in [("", ""), ("TEST0001", "TEST0001"), ("TEST0001", "TEST0002")] {
        let ports = UsbPorts::new();
        let (ours, twin) = (("1-1", "0001", serials.0), ("1-2", "0001", serials.1));
        ports.plug(ours, 0);
        ports.plug(twin, 2);
        let known = ports.open(0);
        let at = |node: &str| ports.roots.at(Path::new(node)).unwrap().device;
        assert!(!known.is_another(&at("/dev/video0")) && known.is_another(&at("/dev/video2")), "{serials:?}");
        ports.unplug(ours);
        assert!(known.is_another(&at("/dev/video2")), "{serials:?}: ours is away");
        ports.plug(ours, 4);
        assert!(!known.is_another(&at("/dev/video4")), "{serials:?}: under another number");
        ports.unplug(ours);
        ports.plug(("1-1", "0002", serials.0), 0);
        assert!(known.is_another(&at("/dev/video0")), "{serials:?}: another model in its socket");
    }
}
