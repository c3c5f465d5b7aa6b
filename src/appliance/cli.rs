//! The command line of the appliance: parses arguments into a [`Command`].

use std::ffi::OsString;
use std::path::PathBuf;

use lexopt::prelude::*;
use tracing::Level;

use mien_stages::base::nearest_word::hint;

/// Text of `mien help`.
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

--source S        auto (default), kinect, kinect:SERIAL, depth-camera or camera, alone or with :/dev/videoN or :NAME,
                  simulated, simulated:SCENE, the path of a recording or of a .y4m film, or - for such a film at standard input
SCENE             demo (default), acted, still, turning, empty, leaving, wide, fast, hand, two, four, crossing, swap, behind,
                  furnished, mixed, moods
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
    Bench(Run),
    /// `send-test`, with the file if one was named.
    SendTest(Option<PathBuf>),
    /// `help`, of one command if it is named.
    Help(Option<&'static str>),
    /// `--version`
    Version,
}

/// Arguments of `run`; `bench` uses `config`, `source` and `frames`.
#[derive(Debug, Default, PartialEq)]
pub struct Run {
    /// Configuration file.
    pub config: Option<PathBuf>,
    /// Source of frames, in place of the configuration's.
    pub source: Option<String>,
    /// Stop after this many frames.
    pub frames: Option<u64>,
    /// Where the CSV goes: a file, or `-` for standard output.
    pub csv: Option<PathBuf>,
    /// As fast as possible instead of in real time.
    pub fast: bool,
    /// Face model, in place of the configuration's.
    pub model: Option<PathBuf>,
    /// Fail if there is no sensor.
    pub require_device: bool,
    /// Log warnings and errors only, without a live line on a terminal.
    pub quiet: bool,
    /// Log debug messages too.
    pub verbose: bool,
}

impl Run {
    /// The log level, given the configured `level`.
    pub fn level(&self, level: Level) -> Level {
        match (self.quiet, self.verbose) {
            (true, _) => level.min(Level::WARN),
            (_, true) => level.max(Level::DEBUG),
            _ => level,
        }
    }
}

/// Invalid arguments on the command line.
#[derive(Debug, thiserror::Error)]
#[error("{0}; see mien help")]
pub struct UsageError(#[from] lexopt::Error);

/// Text of `mien help`, or its part about one command.
pub fn help(command: Option<&str>) -> String {
    let Some(command) = command else {
        return HELP.to_owned();
    };
    let usage = usage(command);
    let about = |line: &&str| match line.split([' ', ',']).next() {
        Some("SCENE") => usage.contains("--source"),
        Some("Without") => usage.contains("FILE]"),
        Some("Example:") => line.contains(&format!("mien {command} ")),
        Some("Exit") => true,
        Some(word) => word.starts_with('-') && usage.contains(word),
        None => false,
    };
    let (mut lines, mut kept) = (usage.clone() + "\n", false);
    for line in HELP.lines().filter(|line| !line.is_empty()) {
        // An indented line continues the one above.
        if !line.starts_with(' ') {
            kept = about(&line);
        }
        if kept {
            lines += &format!("{line}\n");
        }
    }
    lines
}

/// The usage lines of a command in [`HELP`].
fn usage(command: &str) -> String {
    let mut in_usage = false;
    let lines = HELP.lines().filter(|line| {
        let mut words = line.split(' ');
        match words.next() {
            Some("mien") => in_usage = words.next() == Some(command),
            Some("") => {}
            _ => in_usage = false,
        }
        in_usage
    });
    lines.map(|line| format!("{line}\n")).collect()
}

/// Names of the commands.
fn commands() -> impl Iterator<Item = &'static str> {
    let lines = HELP.lines().filter_map(|line| line.strip_prefix("mien "));
    let words = lines.filter_map(|line| line.split(' ').next());
    words.filter(|word| *word != "-")
}

/// The error for an unexpected argument, with the nearest option of the command as a hint.
fn unexpected(found: &lexopt::Arg<'_>, command: &str) -> UsageError {
    let (word, what) = match found {
        Long(name) => (format!("--{name}"), "option"),
        Short(letter) => (format!("-{letter}"), "option"),
        Value(value) => (format!("{value:?}"), "word"),
    };
    let usage = usage(command);
    let options = usage.split(['[', ']', ' ', '|']);
    let hint = hint(&word, options.filter(|option| option.starts_with("--")));
    let known = format!("unexpected {what} {word}{hint}");
    lexopt::Error::Custom(known.into()).into()
}

/// Parses the arguments after the program's name. Without any, the command is `help`.
///
/// # Errors
/// On an unknown command or option, or a value that is missing or malformed.
pub fn parse(words: impl IntoIterator<Item = OsString>) -> Result<Command, UsageError> {
    let words: Vec<OsString> = words.into_iter().collect();
    let asks = words.iter().any(|word| word == "--help" || word == "-h");
    let mut parser = lexopt::Parser::from_args(words);
    let command = match parser.next()? {
        None | Some(Long("help") | Short('h')) => return Ok(Command::Help(None)),
        Some(Long("version") | Short('V')) => return Ok(Command::Version),
        Some(Value(word)) => word.string()?,
        Some(other) => return Err(unexpected(&other, "help")),
    };
    let Some(name) = commands().find(|name| *name == command) else {
        let unknown = format!("unknown command {command:?}{}", hint(&command, commands()));
        return Err(lexopt::Error::Custom(unknown.into()).into());
    };
    if asks {
        return Ok(Command::Help(Some(name)));
    }
    let command = match name {
        "run" => Command::Run(run(&mut parser, name)?),
        "bench" => Command::Bench(run(&mut parser, name)?),
        "help" => Command::Help(None),
        "devices" => Command::Devices,
        "check-config" => Command::CheckConfig(file(&mut parser, name)?),
        "print-config" => Command::PrintConfig(file(&mut parser, name)?),
        "doctor" => Command::Doctor(file(&mut parser, name)?),
        _ => Command::SendTest(file(&mut parser, name)?),
    };
    match parser.next()? {
        Some(extra) => Err(unexpected(&extra, name)),
        None => Ok(command),
    }
}

/// Parses the configuration's path: `--config FILE`, or only the file for `check-config`.
fn file(parser: &mut lexopt::Parser, command: &str) -> Result<Option<PathBuf>, UsageError> {
    Ok(match parser.next()? {
        Some(Long("config")) if command != "check-config" => Some(parser.value()?.into()),
        Some(Value(path)) if command == "check-config" => Some(path.into()),
        Some(other) => return Err(unexpected(&other, command)),
        None => None,
    })
}

/// Parses the arguments of `run` or `bench`.
fn run(parser: &mut lexopt::Parser, command: &str) -> Result<Run, UsageError> {
    let mut run = Run::default();
    while let Some(word) = parser.next()? {
        match word {
            Long("config") => run.config = Some(parser.value()?.into()),
            Long("source") => run.source = Some(parser.value()?.string()?),
            Long("frames") => run.frames = Some(parser.value()?.parse()?),
            other if command == "bench" => return Err(unexpected(&other, command)),
            Long("csv") => run.csv = Some(parser.value()?.into()),
            Long("fast") => run.fast = true,
            Long("model") => run.model = Some(parser.value()?.into()),
            Long("require-device") => run.require_device = true,
            Long("quiet") | Short('q') => run.quiet = true,
            Long("verbose") | Short('v') => run.verbose = true,
            other => return Err(unexpected(&other, command)),
        }
    }
    Ok(run)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn words(line: &str) -> Result<Command, UsageError> {
        parse(line.split_ascii_whitespace().map(OsString::from))
    }

    #[test]
    fn the_documented_arguments_are_parsed() {
        let Ok(Command::Run(run)) =
            words("run --source simulated:still --csv - --frames 30 --fast")
        else {
            panic!("run")
        };
        assert_eq!(run.source.as_deref(), Some("simulated:still"));
        assert_eq!(run.csv, Some("-".into()));
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
        let bench = Run {
            config: Some("a.toml".into()),
            source: Some("session".into()),
            frames: Some(60),
            ..Run::default()
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
        assert_eq!(words("").unwrap(), Command::Help(None));
        assert_eq!(words("run --help").unwrap(), Command::Help(Some("run")));
    }

    #[test]
    fn help_of_a_command_is_about_that_command() {
        assert_eq!(help(None), HELP);
        let run = help(Some("run"));
        assert!(run.starts_with("mien run            [--config FILE]"));
        assert!(
            run.contains("[-q|-v]\n\n--source S") && run.contains("furnished, mixed, moods\n--csv")
        );
        assert!(!run.contains("doctor") && run.contains("\nWithout --config:"));
        let devices = help(Some("devices"));
        assert!(
            !devices.contains("--") && devices.lines().count() == 3,
            "{devices}"
        );
        for (scene, _) in mien_simulator::virtual_head::Scene::NAMES {
            assert!(HELP.contains(scene), "{scene}");
        }
    }

    #[test]
    fn quiet_and_verbose_bound_the_log_s_level() {
        let Ok(Command::Run(run)) = words("run -q") else {
            panic!("run")
        };
        assert_eq!(run.level(Level::INFO), Level::WARN);
        assert_eq!(run.level(Level::ERROR), Level::ERROR);
        let Ok(Command::Run(run)) = words("run --verbose") else {
            panic!("run")
        };
        assert_eq!(run.level(Level::INFO), Level::DEBUG);
        assert_eq!(Run::default().level(Level::INFO), Level::INFO);
    }

    #[test]
    fn errors_name_the_wrong_argument() {
        for (line, part) in [
            ("fly", "unknown command \"fly\""),
            ("rnu", "unknown command \"rnu\" (did you mean run?)"),
            ("run --sorce x", "--sorce (did you mean --source?)"),
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
