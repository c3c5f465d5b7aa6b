//! The appliance: sensor to weights on a wire.

use std::process::ExitCode;

use mien::cli::{self, Command};
use mien::face_model::FaceModel;
use mien::memory::Counting;
use mien::service;
use mien::settings::Settings;

#[global_allocator]
static MEMORY: Counting = Counting::new();

#[expect(
    clippy::print_stdout,
    reason = "this is the door: it prints what was asked for"
)]
fn main() -> ExitCode {
    let command = match cli::parse(std::env::args_os().skip(1)) {
        Ok(command) => command,
        Err(error) => {
            mien::log::say(format_args!("mien: {error}"));
            return ExitCode::from(64);
        }
    };
    let done = match command {
        Command::Help => {
            print!("{}", cli::HELP);
            Ok(())
        }
        Command::Version => {
            let features = [
                ("std", true),
                ("studio", cfg!(feature = "studio")),
                ("lights", cfg!(feature = "lights")),
                ("live-link", cfg!(feature = "live-link")),
                ("web", cfg!(feature = "web")),
                ("discovery", cfg!(feature = "discovery")),
                ("mqtt", cfg!(feature = "mqtt")),
            ];
            let built = features
                .into_iter()
                .filter_map(|(name, on)| on.then_some(name));
            let features = built.collect::<Vec<_>>().join(" ");
            println!(
                "mien {} (features {features}, model {:08x})",
                env!("CARGO_PKG_VERSION"),
                FaceModel::shipped().id
            );
            Ok(())
        }
        Command::CheckConfig(file) => service::settings(file.as_deref()).map(|_| ()),
        Command::PrintConfig(file) => service::settings(file.as_deref())
            .map(|settings: Settings| print!("{}", settings.to_toml())),
        Command::Devices => {
            print!("{}", mien::devices::report());
            Ok(())
        }
        Command::Doctor(file) => {
            let (lines, sound) = mien::doctor::report(file.as_deref());
            print!("{lines}");
            return ExitCode::from(u8::from(!sound));
        }
        Command::Bench(bench) => {
            mien::bench::run(&bench, || MEMORY.requests(), &mut std::io::stdout().lock())
        }
        Command::SendTest(file) => service::send_test(file.as_deref()),
        Command::Run(run) => service::run(&run),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            mien::log::say(format_args!("mien: {failure}"));
            failure.back_off();
            ExitCode::from(failure.exit_code())
        }
    }
}
