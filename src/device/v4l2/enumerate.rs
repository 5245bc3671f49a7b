//! Lists video devices and their capabilities.

use std::fmt;
use std::path::{Path, PathBuf};

use v4l::frameinterval::FrameIntervalEnum;
use v4l::framesize::FrameSizeEnum;
use v4l::v4l_sys::{V4L2_CAP_STREAMING, V4L2_CAP_VIDEO_CAPTURE, V4L2_CAP_VIDEO_OUTPUT};

use super::super::DeviceError;
use super::mode::{Intervals, Sizes, rate};
use super::node::{Direction, Node};
use super::role::Role;
use super::sighting::{Roots, numbers};
use crate::image::PixelFormat;

/// How many entries of any list a driver is believed to have; more is a driver gone mad.
pub(super) const MAX_ENTRIES: u32 = 512;

/// The driver name of v4l2loopback.
pub(super) const LOOPBACK_DRIVER: &str = "v4l2 loopback";

/// A video device.
#[derive(Debug)]
pub struct DeviceInfo {
    /// Its node.
    pub path: PathBuf,
    /// Its name; from the kernel's list where the node cannot be opened.
    pub card: String,
    /// The driver's name; empty where the node cannot be opened.
    pub driver: String,
    /// Where it is plugged in.
    pub bus: String,
    /// Links to it below /dev/v4l, of a camera: names that do not change.
    pub links: Vec<PathBuf>,
    /// Whether it gives frames (a camera).
    pub capture: bool,
    /// Whether it takes frames (a loopback).
    pub output: bool,
    /// Whether it is a stage of a CSI camera's path or a codec: it gives no picture by itself.
    pub stage: bool,
    /// The formats it gives, or where it gives none, takes.
    pub formats: Vec<FormatInfo>,
    /// Why it could not be looked at.
    pub problem: Option<DeviceError>,
}

/// A format of a device.
#[derive(Clone, Debug)]
pub struct FormatInfo {
    /// V4L2's four-letter code.
    pub fourcc: [u8; 4],
    /// The driver's words for it.
    pub name: String,
    /// What gimbald calls it; `None` where it cannot read it.
    pub pixel: Option<PixelFormat>,
    /// Sizes, each with its rates; empty where the driver does not say.
    pub sizes: Vec<(Sizes, Vec<Intervals>)>,
}

/// Every video device of the machine, by number. Nodes that cannot be opened are listed with the reason.
pub fn devices() -> Vec<DeviceInfo> {
    nodes().iter().map(|path| look(path)).collect()
}

/// /dev/video0 and so on, by number.
pub(super) fn nodes() -> Vec<PathBuf> {
    numbers(Path::new("/dev")).into_iter().map(|number| PathBuf::from(format!("/dev/video{number}"))).collect()
}

/// The card's name without opening the node.
pub(super) fn kernel_name(path: &Path) -> String {
    let Some(node) = path.file_name() else { return String::new() };
    let file = Path::new("/sys/class/video4linux").join(node).join("name");
    std::fs::read_to_string(file).map(|name| name.trim().to_string()).unwrap_or_default()
}

/// Everything about the node at `path`.
fn look(path: &Path) -> DeviceInfo {
    let mut info = DeviceInfo {
        path: path.to_path_buf(),
        card: String::new(),
        driver: String::new(),
        bus: String::new(),
        links: Vec::new(),
        capture: false,
        output: false,
        stage: false,
        formats: Vec::new(),
        problem: None,
    };
    let opened = Node::open(path).and_then(|node| match node.identity() {
        Ok(identity) => Ok((node, identity)),
        Err(errno) => Err(node.error("query the capabilities of", errno)),
    });
    match opened {
        Err(problem) => {
            info.card = kernel_name(path);
            info.problem = Some(problem);
        }
        Ok((node, identity)) => {
            let streams = identity.caps & V4L2_CAP_STREAMING != 0;
            info.stage = Role::of(&node, &identity) == Role::Stage;
            info.capture = streams && !info.stage && identity.caps & V4L2_CAP_VIDEO_CAPTURE != 0;
            info.output = streams && !info.stage && identity.caps & V4L2_CAP_VIDEO_OUTPUT != 0;
            (info.card, info.driver, info.bus) = (identity.card, identity.driver, identity.bus);
            if info.capture {
                info.links = Roots::default().links(path);
                info.formats = formats(&node, Direction::Capture);
            }
            if info.output && info.formats.is_empty() {
                info.formats = formats(&node, Direction::Output);
            }
        }
    }
    info
}

/// The formats of a node with their sizes and rates.
fn formats(node: &Node, direction: Direction) -> Vec<FormatInfo> {
    (0..MAX_ENTRIES)
        .map_while(|index| node.pixel_format(direction, index))
        .map(|(fourcc, name)| FormatInfo {
            fourcc,
            name,
            pixel: PixelFormat::from_fourcc(fourcc),
            sizes: sizes_with_rates(node, fourcc),
        })
        .collect()
}

/// The sizes of a format; empty where the driver does not list them.
pub(super) fn sizes(node: &Node, fourcc: [u8; 4]) -> Vec<Sizes> {
    (0..MAX_ENTRIES)
        .map_while(|index| node.frame_size(fourcc, index))
        .map(|size| match size {
            FrameSizeEnum::Discrete(size) => Sizes::One(size.width, size.height),
            FrameSizeEnum::Stepwise(range) => Sizes::Range {
                min: (range.min_width, range.min_height),
                max: (range.max_width, range.max_height),
                step: (range.step_width, range.step_height),
            },
        })
        .collect()
}

fn sizes_with_rates(node: &Node, fourcc: [u8; 4]) -> Vec<(Sizes, Vec<Intervals>)> {
    let rated = |size| {
        let (width, height) = match size {
            Sizes::One(width, height) => (width, height),
            Sizes::Range { max, .. } => max,
        };
        (size, intervals(node, fourcc, width, height))
    };
    sizes(node, fourcc).into_iter().map(rated).collect()
}

/// The times between frames that a format allows at a size; empty where the driver does not list them.
pub(super) fn intervals(node: &Node, fourcc: [u8; 4], width: u32, height: u32) -> Vec<Intervals> {
    (0..MAX_ENTRIES)
        .map_while(|index| node.frame_interval(fourcc, width, height, index))
        .map(|interval| match interval {
            FrameIntervalEnum::Discrete(one) => Intervals::One(one.numerator, one.denominator),
            FrameIntervalEnum::Stepwise(range) => Intervals::Range {
                min: (range.min.numerator, range.min.denominator),
                max: (range.max.numerator, range.max.denominator),
            },
        })
        .collect()
}

impl fmt::Display for DeviceInfo {
    /// The device as `gimbald devices` shows it, several lines, the last without an end.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}  {}", self.path.display(), if self.card.is_empty() { "(no name)" } else { &self.card })?;
        if let Some(problem) = &self.problem {
            return write!(f, "\n    {problem}");
        }
        let role = match (self.capture, self.output) {
            (true, true) => "camera and output",
            (true, false) => "camera",
            (false, true) => "output",
            (false, false) if self.stage => {
                "not a camera: a part of a CSI camera's pipeline (used through libcamera), or a codec"
            }
            (false, false) => "neither camera nor output (metadata, or multi-planar)",
        };
        write!(f, "\n    {role}; driver {}, {}", self.driver, self.bus)?;
        for link in &self.links {
            write!(f, "\n    {}", link.display())?;
        }
        for format in &self.formats {
            let code = String::from_utf8_lossy(&format.fourcc);
            let note = if format.pixel.is_none() { "  (gimbald cannot read it)" } else { "" };
            write!(f, "\n    {code}  {}{note}", format.name)?;
            if format.pixel.is_some() {
                for (size, rates) in &format.sizes {
                    write!(f, "\n        {size}{}", Rates(rates))?;
                }
            }
        }
        Ok(())
    }
}

impl fmt::Display for Sizes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::One(width, height) => write!(f, "{width}x{height}"),
            Self::Range { min, max, .. } => write!(f, "{}x{} to {}x{}", min.0, min.1, max.0, max.1),
        }
    }
}

/// Intervals, shown as rates.
struct Rates<'a>(&'a [Intervals]);

impl fmt::Display for Rates<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.0.is_empty() {
            return Ok(());
        }
        let shown = |interval| rate(interval).map_or("?".into(), |fps| format!("{}", (fps * 100.0).round() / 100.0));
        let rates: Vec<_> = self
            .0
            .iter()
            .map(|intervals| match *intervals {
                Intervals::One(numerator, denominator) => shown((numerator, denominator)),
                Intervals::Range { min, max } => format!("{} to {}", shown(max), shown(min)),
            })
            .collect();
        write!(f, " at {} fps", rates.join(", "))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_device_is_listed_once_by_a_node_that_exists() {
        let devices = devices();
        let mut paths: Vec<_> = devices.iter().map(|device| device.path.clone()).collect();
        paths.sort();
        paths.dedup();
        assert_eq!(paths.len(), devices.len());
        for device in devices {
            assert!(Path::new(&device.path).exists(), "{device:?}");
            assert!(device.to_string().contains(&*device.path.to_string_lossy()), "{device}");
        }
    }
}
