//! Everything that can be configured, section by section, in the stages' own types.

use std::path::Path;

use crate::pipeline;
use crate::source;
use mien_sensors::turned::TURNS;
use mien_stages::base::defaults;
use mien_stages::base::settings::keyed;
use mien_stages::turn::Turn;

/// Default path of the status file.
pub(crate) const STATUS_PATH: &str = "/run/mien/status.json";

defaults! {
    /// Everything that can be configured, in the stages' own types.
    #[derive(Clone, Debug, PartialEq)]
    pub struct Settings {
        /// Where frames come from.
        pub sensor: SensorSettings = SensorSettings::default(),
        /// The stages.
        pub stages: pipeline::Settings = pipeline::Settings::default(),
        /// The outputs.
        pub outputs: mien_outputs::table::Settings = mien_outputs::table::Settings::default(),
        /// State kept across restarts.
        pub state: StateSettings = StateSettings::default(),
        /// Path of the status file; empty for none.
        pub status_path: String = STATUS_PATH.into(),
        /// Whether the status file contains learned ranges.
        pub status_ranges: bool = false,
        /// Lowest severity logged.
        pub log_level: tracing::Level = tracing::Level::INFO,
    }
}

keyed! {
    /// Where frames come from.
    pub struct SensorSettings {
        /// Where frames come from; the option --source takes precedence. auto is a Kinect, else a depth camera, else a webcam, else the simulated sensor; kinect, depth-camera and camera wait for one.
        source: String = source::AUTO.into() => Text(
            "\"auto\", \"kinect\", \"kinect:SERIAL\", \"depth-camera\" or \"camera\", alone or with \":/dev/videoN\" or \":NAME\", \"simulated\", \"simulated:SCENE\", the path of a recording or .y4m film, or \"-\" for such a film at standard input",
            |source| !source.is_empty()
        ),
        /// Face model file; the option --model takes precedence.
        model: String = String::new() => Text("a path, or empty for the built-in model", |_| true),
        /// Degrees by which the sensor is turned clockwise, as seen by the person in front of it: at 90 a Kinect's foot points to their left. auto asks its accelerometer; without one it counts as upright.
        turned: Option<Turn> = None => choice(TURNS),
        ..device: source::SensorSettings,
    }
    /// State kept across restarts.
    pub struct StateSettings {
        /// Whether the ranges and head shape of people who left are saved for users.remember_s, so that a restart forgets nobody.
        persist: bool = true => Bool(),
        /// The file; rewritten once a minute and on exit.
        path: String = "/var/lib/mien/people.ranges".into() =>
            Text("the path of a file in an existing directory", |path| !path.is_empty()),
    }
}

impl SensorSettings {
    /// Path of the face model's file; `None` for the built-in one.
    pub(crate) fn model(&self) -> Option<&Path> {
        Some(Path::new(&self.model)).filter(|path| !path.as_os_str().is_empty())
    }
}

impl Settings {
    /// The gesture being read or printed: the last one.
    ///
    /// # Panics
    /// If there is none.
    pub(super) fn gesture(&mut self) -> &mut mien_outputs::gesture::Gesture {
        let last = self.outputs.gestures.last_mut();
        last.expect("keys of gestures are asked for only while there is one")
    }
}
