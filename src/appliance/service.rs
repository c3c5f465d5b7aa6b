//! Start-up common to the commands that process frames: configuration, model, source, and their errors.

use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

use crate::appliance::settings::{Settings, SettingsError};
use crate::appliance::source::SourceError;
use crate::base::bounded_read;
use crate::face_model::FaceModel;
use crate::output::OutputError;
use crate::pipeline::PipelineError;

/// Default path of the configuration.
pub(super) const SYSTEM_CONFIG: &str = "/etc/mien/mien.toml";
/// How long what has failed at its start waits under a service manager before exiting: less than the start timeout.
const BACK_OFF: Duration = Duration::from_secs(15);
/// Largest face model, bytes: a hundred times ours.
const MODEL_MOST: usize = 1 << 28;

/// Why a command failed.
#[derive(Debug, thiserror::Error)]
pub enum Failure {
    /// The configuration file.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// The model file, and what is wrong with it.
    #[error("{}: {}", .0.display(), .1)]
    Model(PathBuf, String),
    /// The source of frames.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// The stages.
    #[error(transparent)]
    Pipeline(#[from] PipelineError),
    /// An output.
    #[error(transparent)]
    Output(#[from] OutputError),
    /// Standard output.
    #[error("cannot write to standard output: {0}; is the reader of the pipe gone?")]
    Print(io::Error),
    /// Signals cannot be watched.
    #[error("cannot watch for signals: {0}; is the system out of memory?")]
    Signals(io::Error),
}

impl Failure {
    /// Exit code of the contract.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Settings(_) | Self::Output(OutputError::NotBuilt(_)) => 2,
            Self::Source(SourceError::Missing(_)) => 3,
            _ => 1,
        }
    }

    /// Delays the exit under a service manager of what failed soon after its start, as it will probably fail again until somebody
    /// intervenes: systemd before 254 has no increasing restart delay. `ran` is how long it has run.
    pub fn back_off(&self, ran: Duration) {
        if ran < BACK_OFF && std::env::var_os("NOTIFY_SOCKET").is_some() {
            std::thread::sleep(BACK_OFF);
        }
    }
}

/// The configuration in force: the named file, else the system's, else the built-in defaults.
///
/// # Errors
/// If the file cannot be read or is invalid.
pub fn settings(file: Option<&Path>) -> Result<Settings, Failure> {
    let system = Path::new(SYSTEM_CONFIG);
    Ok(match file {
        Some(path) => Settings::read(path)?,
        None if system.exists() => Settings::read(system)?,
        None => Settings::default(),
    })
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
    let bytes = bounded_read::read(path, MODEL_MOST).map_err(|problem| {
        let advice = "give the path of a model made by mien-studio train";
        wrong(format!("cannot be read ({problem}); {advice}"))
    })?;
    FaceModel::read(&bytes).map_err(|problem| wrong(problem.to_string()))
}
