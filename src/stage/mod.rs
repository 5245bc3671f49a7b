//! The algorithms, one per module, without files, threads or clocks. The order in which a frame meets them is in
//! [`crate::pipeline`], their purpose in [the plan](crate).

pub mod crop;
pub mod detect;
pub mod gains;
pub mod paper;
pub mod presence;
pub mod pyramid;
pub mod repeat;
pub mod shutter;
pub mod smooth;
pub mod timing;
pub mod track;
pub mod trust;
pub mod unpack;
pub mod warp;
