//! Start-up common to the commands that process frames: configuration, model, source, and their errors.

use std::io::{self, ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

use crate::pipeline::{Pipeline, PipelineError};
use crate::settings::{Refused, Settings, SettingsError};
use crate::source::{self, SourceError};
use mien_outputs::OutputError;
use mien_outputs::table;
use mien_stages::base::bounded_read::{self, reason};
use mien_stages::face_model::FaceModel;

/// Default path of the configuration.
pub(super) const SYSTEM_CONFIG: &str = "/etc/mien/mien.toml";
/// Delay of the exit after a failed start under a service manager; shorter than systemd's start timeout.
const BACK_OFF: Duration = Duration::from_secs(15);
/// Largest face model file, bytes: a hundred times the built-in model.
const MAX_MODEL_BYTES: usize = 1 << 28;

/// Why a command failed.
#[derive(Debug, thiserror::Error)]
pub enum Failure {
    /// Invalid configuration file.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// Invalid model file: path and problem.
    #[error("{}: {}", .0.display(), .1)]
    Model(PathBuf, String),
    /// No usable source of frames.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// The stages cannot be built.
    #[error(transparent)]
    Pipeline(#[from] PipelineError),
    /// An output failed.
    #[error(transparent)]
    Output(#[from] OutputError),
    /// Standard output cannot be written.
    #[error("cannot write to standard output: {0}; is there free space?")]
    Print(io::Error),
    /// Signals cannot be watched.
    #[error("cannot watch for signals: {0}; is the system out of memory?")]
    Signals(io::Error),
}

impl Failure {
    /// Exit code, as `mien help` lists them.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Settings(_) => 2,
            Self::Source(SourceError::Missing(_)) => 3,
            _ => 1,
        }
    }

    /// Whether the reader of standard output or the CSV closed it, as `| head` does; this is not a failure.
    pub fn is_reader_gone(&self) -> bool {
        matches!(self, Self::Print(error) | Self::Output(OutputError::Csv(error)) if error.kind() == ErrorKind::BrokenPipe)
    }

    /// Delays the exit under a service manager if the run failed soon after its start, as the restart will probably fail too:
    /// systemd before 254 has no increasing restart delay. `ran`: duration of the run.
    pub fn back_off(&self, ran: Duration) {
        if ran < BACK_OFF && std::env::var_os("NOTIFY_SOCKET").is_some() {
            std::thread::sleep(BACK_OFF);
        }
    }
}

/// Prints a command's result.
///
/// # Errors
/// If standard output cannot be written.
pub fn print(text: &str) -> Result<(), Failure> {
    let mut out = io::stdout().lock();
    let written = out.write_all(text.as_bytes()).and_then(|()| out.flush());
    written.map_err(Failure::Print)
}

/// The configuration in force: the named file, else the system's, else the built-in defaults.
///
/// # Errors
/// If the file cannot be read or is invalid.
pub fn settings(file: Option<&Path>) -> Result<Settings, Failure> {
    let system = Path::new(SYSTEM_CONFIG);
    Ok(match file {
        Some(path) => Settings::read(path, refused)?,
        None if system.exists() => Settings::read(system, refused)?,
        None => Settings::default(),
    })
}

/// As [`settings`], without the checks of [`refused`]; the defaults if the file is invalid.
pub(super) fn settings_unchecked(file: Option<&Path>) -> Settings {
    let path = file.unwrap_or(Path::new(SYSTEM_CONFIG));
    Settings::read(path, |_| None).unwrap_or_default()
}

/// The first setting that a run would refuse, found with the same constructors. Files that this user may not read are accepted:
/// the service's user may.
fn refused(settings: &Settings) -> Option<Refused> {
    if let Err(problem) = source::check(&settings.sensor.source) {
        return Some(("sensor", "source", problem.to_string()));
    }
    // The built-in model is always complete.
    if let Some(path) = settings.sensor.model() {
        let check = |model| Ok(Pipeline::check(&settings.stages, &model)?);
        if let Err(problem) = model(Some(path)).and_then(check) {
            return Some(("sensor", "model", problem.to_string()));
        }
    }
    let units = Pipeline::unit_names_with(&settings.stages);
    let units: Vec<&str> = units.iter().map(String::as_str).collect();
    if let Err((section, problem)) = table::check(&settings.outputs, &units) {
        let forbidden = match &problem {
            OutputError::Password(_, error) | OutputError::Certificates(_, error) => {
                error.kind() == ErrorKind::PermissionDenied
            }
            _ => false,
        };
        if !forbidden {
            return Some((section, problem.key(), problem.to_string()));
        }
    }
    let listen = &settings.outputs.page.listen;
    (table::share_a_port(&settings.outputs)).then_some(())?;
    let problem = "expected page.listen on another port than websocket.listen";
    Some(("page", "listen", format!("{problem}, found {listen}")))
}

/// The face model in a file, or the built-in one.
///
/// # Errors
/// If the file cannot be read or is invalid.
pub fn model(file: Option<&Path>) -> Result<FaceModel, Failure> {
    let Some(path) = file else {
        return Ok(FaceModel::shipped());
    };
    let wrong = |problem| Failure::Model(path.into(), problem);
    let bytes = bounded_read::read(path, MAX_MODEL_BYTES).map_err(|problem| {
        let advice = "give a model written by `mien-studio train`";
        wrong(format!("cannot be read ({}); {advice}", reason(problem)))
    })?;
    FaceModel::read(&bytes).map_err(|problem| wrong(problem.to_string()))
}
