//! `gimbald devices`: the cameras and loopback devices that gimbald can use, with their formats.

use std::io::{self, Write};

use super::Failure;
use super::print::written_or_closed;
use crate::device::v4l2::{DeviceInfo, LOAD_COMMAND, devices};

/// Arguments of `devices`.
#[derive(Clone, Copy, Debug, clap::Args)]
pub struct Args {
    /// Also list devices and formats that gimbald cannot use
    #[arg(short, long)]
    all: bool,
}

/// Runs the command.
///
/// # Errors
/// Where standard output cannot be written.
pub fn run(args: &Args) -> Result<(), Failure> {
    written_or_closed(list(devices(), args.all, &mut io::stdout().lock()))
}

/// Whether gimbald can use a device; one that cannot be opened may be usable.
fn is_usable(device: &DeviceInfo) -> bool {
    let readable = device.formats.iter().any(|format| format.pixel.is_some());
    device.problem.is_some() || device.output || (device.capture && readable)
}

fn list(mut devices: Vec<DeviceInfo>, all: bool, to: &mut dyn Write) -> io::Result<()> {
    let found = devices.len();
    let has_stage = devices.iter().any(|device| device.stage);
    if !all {
        devices.retain(is_usable);
        devices.iter_mut().for_each(|device| device.formats.retain(|format| format.pixel.is_some()));
    }
    devices.iter().try_for_each(|device| writeln!(to, "{device}\n"))?;
    if devices.len() < found {
        let others = found - devices.len();
        let noun = if others == 1 { "device" } else { "devices" };
        writeln!(to, "{others} other {noun} that gimbald cannot use: list with `gimbald devices --all`")?;
    }
    if !devices.iter().any(|device| device.capture && !device.output) {
        writeln!(to, "No camera found: plug one in, or check that you may open /dev/video* (group video).")?;
        if has_stage {
            writeln!(to, "CSI cameras need libcamera and a loopback device of their own, see docs/cameras.md.")?;
        }
    }
    if !devices.iter().any(|device| device.output) {
        writeln!(to, "No loopback device found: {LOAD_COMMAND} (package v4l2loopback-dkms).")?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use super::*;
    use crate::device::v4l2::FormatInfo;
    use crate::image::PixelFormat;

    fn device(card: &str, pixels: &[Option<PixelFormat>], output: bool) -> DeviceInfo {
        let format = |pixel: &Option<PixelFormat>| FormatInfo {
            fourcc: *b"ABCD",
            name: if pixel.is_some() { "readable".into() } else { "unreadable".into() },
            pixel: *pixel,
            sizes: Vec::new(),
        };
        DeviceInfo {
            path: PathBuf::from("/dev/video0"),
            card: card.into(),
            driver: "test".into(),
            bus: "test".into(),
            links: Vec::new(),
            capture: !output,
            output,
            stage: false,
            formats: pixels.iter().map(format).collect(),
            problem: None,
        }
    }

    fn listed(devices: Vec<DeviceInfo>, all: bool) -> String {
        let mut text = Vec::new();
        list(devices, all, &mut text).unwrap();
        String::from_utf8(text).unwrap()
    }

    #[test]
    fn a_machine_without_devices_is_told_what_to_do() {
        let text = listed(Vec::new(), false);
        assert!(text.contains("No camera found") && text.contains("modprobe v4l2loopback"), "{text}");
    }

    #[test]
    fn what_gimbald_cannot_use_is_listed_on_request() {
        let devices = || {
            vec![
                device("Cam", &[Some(PixelFormat::Yuyv), None], false),
                device("Loop", &[Some(PixelFormat::I420), None, None], true),
                device("Odd", &[None], false),
            ]
        };
        let (short, long) = (listed(devices(), false), listed(devices(), true));
        assert_eq!((short.matches("ABCD").count(), long.matches("ABCD").count()), (2, 6), "{short}{long}");
        assert!(!short.contains("Odd") && short.contains("1 other device that gimbald cannot use"), "{short}");
        assert!(long.contains("Odd") && !long.contains("other device"), "{long}");
    }
}
