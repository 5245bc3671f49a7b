//! `gimbald devices`: which cameras and loopbacks there are, and what they can do.

use std::io::{self, Write};

use super::Failure;
use super::say::told;
use crate::device::v4l2::{DeviceInfo, devices};

/// Runs the command.
///
/// # Errors
/// Where standard output cannot be written.
pub fn run() -> Result<(), Failure> {
    told(list(&devices(), &mut io::stdout().lock()))
}

fn list(devices: &[DeviceInfo], to: &mut dyn Write) -> io::Result<()> {
    devices.iter().try_for_each(|device| writeln!(to, "{device}\n"))?;
    if !devices.iter().any(|device| device.capture && !device.output) {
        writeln!(to, "No camera: plug one in; where there is one, see whether you may read /dev/video* (group video).")?;
        if devices.iter().any(|device| device.stage) {
            writeln!(to, "CSI cameras go through libcamera, into a loopback of their own: see the README.")?;
        }
    }
    if !devices.iter().any(|device| device.output) {
        writeln!(
            to,
            "No loopback: sudo modprobe v4l2loopback exclusive_caps=1 card_label=gimbald (package v4l2loopback-dkms)."
        )?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_machine_without_devices_is_told_what_to_do() {
        let mut text = Vec::new();
        list(&[], &mut text).unwrap();
        let text = String::from_utf8(text).unwrap();
        assert!(text.contains("No camera: plug one in") && text.contains("modprobe v4l2loopback"), "{text}");
    }
}
