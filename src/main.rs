//! The program `mien`: sensor to weights.

use std::process::ExitCode;

use mien_appliance::cli::{self, Command};
use mien_appliance::memory::Counting;
use mien_appliance::{run, send_test, service};
use mien_outputs::table;
use mien_stages::face_model::FaceModel;

#[global_allocator]
static MEMORY: Counting = Counting::new();

fn version() -> String {
    let optional = [
        (" studio", cfg!(feature = "studio")),
        (" wires", cfg!(feature = "wires")),
    ];
    let enabled = optional.iter().filter(|(_, is_built)| *is_built);
    let features: String = enabled.map(|(name, _)| *name).collect();
    let (version, model) = (env!("CARGO_PKG_VERSION"), FaceModel::shipped().id);
    format!("mien {version} (features std{features}, model {model:08x})")
}

fn main() -> ExitCode {
    let started = std::time::Instant::now();
    let command = match cli::parse(std::env::args_os().skip(1)) {
        Ok(command) => command,
        Err(error) => {
            mien_appliance::log::say(format_args!("mien: {error}"));
            return ExitCode::from(64);
        }
    };
    let done = match command {
        Command::Help(topic) => service::print(&cli::help(topic)),
        Command::Version => service::print(&(version() + "\n")),
        Command::CheckConfig(file) => service::settings(file.as_deref()).map(drop),
        Command::PrintConfig(file) => service::settings(file.as_deref()).and_then(|settings| {
            service::print(&settings.to_toml())?;
            let without = table::not_built();
            if !without.is_empty() {
                // On standard error: the printed configuration may be used with another build.
                mien_appliance::log::say(format_args!(
                    "mien: built without {}; build with --features wires, or install the package",
                    without.join(", ")
                ));
            }
            Ok(())
        }),
        Command::Devices => service::print(&mien_appliance::devices::report()),
        Command::Doctor(file) => {
            let (lines, code) = mien_appliance::doctor::report(file.as_deref());
            match service::print(&lines) {
                Ok(()) => return ExitCode::from(code),
                failed => failed,
            }
        }
        Command::Bench(bench) => {
            mien_appliance::bench::run(&bench, || MEMORY.requests(), &mut std::io::stdout().lock())
        }
        Command::SendTest(file) => send_test::send_test(file.as_deref()),
        Command::Run(run) => run::run(&run),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) if failure.is_reader_gone() => ExitCode::SUCCESS,
        Err(failure) => {
            mien_appliance::log::say(format_args!("mien: {failure}"));
            failure.back_off(started.elapsed());
            ExitCode::from(failure.exit_code())
        }
    }
}
