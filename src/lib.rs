//! A software gimbal for Linux webcams.

pub mod command;
pub mod companion;
pub mod config;
pub mod control;
pub mod daemon;
pub mod device;
pub mod frame;
pub mod geometry;
pub mod image;
pub mod kernel;
pub mod log;
pub mod pipeline;
pub mod pipewire;
pub mod report;
pub mod rt;
pub mod share;
pub mod stage;
pub mod systemd;
