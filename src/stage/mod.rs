//! The science: one algorithm a file, in the order of a frame's journey. Each has its `Params`, its state and one verb.

pub mod crop;
pub mod detect;
pub mod fit;
pub mod presence;
pub mod pyramid;
pub mod shutter;
pub mod smooth;
pub mod timing;
pub mod track;
pub mod trust;
pub mod unpack;
pub mod warp;
