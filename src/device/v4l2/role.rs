//! The role of a video node (camera, loopback, part of a pipeline), from its capabilities.

use v4l::v4l_sys::{
    V4L2_CAP_IO_MC, V4L2_CAP_STREAMING, V4L2_CAP_VIDEO_CAPTURE, V4L2_CAP_VIDEO_CAPTURE_MPLANE, V4L2_CAP_VIDEO_M2M,
    V4L2_CAP_VIDEO_M2M_MPLANE, V4L2_CAP_VIDEO_OUTPUT,
};

use super::enumerate::LOOPBACK_DRIVER;
use super::node::{Identity, Node};

/// What to do where there are only stages: a Raspberry Pi with its own camera, many tablets and phones.
pub(super) const ONLY_STAGES: &str = "; these are stages of a CSI camera's path or codecs, and give no picture by themselves. CSI cameras \
    go through libcamera, into a loopback device of their own: `gst-launch-1.0 libcamerasrc ! videoconvert ! \
    video/x-raw,format=YUY2 ! v4l2sink device=/dev/videoN` (package gstreamer1.0-libcamera); then set camera.device=N";

/// What a node is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Role {
    /// It gives pictures, once it is told to stream.
    Camera,
    /// One stage of many: a receiver of a CSI camera, an image processor, a codec. It gives nothing by itself.
    Stage,
    /// It gives frames whose planes lie in buffers of their own.
    Planes,
    /// A loopback's node, whichever way its frames go now.
    Loopback,
    /// None of these: metadata, output, radio.
    Other,
}

impl Role {
    /// The role of an open node.
    pub(super) fn of(node: &Node, identity: &Identity) -> Self {
        Self::of_identity(identity, || node.has_input())
    }

    /// The same, `has_input` being asked only where it matters.
    fn of_identity(identity: &Identity, has_input: impl FnOnce() -> bool) -> Self {
        let has = |caps: u32| identity.caps & caps != 0;
        if identity.driver == LOOPBACK_DRIVER {
            Self::Loopback
        } else if has(V4L2_CAP_IO_MC | V4L2_CAP_VIDEO_M2M | V4L2_CAP_VIDEO_M2M_MPLANE) {
            Self::Stage
        } else if has(V4L2_CAP_VIDEO_CAPTURE) && has(V4L2_CAP_STREAMING) {
            // What captures from something has that as an input. bcm2835-isp has none: it processes what is written to another node.
            if has_input() { Self::Camera } else { Self::Stage }
        } else if has(V4L2_CAP_VIDEO_CAPTURE_MPLANE) && !has(V4L2_CAP_VIDEO_OUTPUT) {
            Self::Planes
        } else {
            Self::Other
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cameras_are_told_from_what_lies_behind_them() {
        let role = |driver: &str, caps: u32, input| {
            let identity = Identity { driver: driver.into(), card: "x".into(), bus: "y".into(), caps };
            Role::of_identity(&identity, || input)
        };
        let camera = V4L2_CAP_VIDEO_CAPTURE | V4L2_CAP_STREAMING;
        assert_eq!(role("uvcvideo", camera, true), Role::Camera);
        assert_eq!(role("uvcvideo", 0x04a0_0000, true), Role::Other, "metadata");
        assert_eq!(role("rp1-cfe", camera | V4L2_CAP_IO_MC, true), Role::Stage);
        assert_eq!(role("bcm2835-isp", camera, false), Role::Stage);
        assert_eq!(role("bcm2835-codec", V4L2_CAP_VIDEO_M2M_MPLANE | V4L2_CAP_STREAMING, false), Role::Stage);
        assert_eq!(role("rpi-hevc-dec", V4L2_CAP_VIDEO_M2M_MPLANE | V4L2_CAP_STREAMING, false), Role::Stage);
        assert_eq!(role("vim2m", V4L2_CAP_VIDEO_M2M | V4L2_CAP_STREAMING, false), Role::Stage);
        assert_eq!(role("rk_hdmirx", V4L2_CAP_VIDEO_CAPTURE_MPLANE | V4L2_CAP_STREAMING, true), Role::Planes);
        assert_eq!(role(LOOPBACK_DRIVER, V4L2_CAP_VIDEO_OUTPUT, false), Role::Loopback);
    }
}
