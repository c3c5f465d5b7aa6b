//! The sources by name, behind one interface, and the pace at which simulated or recorded frames are delivered.

use std::path::Path;
use std::time::{Duration, Instant};

use mien_sensors::RecordingError;
use mien_sensors::kinect::device::{DeviceError, Stream};
pub use mien_sensors::kinect::driver::{KinectError as SensorError, Settings as SensorSettings};
use mien_sensors::kinect::frame::Developed;
pub use mien_sensors::kinect::geometry::nominal;
use mien_sensors::kinect::live::LiveKinect;
use mien_sensors::kinect::recording::Recording;
use mien_sensors::kinect::registration::Registration;
use mien_sensors::rgbd::Rgbd;
use mien_simulator::simulated::{Simulated, UnknownScene};
use mien_stages::base::nearest_word::hint;
use mien_stages::base::time::Timestamp;
use mien_stages::camera::Camera;

/// The source unless another is named: a Kinect if one is plugged in, else the simulated sensor.
pub const AUTO: &str = "auto";

/// The kind of sensor that a source's name begins with, and what follows its colon; everything but `auto`, `kinect` and
/// `simulated` is a path, and `./kinect` is the directory of that name.
///
/// ```
/// use mien::appliance::source::parts;
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
        "expected auto, kinect, kinect:SERIAL, simulated, simulated:SCENE or the path of a recording, found {0}{1}"
    )]
    Unknown(String, String),
    /// Of so many frames of a recording not one could be used.
    #[error("none of the {0} frames of this recording can be used; see the warnings above")]
    Nothing(usize),
    /// No such scene.
    #[error(transparent)]
    Scene(#[from] UnknownScene),
    /// No sensor that can be opened, and one was required.
    #[error(transparent)]
    Missing(SensorError),
    /// The Kinect has delivered nothing for half a second; retry.
    #[error("waiting for the Kinect: {0}")]
    Waiting(SensorError),
}

/// Where frames come from.
pub enum Source {
    /// A Kinect's recording that is played.
    Recording(Box<Recording>),
    /// A recording of any depth camera.
    Rgbd(Box<Rgbd>),
    /// The simulated sensor.
    Simulated(Box<Simulated>),
    /// A Kinect on USB, which may come and go.
    Kinect(Box<LiveKinect>),
}

impl Source {
    /// The simulated sensor, by the name of a scene.
    ///
    /// # Errors
    /// If there is no such scene.
    pub fn simulated(scene: Option<&str>) -> Result<Self, SourceError> {
        Ok(Self::Simulated(Box::new(Simulated::new(scene)?)))
    }

    /// The recording in a directory.
    ///
    /// # Errors
    /// If it cannot be opened.
    pub fn recording(directory: &Path) -> Result<Self, SourceError> {
        let name = directory.to_string_lossy();
        let hint = hint(&name, ["kinect", "simulated", AUTO]);
        if !hint.is_empty() && !directory.exists() {
            return Err(SourceError::Unknown(name.into_owned(), hint));
        }
        if Rgbd::is_in(directory) {
            return Ok(Self::Rgbd(Box::new(Rgbd::open(directory)?)));
        }
        Ok(Self::Recording(Box::new(Recording::open(directory)?)))
    }

    /// A Kinect on USB: the one with `serial`, else the first free one. Returns within seconds, when it is open or the first
    /// attempt has failed, with the reason in that case. [`Self::next_frame`] then waits for it.
    pub fn kinect(serial: Option<&str>, settings: SensorSettings) -> (Self, Option<SensorError>) {
        let mut live = LiveKinect::usb(serial.map(str::to_owned), settings);
        let status = live.wait_for_first_attempt(Duration::from_secs(10));
        let problem = (status.openings == 0)
            .then(|| status.waiting_for.unwrap_or(DeviceError::TimedOut.into()));
        (Self::Kinect(Box::new(live)), problem)
    }

    /// Fills `frame` with the next one; `false` if there are no more.
    ///
    /// # Errors
    /// [`SourceError::Waiting`] if a Kinect delivers nothing for half a second: retry. Other errors are permanent. Damaged frames
    /// are skipped and counted instead.
    pub fn next_frame(&mut self, into: &mut impl Developed) -> Result<bool, SourceError> {
        match self {
            Self::Recording(recording) => Ok(recording.next_frame(into)),
            Self::Rgbd(recording) => {
                let (frame, original) = into.parts();
                let more = recording.next_frame(frame);
                if let Some(original) = original {
                    original.show(frame);
                }
                Ok(more)
            }
            Self::Simulated(simulated) => {
                simulated.next_frame(into);
                Ok(true)
            }
            Self::Kinect(live) => {
                if live.next_frame(into, Pacer::LONGEST) {
                    return Ok(true);
                }
                let problem = live.status().waiting_for;
                Err(SourceError::Waiting(
                    problem.unwrap_or_else(|| DeviceError::Gone.into()),
                ))
            }
        }
    }

    /// When the last frame was complete in this machine's memory; `None` for simulated or recorded frames.
    pub fn arrived(&self) -> Option<Instant> {
        match self {
            Self::Kinect(live) => live.arrived,
            _ => None,
        }
    }

    /// Calibration of the Kinect behind the frames, if it is one.
    pub fn registration(&self) -> Option<&Registration> {
        match self {
            Self::Recording(recording) => Some(&recording.registration),
            Self::Rgbd(_) => None,
            Self::Simulated(simulated) => Some(simulated.registration()),
            Self::Kinect(live) => Some(&live.registration),
        }
    }

    /// Geometry of the sensor behind the frames.
    pub fn camera(&self) -> &Camera {
        match self {
            Self::Recording(recording) => &recording.camera,
            Self::Rgbd(recording) => &recording.camera,
            Self::Simulated(simulated) => simulated.camera(),
            Self::Kinect(live) => &live.camera,
        }
    }

    /// Pixels of the files to one of the frames, along each side: of depth, and of pictures.
    pub fn reduced(&self) -> [usize; 2] {
        match self {
            Self::Rgbd(recording) => recording.reduced(),
            _ => [1; 2],
        }
    }

    /// What [`AUTO`] has become.
    pub fn kind(&self) -> &'static str {
        if self.is_live() {
            "kinect"
        } else {
            "simulated"
        }
    }

    /// Whether a sensor is there that gives frames in its own time.
    pub fn is_live(&self) -> bool {
        matches!(self, Self::Kinect(_))
    }

    /// Tells the sensor whether a face is tracked, if it can show it.
    pub fn show_tracking(&self, tracking: bool) {
        if let Self::Kinect(live) = self {
            live.show_tracking(tracking);
        }
    }

    /// Frames that a recording names, skipped ones included; 0 if it is none.
    pub fn frames(&self) -> usize {
        match self {
            Self::Recording(recording) => recording.frames(),
            Self::Rgbd(recording) => recording.frames(),
            Self::Simulated(_) | Self::Kinect(_) => 0,
        }
    }

    /// Plays a recording on from the frame of this number.
    pub fn go_to(&mut self, number: usize) {
        match self {
            Self::Recording(recording) => recording.go_to(number),
            Self::Rgbd(recording) => recording.go_to(number),
            Self::Simulated(_) | Self::Kinect(_) => {}
        }
    }

    /// Frames skipped so far because they were damaged.
    pub fn skipped(&self) -> u64 {
        match self {
            Self::Recording(recording) => recording.skipped(),
            Self::Rgbd(recording) => recording.skipped(),
            Self::Simulated(_) => 0,
            Self::Kinect(live) => live.status().health.streams[Stream::Depth.index()].broken,
        }
    }
}

/// Whether a source of this name can be opened, as far as that can be told without a sensor.
///
/// # Errors
/// As [`open`].
pub fn check(name: &str) -> Result<(), SourceError> {
    match parts(name) {
        ("kinect", _) | (AUTO, None) => Ok(()),
        ("simulated", scene) => Ok(Simulated::scene(scene).map(drop)?),
        _ => Source::recording(Path::new(name)).map(drop),
    }
}

/// Opens a source by name; `settings` are for a sensor on USB. If none is connected, `required` fails, [`AUTO`] plays the
/// simulated sensor in its place, and whoever names a Kinect waits until one is plugged in.
///
/// # Errors
/// If the source does not exist or cannot be opened.
pub fn open(name: &str, required: bool, settings: SensorSettings) -> Result<Source, SourceError> {
    let (source, problem) = match parts(name) {
        ("kinect", serial) => Source::kinect(serial, settings),
        (AUTO, None) => Source::kinect(None, settings),
        ("simulated", scene) => return Source::simulated(scene),
        _ => return Source::recording(Path::new(name)),
    };
    match problem {
        Some(problem) if required => return Err(SourceError::Missing(problem)),
        Some(problem) if name == AUTO => {
            tracing::warn!("{problem}; using the simulated sensor until mien is restarted");
            return Source::simulated(None);
        }
        Some(problem) => tracing::warn!("waiting for the Kinect: {problem}"),
        None => {}
    }
    Ok(source)
}

/// Plays frames in real time, for sources that would otherwise deliver them as fast as possible.
#[derive(Debug, Default)]
pub struct Pacer {
    /// Wall-clock time of time 0.
    start: Option<Instant>,
}

impl Pacer {
    /// Longest wait for a frame. A longer gap in the frames is shortened to this, so that signals are answered in time.
    const LONGEST: Duration = Duration::from_millis(500);

    /// Waits until it is time for the frame taken at `at`. Late frames do not wait, and a delay beyond the longest wait is not
    /// caught up.
    pub fn wait(&mut self, at: Timestamp) {
        let (now, offset) = (Instant::now(), Duration::from_micros(at.as_us()));
        let start = self
            .start
            .or_else(|| now.checked_sub(offset))
            .unwrap_or(now);
        let due = start + offset;
        let ahead = due.saturating_duration_since(now);
        let late = now.saturating_duration_since(due);
        if ahead > Self::LONGEST || late > Self::LONGEST {
            // Start again from this frame.
            self.start = (now + ahead.min(Self::LONGEST)).checked_sub(offset);
        } else {
            self.start = Some(start);
        }
        std::thread::sleep(ahead.min(Self::LONGEST));
    }
}
