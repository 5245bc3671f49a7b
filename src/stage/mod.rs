//! The algorithms, one per module, without files, threads or clocks. The order in which a frame meets them is in
//! [`crate::pipeline`], their purpose in [the plan](crate).

pub mod crop;
pub mod detect;
pub(crate) mod gains;
pub mod paper;
pub(crate) mod presence;
pub mod pyramid;
pub(crate) mod repeat;
pub mod shutter;
pub mod smooth;
pub(crate) mod timing;
pub mod track;
pub(crate) mod trust;
pub mod unpack;
pub mod warp;
