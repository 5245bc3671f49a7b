//! Arguments and exit codes.

use std::process::ExitCode;

use clap::{Parser, Subcommand};
use gimbald::command::{Exit, Failure, replay};

/// A software gimbal for webcams: takes shake and rolling-shutter distortion out of a camera's picture, live or recorded
#[derive(Debug, Parser)]
#[command(version, after_help = Exit::help())]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Stabilize a recorded stream
    Replay(replay::Args),
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
        Command::Replay(args) => replay::run(args),
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
