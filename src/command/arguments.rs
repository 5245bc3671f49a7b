//! The command line: which commands there are, and what each takes.

use clap::{Parser, Subcommand};

use super::{Exit, bench, calibrate, check, demo, doctor, pipewire, record, replay, run, talk};

/// A software gimbal for webcams: takes shake and rolling-shutter distortion out of a camera's picture, live or recorded
#[derive(Debug, Parser)]
#[command(name = "gimbald", version, after_help = Exit::help())]
pub struct Arguments {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

/// What there is to do.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Stabilize a camera's picture into a loopback device, until told to stop: the service
    Run(run::Args),
    /// Offer the service's picture as a PipeWire camera: the companion in a user's session
    Pipewire(pipewire::Args),
    /// Say how the service does: devices, rate, latency, losses, what it found out
    Status(talk::StatusArgs),
    /// Have the service take the shake out again
    On(talk::Args),
    /// Have the service show the camera's picture as it is
    Off(talk::Args),
    /// Change a setting of the service until it reads its configuration again
    Set(talk::SetArgs),
    /// Have the service read its configuration again
    Reload(talk::Args),
    /// Find what keeps gimbald from working, or from working well, and say what mends it
    Doctor(doctor::Args),
    /// Stabilize a recorded stream
    Replay(replay::Args),
    /// Record a camera's frames as they come
    Record(record::Args),
    /// Find out a camera's readout time and field of view from a recorded stream, or from the camera while it is moved about
    Calibrate(calibrate::Args),
    /// Measure what a frame costs on this machine, and which frame rates it can hold
    Bench(bench::Args),
    /// Show what it does: makes a shaky clip, stabilizes it, and says where to look
    Demo(demo::Args),
    /// List cameras and loopback devices
    Devices,
    /// Check a configuration file, or read a recorded stream through
    Check(check::Args),
}
