//! Opening of frame sources by name, and real-time pacing of simulated and recorded frames.

use std::path::Path;
use std::time::{Duration, Instant};

use mien_sensors::RecordingError;
pub use mien_sensors::kinect::geometry::nominal;
use mien_sensors::kinect::recording::Recording;
use mien_sensors::rgbd::Rgbd;
pub use mien_sensors::sensor::Settings as SensorSettings;
use mien_sensors::sensor::{Sensor, SensorKind};
use mien_sensors::table::SENSORS;
use mien_sensors::y4m::Y4m;
use mien_simulator::simulated::{Simulated, UnknownScene};
use mien_stages::base::nearest_word::hint;
use mien_stages::base::time::Timestamp;

/// Default source: the first kind of sensor that is connected, else the simulated sensor.
pub const AUTO: &str = "auto";
/// Name of the simulated sensor.
pub const SIMULATED: &str = "simulated";
/// Name of a film at standard input.
pub const STANDARD_INPUT: &str = "-";

/// Splits a source's name at the first colon into kind and detail (serial number, node, or scene). Any kind but `auto`, `kinect`,
/// `depth-camera`, `camera`, `simulated` and `-` is a path; `./kinect` is the directory of that name.
///
/// ```
/// use mien_appliance::source::parts;
/// assert_eq!(parts("kinect"), ("kinect", None));
/// assert_eq!(parts("simulated:two"), ("simulated", Some("two")));
/// assert_eq!(parts("/tmp/session"), ("/tmp/session", None));
/// ```
pub fn parts(name: &str) -> (&str, Option<&str>) {
    let (kind, detail) = name.split_once(':').unwrap_or((name, ""));
    (kind, Some(detail).filter(|detail| !detail.is_empty()))
}

/// Why a source cannot be opened or has no more frames.
#[derive(Debug, thiserror::Error)]
pub enum SourceError {
    /// The recording cannot be opened.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// Neither a sensor nor a recording: the name, and a hint to the nearest one.
    #[error(
        "expected auto, kinect, kinect:SERIAL, depth-camera or camera, alone or with :/dev/videoN or :NAME, simulated, simulated:SCENE, the path of a recording or .y4m film, or - for a film at standard input, found {0}{1}"
    )]
    Unknown(String, String),
    /// None of this number of frames of a recording could be used.
    #[error("none of the {0} frames of this recording can be used; see the warnings above")]
    Nothing(usize),
    /// No such scene.
    #[error(transparent)]
    Scene(#[from] UnknownScene),
    /// A sensor was required, and none can be opened: the reasons.
    #[error("{0}")]
    Missing(String),
}

/// A source of frames.
pub type Source = Box<dyn Sensor>;

/// The simulated sensor, by the name of a scene.
///
/// # Errors
/// If there is no such scene.
pub fn simulated(scene: Option<&str>) -> Result<Source, SourceError> {
    Ok(Box::new(Simulated::new(scene)?))
}

/// The recording in a directory, or the film in a `.y4m` file.
///
/// # Errors
/// If it cannot be opened.
pub fn recording(path: &Path) -> Result<Source, SourceError> {
    let name = path.to_string_lossy();
    let names = SENSORS.iter().map(|kind| kind.name);
    let hint = hint(&name, names.chain([SIMULATED, AUTO]));
    if !hint.is_empty() && !path.exists() {
        return Err(SourceError::Unknown(name.into_owned(), hint));
    }
    if is_film(path) {
        return Ok(Box::new(Y4m::open(path)?));
    }
    if Rgbd::is_recording(path) {
        return Ok(Box::new(Rgbd::open(path)?));
    }
    Ok(Box::new(Recording::open(path)?))
}

/// Whether a path is that of a film.
pub fn is_film(path: &Path) -> bool {
    path.extension().is_some_and(|kind| kind == "y4m") && !path.is_dir()
}

/// The kinds of sensors that a name stands for, and the serial number in it; [`AUTO`] is all of them, the preferred one first.
pub(crate) fn kinds(name: &str) -> (&'static [SensorKind], Option<&str>) {
    match parts(name) {
        (AUTO, None) => (SENSORS, None),
        (kind, serial) => {
            let at = SENSORS.iter().position(|known| known.name == kind);
            (at.map_or(&[], |at| &SENSORS[at..=at]), serial)
        }
    }
}

/// Whether a source of this name is no recording that has a first and a last frame.
pub fn is_live(name: &str) -> bool {
    let others = [SIMULATED, STANDARD_INPUT];
    !kinds(name).0.is_empty() || others.contains(&parts(name).0)
}

/// Checks whether a source of this name can be opened, without accessing a sensor.
///
/// # Errors
/// As [`open`].
pub fn check(name: &str) -> Result<(), SourceError> {
    match parts(name) {
        _ if !kinds(name).0.is_empty() => Ok(()),
        (SIMULATED, scene) => Ok(Simulated::scene(scene).map(drop)?),
        // What is read from a pipe is gone for the run.
        (STANDARD_INPUT, None) => Ok(()),
        _ => recording(Path::new(name)).map(drop),
    }
}

/// Opens a source by name; `settings` are for what can be plugged in. Returns it with its name, [`AUTO`] resolved. Without a connected sensor,
/// `required` fails, [`AUTO`] opens the simulated sensor, and a sensor's name waits for one.
///
/// # Errors
/// If the source does not exist or cannot be opened.
pub fn open<'n>(
    name: &'n str,
    required: bool,
    settings: &SensorSettings,
) -> Result<(Source, &'n str), SourceError> {
    let (kinds, serial) = kinds(name);
    let Some(preferred) = kinds.first() else {
        return match parts(name) {
            (SIMULATED, scene) => Ok((simulated(scene)?, name)),
            (STANDARD_INPUT, None) => Ok((Box::new(Y4m::standard_input()?), name)),
            _ => Ok((recording(Path::new(name))?, name)),
        };
    };
    let mut problems = String::new();
    for kind in kinds {
        let (sensor, problem) = (kind.open)(serial, settings);
        let title = kind.title;
        match problem {
            None if problems.is_empty() => {}
            None => {
                let waits = format_args!(
                    "--source {} waits for a {}",
                    preferred.name, preferred.title
                );
                tracing::warn!("{problems}; using the {title} until mien is restarted ({waits})");
            }
            Some(problem) if required || name == AUTO => {
                let separator = if problems.is_empty() { "" } else { "; " };
                problems += &format!("{separator}{problem}");
                continue;
            }
            Some(problem) => tracing::warn!("waiting for the {title}: {problem}"),
        }
        return Ok((sensor, if name == AUTO { kind.name } else { name }));
    }
    if required {
        return Err(SourceError::Missing(problems));
    }
    tracing::warn!("{problems}; using the simulated sensor until mien is restarted");
    Ok((simulated(None)?, SIMULATED))
}

/// Delays frames to real time, for sources that deliver them as fast as possible.
#[derive(Debug, Default)]
pub struct Pacer {
    /// Wall-clock time of frame time 0.
    start: Option<Instant>,
}

impl Pacer {
    /// Longest wait for a frame; longer gaps are shortened to it, so that signals are handled in time.
    const MAX_WAIT: Duration = Duration::from_millis(500);

    /// Waits until the frame with timestamp `at` is due. Late frames do not wait; a delay of more than half a second is not
    /// caught up.
    pub fn wait(&mut self, at: Timestamp) {
        let (now, offset) = (Instant::now(), Duration::from_micros(at.as_us()));
        let begun = || now.checked_sub(offset);
        let start = self.start.or_else(begun).unwrap_or(now);
        let due = start + offset;
        let ahead = due.saturating_duration_since(now);
        let late = now.saturating_duration_since(due);
        if ahead > Self::MAX_WAIT || late > Self::MAX_WAIT {
            // Restart the clock at this frame.
            self.start = (now + ahead.min(Self::MAX_WAIT)).checked_sub(offset);
        } else {
            self.start = Some(start);
        }
        std::thread::sleep(ahead.min(Self::MAX_WAIT));
    }
}
