//! The sources by name, behind one interface, and the pace at which simulated or recorded frames are delivered.

use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::time::{Duration, Instant};

use crate::base::nearest_word::hint;
use crate::base::time::Timestamp;
use crate::sensor::Frame;
use crate::sensor::camera::Registration;
use crate::sensor::device::{DeviceError, Stream};
use crate::sensor::kinect::{self, KinectError};
use crate::sensor::live_kinect::LiveKinect;
use crate::sensor::recording::{Recording, RecordingError};
use crate::simulator::simulated::{Simulated, UnknownScene};

/// What the user may name as a source.
///
/// ```
/// use mien::appliance::source::SourceName;
/// assert_eq!("kinect".parse(), Ok(SourceName::Kinect { serial: None }));
/// assert_eq!("simulated:two".parse(), Ok(SourceName::Simulated { scene: Some("two".into()) }));
/// assert_eq!("/tmp/session".parse(), Ok(SourceName::Recording("/tmp/session".into())));
/// ```
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SourceName {
    /// `kinect` or `kinect:SERIAL`.
    Kinect {
        /// The one with this serial number; else the first found.
        serial: Option<String>,
    },
    /// `simulated` or `simulated:SCENE`.
    Simulated {
        /// Name of the scene; else the standard one.
        scene: Option<String>,
    },
    /// The path of a recording's directory.
    Recording(PathBuf),
}

impl FromStr for SourceName {
    type Err = std::convert::Infallible;

    /// Everything that is not a kind of sensor is a path; `./kinect` is the directory of that name.
    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let (kind, detail) = match text.split_once(':') {
            Some((kind, detail)) => (
                kind,
                Some(detail.to_owned()).filter(|detail| !detail.is_empty()),
            ),
            None => (text, None),
        };
        Ok(match kind {
            "kinect" => Self::Kinect { serial: detail },
            "simulated" => Self::Simulated { scene: detail },
            _ => Self::Recording(text.into()),
        })
    }
}

/// Why a source cannot be opened or has no more frames.
#[derive(Debug, thiserror::Error)]
pub enum SourceError {
    /// The recording cannot be opened.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// Neither a sensor nor a recording.
    #[error(
        "expected kinect, kinect:SERIAL, simulated, simulated:SCENE or the path of a recording, found {name}{hint}"
    )]
    Unknown {
        /// What was asked for.
        name: String,
        /// What may have been meant.
        hint: String,
    },
    /// No such scene.
    #[error(transparent)]
    Scene(#[from] UnknownScene),
    /// The Kinect has delivered nothing for half a second; retry.
    #[error("waiting for the Kinect: {0}")]
    Waiting(KinectError),
}

/// Where frames come from.
pub enum Source {
    /// A recording that is played.
    Recording(Box<Recording>),
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
        let hint = hint(&name, ["kinect", "simulated"]);
        if !hint.is_empty() && !directory.exists() {
            let name = name.into_owned();
            return Err(SourceError::Unknown { name, hint });
        }
        Ok(Self::Recording(Box::new(Recording::open(directory)?)))
    }

    /// A Kinect on USB: the one with `serial`, else the first free one. Returns within seconds, when it is open or the first
    /// attempt has failed, with the reason in that case. [`Self::next_frame`] then waits for it.
    #[must_use]
    pub fn kinect(serial: Option<&str>, settings: kinect::Settings) -> (Self, Option<KinectError>) {
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
    pub fn next_frame(&mut self, frame: &mut Frame) -> Result<bool, SourceError> {
        match self {
            Self::Recording(recording) => Ok(recording.next_frame(frame)),
            Self::Simulated(simulated) => {
                simulated.next_frame(frame);
                Ok(true)
            }
            Self::Kinect(live) => {
                if live.next_frame(frame, Pacer::LONGEST) {
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
    #[must_use]
    pub fn arrived(&self) -> Option<Instant> {
        match self {
            Self::Kinect(live) => live.arrived(),
            Self::Recording(_) | Self::Simulated(_) => None,
        }
    }

    /// Calibration of the sensor behind the frames.
    #[must_use]
    pub fn registration(&self) -> &Registration {
        match self {
            Self::Recording(recording) => recording.registration(),
            Self::Simulated(simulated) => simulated.registration(),
            Self::Kinect(live) => live.registration(),
        }
    }

    /// Frames skipped so far because they were damaged.
    #[must_use]
    pub fn skipped(&self) -> u64 {
        match self {
            Self::Recording(recording) => recording.skipped(),
            Self::Simulated(_) => 0,
            Self::Kinect(live) => live.status().health.streams[Stream::Depth.index()].broken,
        }
    }
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
