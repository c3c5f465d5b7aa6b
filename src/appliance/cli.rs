//! The command line of the appliance: parses arguments into a [`Command`].

use std::ffi::OsString;
use std::path::PathBuf;

use lexopt::prelude::*;

/// What `mien help` prints.
pub const HELP: &str = "\
mien - facial expression from a Kinect v1 as FACS weights

mien run            [--config FILE] [--source S] [--csv FILE|-] [--frames N] [--fast] [--model FILE] [--require-device]
                    [-q|-v]
mien check-config   [FILE]           exit 0, or 2 with file:line:column, what was expected, what was found
mien print-config   [--config FILE]  the effective configuration
mien devices                         connected sensors and serial ports
mien doctor         [--config FILE]  one line per check: OK, WARN or FAIL, and the remedy
mien bench          [--config FILE] [--source S] [--frames N]  time per stage and memory, excluding the source's own cost
mien send-test      [--config FILE]  sweeps every unit 0-1-0 on every output and logs its name
mien help | --help | --version

--source S        kinect, kinect:SERIAL, simulated, simulated:SCENE, or the path of a recording
--csv FILE|-      one row per frame and user
--frames N        stop after N frames
--fast            play a recording or simulation as fast as possible instead of in real time
--model FILE      use this face model instead of the built-in one
-q, --quiet       log warnings and errors only, and show no live line on a terminal
-v, --verbose     log debug messages too
--require-device  exit 3 if there is no sensor, instead of using the simulated one

Without --config: /etc/mien/mien.toml if it exists, else the built-in defaults.
Exit codes: 0 success, 1 run-time failure, 2 configuration error, 3 no sensor, 64 usage error.
Example: mien run --source simulated --csv - --frames 300
";

/// One invocation.
#[derive(Debug, PartialEq)]
pub enum Command {
    /// `run`
    Run(Run),
    /// `check-config`, with the file if one was named.
    CheckConfig(Option<PathBuf>),
    /// `print-config`, with the file if one was named.
    PrintConfig(Option<PathBuf>),
    /// `devices`
    Devices,
    /// `doctor`, with the file if one was named.
    Doctor(Option<PathBuf>),
    /// `bench`
    Bench(Bench),
    /// `send-test`, with the file if one was named.
    SendTest(Option<PathBuf>),
    /// `help`
    Help,
    /// `--version`
    Version,
}

/// Arguments of `run`.
#[derive(Debug, Default, PartialEq)]
pub struct Run {
    /// Configuration file.
    pub config: Option<PathBuf>,
    /// Source of frames, in place of the configuration's.
    pub source: Option<String>,
    /// Where the CSV goes.
    pub csv: Option<CsvTarget>,
    /// Stop after this many frames.
    pub frames: Option<u64>,
    /// As fast as possible instead of in real time.
    pub fast: bool,
    /// Face model, in place of the configuration's.
    pub model: Option<PathBuf>,
    /// Fail if there is no sensor.
    pub require_device: bool,
    /// Verbosity.
    pub talk: Talk,
}

/// Verbosity of a run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Talk {
    /// Warnings and errors.
    Less,
    /// As configured, and a live line on a terminal.
    #[default]
    AsConfigured,
    /// Debug messages too.
    More,
}

impl Talk {
    /// The log level, given the configured `level`.
    #[must_use]
    pub fn level(self, level: tracing::Level) -> tracing::Level {
        match self {
            Self::Less => level.min(tracing::Level::WARN),
            Self::AsConfigured => level,
            Self::More => level.max(tracing::Level::DEBUG),
        }
    }
}

/// Arguments of `bench`.
#[derive(Debug, Default, PartialEq)]
pub struct Bench {
    /// Configuration file.
    pub config: Option<PathBuf>,
    /// Source of frames; else the simulated sensor.
    pub source: Option<String>,
    /// Frames measured.
    pub frames: Option<u64>,
}

/// Where a CSV goes.
#[derive(Debug, PartialEq)]
pub enum CsvTarget {
    /// `-`
    StandardOutput,
    /// A file.
    File(PathBuf),
}

/// Invalid arguments on the command line.
#[derive(Debug, thiserror::Error)]
#[error("{0}; see mien help")]
pub struct UsageError(#[from] lexopt::Error);

/// Parses the arguments after the program's name. Without any, the command is `help`.
///
/// # Errors
/// On an unknown command or option, or a value that is missing or malformed.
pub fn parse(words: impl IntoIterator<Item = OsString>) -> Result<Command, UsageError> {
    let mut parser = lexopt::Parser::from_args(words);
    let Some(first) = parser.next()? else {
        return Ok(Command::Help);
    };
    let command = match first {
        Long("help") | Short('h') => return Ok(Command::Help),
        Long("version") | Short('V') => return Ok(Command::Version),
        Value(word) => word.string()?,
        other => return Err(other.unexpected().into()),
    };
    let command = match command.as_str() {
        "help" => Command::Help,
        "devices" => match parser.next()? {
            Some(Long("help")) => return Ok(Command::Help),
            Some(other) => return Err(other.unexpected().into()),
            None => Command::Devices,
        },
        "bench" => {
            let mut bench = Bench::default();
            while let Some(word) = parser.next()? {
                match word {
                    Long("config") => bench.config = Some(parser.value()?.into()),
                    Long("source") => bench.source = Some(parser.value()?.string()?),
                    Long("frames") => bench.frames = Some(parser.value()?.parse()?),
                    Long("help") => return Ok(Command::Help),
                    other => return Err(other.unexpected().into()),
                }
            }
            Command::Bench(bench)
        }
        "run" => run(&mut parser)?,
        "check-config" => match parser.next()? {
            Some(Value(path)) => Command::CheckConfig(Some(path.into())),
            Some(Long("help")) => return Ok(Command::Help),
            Some(other) => return Err(other.unexpected().into()),
            None => Command::CheckConfig(None),
        },
        "print-config" | "doctor" | "send-test" => {
            let config = match parser.next()? {
                Some(Long("config")) => Some(parser.value()?.into()),
                Some(Long("help")) => return Ok(Command::Help),
                Some(other) => return Err(other.unexpected().into()),
                None => None,
            };
            match command.as_str() {
                "doctor" => Command::Doctor(config),
                "send-test" => Command::SendTest(config),
                _ => Command::PrintConfig(config),
            }
        }
        _ => {
            return Err(
                lexopt::Error::Custom(format!("unknown command {command:?}").into()).into(),
            );
        }
    };
    match parser.next()? {
        Some(extra) => Err(extra.unexpected().into()),
        None => Ok(command),
    }
}

fn run(parser: &mut lexopt::Parser) -> Result<Command, UsageError> {
    let mut run = Run::default();
    while let Some(word) = parser.next()? {
        match word {
            Long("config") => run.config = Some(parser.value()?.into()),
            Long("source") => run.source = Some(parser.value()?.string()?),
            Long("csv") => {
                let target = parser.value()?;
                run.csv = Some(if target == "-" {
                    CsvTarget::StandardOutput
                } else {
                    CsvTarget::File(target.into())
                });
            }
            Long("frames") => run.frames = Some(parser.value()?.parse()?),
            Long("fast") => run.fast = true,
            Long("model") => run.model = Some(parser.value()?.into()),
            Long("require-device") => run.require_device = true,
            Long("quiet") | Short('q') => run.talk = Talk::Less,
            Long("verbose") | Short('v') => run.talk = Talk::More,
            Long("help") => return Ok(Command::Help),
            other => return Err(other.unexpected().into()),
        }
    }
    Ok(Command::Run(run))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn words(line: &str) -> Result<Command, UsageError> {
        parse(line.split_ascii_whitespace().map(OsString::from))
    }

    #[test]
    fn the_contract_s_words_are_understood() {
        let Ok(Command::Run(run)) =
            words("run --source simulated:still --csv - --frames 30 --fast")
        else {
            panic!("run")
        };
        assert_eq!(run.source.as_deref(), Some("simulated:still"));
        assert_eq!(run.csv, Some(CsvTarget::StandardOutput));
        assert_eq!(
            (run.frames, run.fast, run.require_device),
            (Some(30), true, false)
        );
        assert_eq!(
            words("check-config a.toml").unwrap(),
            Command::CheckConfig(Some("a.toml".into()))
        );
        assert_eq!(words("print-config").unwrap(), Command::PrintConfig(None));
        assert_eq!(words("devices").unwrap(), Command::Devices);
        assert_eq!(words("doctor").unwrap(), Command::Doctor(None));
        let bench = Bench {
            config: Some("a.toml".into()),
            source: Some("session".into()),
            frames: Some(60),
        };
        assert_eq!(
            words("bench --config a.toml --source session --frames 60").unwrap(),
            Command::Bench(bench)
        );
        assert_eq!(
            words("send-test --config a.toml").unwrap(),
            Command::SendTest(Some("a.toml".into()))
        );
        assert_eq!(words("--version").unwrap(), Command::Version);
        assert_eq!(words("").unwrap(), Command::Help);
    }

    #[test]
    fn quiet_and_verbose_bound_the_log_s_level() {
        let Ok(Command::Run(run)) = words("run -q") else {
            panic!("run")
        };
        use tracing::Level;
        assert_eq!(run.talk, Talk::Less);
        assert_eq!(run.talk.level(Level::INFO), Level::WARN);
        assert_eq!(run.talk.level(Level::ERROR), Level::ERROR);
        let Ok(Command::Run(run)) = words("run --verbose") else {
            panic!("run")
        };
        assert_eq!(run.talk.level(Level::INFO), Level::DEBUG);
        assert_eq!(Talk::default().level(Level::INFO), Level::INFO);
    }

    #[test]
    fn wrong_words_say_what_was_wrong() {
        for (line, part) in [
            ("fly", "unknown command \"fly\""),
            ("run --frames many", "many"),
            ("run --frames", "--frames"),
            ("run --wings", "--wings"),
            ("check-config a b", "\"b\""),
        ] {
            let message = words(line).unwrap_err().to_string();
            assert!(
                message.contains(part) && message.ends_with("; see mien help"),
                "{line}: {message}"
            );
        }
    }
}
