//! Negotiates a mode with a camera before it streams.

use std::path::Path;

use v4l::v4l_sys::{
    V4L2_CAP_STREAMING, V4L2_CAP_VIDEO_CAPTURE, v4l2_colorspace_V4L2_COLORSPACE_DEFAULT, v4l2_colorspace_V4L2_COLORSPACE_JPEG,
    v4l2_field_V4L2_FIELD_ALTERNATE, v4l2_field_V4L2_FIELD_BOTTOM, v4l2_field_V4L2_FIELD_NONE, v4l2_field_V4L2_FIELD_TOP,
    v4l2_pix_format, v4l2_quantization_V4L2_QUANTIZATION_FULL_RANGE as FULL_RANGE,
    v4l2_quantization_V4L2_QUANTIZATION_LIM_RANGE as LIMITED_RANGE,
};

use super::super::{DeviceError, StreamFormat};
use super::enumerate::{MAX_ENTRIES, intervals, sizes};
use super::mode::{Mode, USUAL_FPS, Wish, interval};
use super::node::{Direction, Node, wish};
use super::role::{ONLY_STAGES, Role};
use crate::image::{Colour, PixelFormat, Range, Siting};

/// What a camera offers of formats that gimbald reads, with the candidates that `wish` makes worth considering.
pub(super) fn modes(node: &Node, wish: &Wish) -> Vec<Mode> {
    let mut modes = Vec::new();
    let codes = (0..MAX_ENTRIES).map_while(|index| node.pixel_format(Direction::Capture, index));
    for (fourcc, _) in codes {
        let Some(pixel) = PixelFormat::from_fourcc(fourcc) else { continue };
        if wish.format.is_some_and(|format| format != pixel) {
            continue;
        }
        let listed = sizes(node, fourcc);
        let mut candidates: Vec<(u32, u32)> = listed.iter().flat_map(|size| size.candidates(wish)).collect();
        if listed.is_empty() {
            // A driver that does not list sizes: the wished one, else the one that is set now.
            let now = node.format(Direction::Capture).map(|pix| (pix.width, pix.height)).unwrap_or((640, 480));
            candidates.push((wish.width.unwrap_or(now.0), wish.height.unwrap_or(now.1)));
        }
        for (width, height) in candidates {
            let given = intervals(node, fourcc, width, height);
            let fps = wish.fps.unwrap_or(USUAL_FPS);
            if given.is_empty() {
                modes.push(Mode { pixel, fourcc, width, height, interval: (0, 0) });
            }
            modes.extend(given.iter().map(|given| Mode { pixel, fourcc, width, height, interval: given.nearest(fps) }));
        }
    }
    modes
}

/// Whether the node is a camera that can be streamed from.
pub(super) fn check_camera(node: &Node) -> Result<(), DeviceError> {
    let identity = node.identity().map_err(|errno| node.error("query the capabilities of", errno))?;
    let streams = [V4L2_CAP_VIDEO_CAPTURE, V4L2_CAP_STREAMING].iter().all(|caps| identity.caps & caps != 0);
    let what = match Role::of(node, &identity) {
        Role::Camera => return Ok(()),
        Role::Loopback if streams => return Ok(()),
        Role::Loopback => {
            "a loopback device that no program writes to; start the program that is to write to it, or choose a camera"
                .to_string()
        }
        Role::Planes => format!("{}: only delivers frames in multi-planar buffers, which gimbald cannot read", identity.card),
        Role::Stage => format!("{} ({}): not a camera{ONLY_STAGES}", identity.card, identity.driver),
        Role::Other => {
            format!("{}: not a camera (a metadata or output node?); `gimbald devices` lists the cameras", identity.card)
        }
    };
    Err(DeviceError::Unsupported { path: node.path().to_path_buf(), what })
}

/// Sets format and rate and compares what the driver makes of it.
pub(super) fn set_mode(node: &Node, mode: &Mode, asked: &Wish) -> Result<StreamFormat, DeviceError> {
    let pix = node
        .set_format(Direction::Capture, wish(mode.fourcc, mode.width, mode.height))
        .map_err(|errno| node.error("set the format of", errno))?;
    let fourcc = pix.pixelformat.to_le_bytes();
    let refuse = |what: String| Err(DeviceError::Unsupported { path: node.path().to_path_buf(), what });
    let Some(pixel) = PixelFormat::from_fourcc(fourcc).filter(|pixel| *pixel == mode.pixel) else {
        let code = String::from_utf8_lossy(&fourcc).into_owned();
        return refuse(format!(
            "returned {code} when {} was requested, although it offers it; choose another format",
            mode.pixel
        ));
    };
    let size = |width: u32, height: u32| format!("{width}x{height}");
    if pix.width == 0 || pix.height == 0 {
        return refuse(format!(
            "returned {} when {} was requested",
            size(pix.width, pix.height),
            size(mode.width, mode.height)
        ));
    }
    let other = |given: u32, asked: Option<u32>| asked.is_some_and(|asked| given != asked);
    if other(pix.width, asked.width) || other(pix.height, asked.height) {
        let (asked, given) = (size(mode.width, mode.height), size(pix.width, pix.height));
        tracing::warn!(camera = %node.path().display(), asked, given, "the camera chose another size");
    }
    if [v4l2_field_V4L2_FIELD_TOP, v4l2_field_V4L2_FIELD_BOTTOM, v4l2_field_V4L2_FIELD_ALTERNATE].contains(&pix.field) {
        return refuse("delivers fields instead of frames, which gimbald cannot read; choose another input or size".into());
    }
    if pix.field != v4l2_field_V4L2_FIELD_NONE {
        tracing::warn!(camera = %node.path().display(), "the camera's picture is interlaced; some shake will remain");
    }
    let wanted = match (mode.interval, asked.fps) {
        ((0, _), Some(fps)) => interval(fps),
        ((0, _), None) => (1, 30),
        (known, _) => known,
    };
    // Drivers that have no say in the rate refuse this; then it is what it is.
    let interval = node.set_interval(Direction::Capture, wanted).ok().flatten().unwrap_or(wanted);
    let format = StreamFormat {
        width: pix.width,
        height: pix.height,
        pixel,
        stride: if pixel.is_compressed() { 0 } else { (pix.bytesperline as usize).max(pixel.tight_stride(pix.width)) },
        interval,
        aspect: (1, 1),
        colour: colour(&pix, pixel),
    };
    if let Some(fps) = asked.fps
        && (format.rate() / fps - 1.0).abs() > 0.02
    {
        tracing::warn!(camera = %node.path().display(), asked = fps, given = format.rate(), "the camera chose another rate");
    }
    Ok(format)
}

/// What the driver says of the samples' meaning.
fn colour(pix: &v4l2_pix_format, pixel: PixelFormat) -> Colour {
    let range = match pix.quantization {
        FULL_RANGE => Range::Full,
        LIMITED_RANGE => Range::Limited,
        // V4L2's own rule for "default": full for JPEG's colours, else what is usual for the format.
        _ if pix.colorspace == v4l2_colorspace_V4L2_COLORSPACE_JPEG => Range::Full,
        _ if pix.colorspace == v4l2_colorspace_V4L2_COLORSPACE_DEFAULT => Range::Unknown,
        _ => Range::Unknown.of(pixel),
    };
    Colour { range, siting: Siting::default() }
}

/// Why no mode answers to what is asked.
pub(super) fn unsupported(path: &Path, asked: &Wish, node: &Node) -> DeviceError {
    let all = modes(node, &Wish::default());
    let what = if all.is_empty() {
        let codes: Vec<_> =
            (0..64).map_while(|index| node.pixel_format(Direction::Capture, index)).map(|(_, name)| name).collect();
        format!("offers no format that gimbald can read, only: {}", codes.join(", "))
    } else {
        let any = |n: Option<u32>| n.map_or("any".into(), |n| n.to_string());
        let format = asked.format.map_or("any format".into(), |format| format.to_string());
        let mut offers: Vec<_> = all.iter().map(|mode| format!("{} {}x{}", mode.pixel, mode.width, mode.height)).collect();
        offers.dedup();
        let more = if offers.len() > 24 { ", ..." } else { "" };
        offers.truncate(24);
        format!(
            "cannot give {format} at {}x{}; it offers {}{more} (all: `gimbald devices`)",
            any(asked.width),
            any(asked.height),
            offers.join(", ")
        )
    };
    DeviceError::Unsupported { path: path.to_path_buf(), what }
}
