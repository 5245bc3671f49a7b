//! The command line: all commands and their arguments.

use clap::{Parser, Subcommand};

use super::{
    Exit, bench, calibrate, check, client, demo, devices, doctor, measure, pipewire, record, replay, report, run, view,
};

/// Software gimbal for webcams: removes camera shake and rolling-shutter distortion, live or from recordings
#[derive(Debug, Parser)]
#[command(name = "gimbald", version, after_help = Exit::help())]
pub struct Arguments {
    /// The command.
    #[command(subcommand)]
    pub command: Command,
}

/// The commands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Run the service: stabilize a camera into a virtual camera until stopped
    Run(run::Args),
    /// Run the companion in a user's session that offers the service's picture as a PipeWire camera
    Pipewire(pipewire::Args),
    /// Show service status: devices, frame rate, latency, dropped frames, estimated camera parameters
    Status(client::StatusArgs),
    /// Enable stabilization
    On(client::Args),
    /// Disable stabilization: show the camera's picture, only cropped
    Off(client::Args),
    /// Change a setting of the running service, until the next reload or restart
    Set(client::SetArgs),
    /// Reload the service's configuration file
    Reload(client::Args),
    /// Open a page in the browser that shows the live picture, or a recording, and lets you adjust settings
    View(view::Args),
    /// Write the last minute of the running service to a page, to attach to a bug report; nothing personal unless you ask for it
    Report(report::Args),
    /// Diagnose problems and suggest fixes
    Doctor(doctor::Args),
    /// Stabilize a recording or a y4m file
    Replay(replay::Args),
    /// Record a camera's raw frames to a file
    Record(record::Args),
    /// Estimate a camera's readout time, field of view and lens distortion, from a recording or while you move the camera
    Calibrate(calibrate::Args),
    /// Benchmark this machine: processing time per frame, and the frame rates that it can sustain
    Bench(bench::Args),
    /// Generate a shaky clip, stabilize it, and write a report
    Demo(demo::Args),
    /// Measure the shake of recorded clips, e.g. before and after stabilization
    Measure(measure::Args),
    /// List cameras and loopback devices that gimbald can use
    Devices(devices::Args),
    /// Check a configuration file or a recording
    Check(check::Args),
}
