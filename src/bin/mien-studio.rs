//! The workstation: training, pictures, recordings, baking.

use std::process::ExitCode;

use mien::studio::cli::{self, Fault};

#[expect(clippy::print_stderr, reason = "this is the door")]
fn main() -> ExitCode {
    mien::log::start(tracing::Level::INFO);
    match cli::run(std::env::args_os().skip(1)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(Fault::Usage(text)) => {
            eprintln!("mien-studio: {text}; see mien-studio help");
            ExitCode::from(64)
        }
        Err(Fault::Failed { text, code }) => {
            eprintln!("mien-studio: {text}");
            ExitCode::from(code)
        }
    }
}
