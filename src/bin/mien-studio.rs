//! The program `mien-studio`: training, images, recordings, baking.

use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use mien_studio::cli;
use mien_workbench::fault::{Fault, USAGE};
use mien_workbench::streams;
use signal_hook::consts::SIGPIPE;

fn main() -> ExitCode {
    mien_appliance::log::start(tracing::Level::INFO);
    // A closed standard output (`| head -1`) ends the program silently, with the shell's exit code for SIGPIPE.
    let always = Arc::new(AtomicBool::new(true));
    let _ = signal_hook::flag::register_conditional_shutdown(SIGPIPE, 128 + SIGPIPE, always);
    let done = cli::run(std::env::args_os().skip(1));
    let printed = streams::failure().map_or(Ok(()), |error| {
        Err(Fault::new(format!(
            "cannot write to standard output: {error}; is there free space?"
        )))
    });
    match done.and(printed) {
        Ok(()) => ExitCode::SUCCESS,
        Err(fault) => {
            let help = if fault.code == USAGE {
                "; see mien-studio help"
            } else {
                ""
            };
            streams::print_error(format_args!("mien-studio: {fault}{help}"));
            ExitCode::from(fault.code)
        }
    }
}
