//! The workstation: training, pictures, recordings, baking.

use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use mien::studio::cli;
use mien::studio::fault::USAGE;
use signal_hook::consts::SIGPIPE;

#[expect(clippy::print_stderr, reason = "this is the door")]
fn main() -> ExitCode {
    mien::appliance::log::start(tracing::Level::INFO);
    // A reader of standard output that goes away (`| head -1`) ends the program quietly, with the code shells give for it.
    let always = Arc::new(AtomicBool::new(true));
    let _ = signal_hook::flag::register_conditional_shutdown(SIGPIPE, 128 + SIGPIPE, always);
    match cli::run(std::env::args_os().skip(1)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(fault) => {
            let help = if fault.code == USAGE {
                "; see mien-studio help"
            } else {
                ""
            };
            eprintln!("mien-studio: {fault}{help}");
            ExitCode::from(fault.code)
        }
    }
}
