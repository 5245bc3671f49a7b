//! Arguments and exit codes.

use std::process::ExitCode;

use clap::Parser;
use gimbald::command::{Arguments, Command, Exit, Failure};
use gimbald::command::{
    bench, calibrate, check, client, demo, devices, doctor, measure, pipewire, record, replay, report, run, view,
};
use gimbald::kernel;

fn main() -> ExitCode {
    let arguments = match Arguments::try_parse() {
        Ok(arguments) => arguments,
        Err(error) => {
            // Help and version are no errors, and go to standard output. Where the terminal is gone there is no place for an error either.
            let _ = error.print();
            return if error.use_stderr() { Exit::Usage.into() } else { Exit::Ok.into() };
        }
    };
    let ended =
        kernel::Level::check_cap().map_err(|what| Failure::new(Exit::Usage, what)).and_then(|()| match &arguments.command {
            Command::Run(args) => run::run(args),
            Command::Pipewire(args) => pipewire::run(args),
            Command::Status(args) => client::status(args),
            Command::On(args) => client::switch(args, true),
            Command::Off(args) => client::switch(args, false),
            Command::Set(args) => client::set(args),
            Command::Reload(args) => client::reload(args),
            Command::View(args) => view::run(args),
            Command::Report(args) => report::run(args),
            Command::Replay(args) => replay::run(args),
            Command::Record(args) => record::run(args),
            Command::Calibrate(args) => calibrate::run(args),
            Command::Bench(args) => bench::run(args),
            Command::Demo(args) => demo::run(args),
            Command::Measure(args) => measure::run(args),
            Command::Devices(args) => devices::run(args),
            Command::Doctor(args) => doctor::run(args),
            Command::Check(args) => check::run(args),
        });
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
