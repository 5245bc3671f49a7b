//! Pictures to measure with: two neighbours of the synthetic camera's clip.

use gimbald::device::synthetic::{self, Synthetic};
use gimbald::device::{FrameSource, Lent};
use gimbald::frame::Frame;
use gimbald::kernel::Level;
use gimbald::stage::pyramid;
use gimbald::stage::unpack::Unpack;

/// Two frames, one after the other, with their pyramids.
pub fn neighbours([width, height]: [u32; 2]) -> [Frame; 2] {
    let params = synthetic::Params { width, height, frames: 12, ..synthetic::Params::default() };
    let mut camera = Synthetic::new(&params).expect("the settings are valid");
    let mut unpack = Unpack::new();
    let mut frames: Vec<Frame> = Vec::new();
    while let Ok(Lent::Frame(raw)) = camera.lend() {
        let mut frame = Frame::default();
        let format = raw.format;
        unpack
            .unpack(
                format.pixel,
                format.colour.range,
                (format.width, format.height),
                format.stride,
                raw.bytes,
                &mut frame.picture,
            )
            .expect("the camera's frames are whole");
        pyramid::build(Level::detected(), frame.picture.luma(), &mut frame.pyramid);
        frame.intact = true;
        frame.stamp = raw.stamp;
        frames.push(frame);
    }
    let now = frames.pop().expect("there are twelve frames");
    let before = frames.pop().expect("there are twelve frames");
    [before, now]
}
