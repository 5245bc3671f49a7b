//! Arguments and exit codes.

use std::process::ExitCode;

use clap::{Parser, Subcommand};
use gimbald::command::{Exit, Failure, bench, calibrate, check, demo, devices, record, replay, run};

/// A software gimbal for webcams: takes shake and rolling-shutter distortion out of a camera's picture, live or recorded
#[derive(Debug, Parser)]
#[command(version, after_help = Exit::help())]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Stabilize a camera's picture into a loopback device, until told to stop: the service
    Run(run::Args),
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

fn main() -> ExitCode {
    let arguments = match Arguments::try_parse() {
        Ok(arguments) => arguments,
        Err(error) => {
            // Help and version are no errors, and go to standard output. Nobody is left to tell that the terminal is gone.
            let _ = error.print();
            return if error.use_stderr() { Exit::Usage.into() } else { Exit::Ok.into() };
        }
    };
    let ended = match &arguments.command {
        Command::Run(args) => run::run(args),
        Command::Replay(args) => replay::run(args),
        Command::Record(args) => record::run(args),
        Command::Calibrate(args) => calibrate::run(args),
        Command::Bench(args) => bench::run(args),
        Command::Demo(args) => demo::run(args),
        Command::Devices => devices::run(),
        Command::Check(args) => check::run(args),
    };
    match ended {
        Ok(()) => Exit::Ok.into(),
        Err(Failure { exit, message }) => {
            #[expect(clippy::print_stderr, reason = "the one place where the user is told of a failure")]
            {
                eprintln!("gimbald: {message}");
            }
            exit.into()
        }
    }
}
