//! Everything that can be configured, section by section, in the stages' own types.

use std::path::Path;

use crate::pipeline;
use crate::source;
use mien_outputs::features::{LiveLinkSettings, MqttSettings, PageSettings, WebSocketSettings};
use mien_stages::base::defaults;
use mien_stages::base::settings::keyed;

/// Where the status file is unless another place is named.
pub(crate) const STATUS_PATH: &str = "/run/mien/status.json";

defaults! {
    /// Everything that can be configured, in the stages' own types.
    #[derive(Clone, Debug, PartialEq)]
    pub struct Settings {
        /// Where frames come from.
        pub sensor: SensorSettings = SensorSettings::default(),
        /// The stages.
        pub stages: pipeline::Settings = pipeline::Settings::default(),
        /// Names and gains of units, for every output.
        pub units: Vec<mien_outputs::UnitView> = Vec::new(),
        /// OSC over UDP.
        pub osc: mien_outputs::osc::Settings = mien_outputs::osc::Settings::default(),
        /// OSC for avatar programs, VMC protocol.
        pub vmc: mien_outputs::osc::vmc::Settings = mien_outputs::osc::vmc::Settings::default(),
        /// OSC for VRChat.
        pub vrchat: mien_outputs::osc::vrchat::Settings = mien_outputs::osc::vrchat::Settings::default(),
        /// OSC as FaceOSC sends it.
        pub faceosc: mien_outputs::osc::faceosc::Settings = mien_outputs::osc::faceosc::Settings::default(),
        /// The serial line.
        pub serial: mien_outputs::serial::Settings = mien_outputs::serial::Settings::default(),
        /// Gestures, and the device that presses their keys.
        pub gestures: Vec<mien_outputs::gesture::Gesture> = Vec::new(),
        /// Path of `uinput` or of a USB HID gadget, which presses keys.
        pub keys_device: String = "/dev/uinput".into(),
        /// Name of the box; empty = the host name.
        pub name: String = String::new(),
        /// Unreal's Live Link.
        pub live_link: LiveLinkSettings = LiveLinkSettings::default(),
        /// JSON for pages.
        pub websocket: WebSocketSettings = WebSocketSettings::default(),
        /// The page of the box.
        pub page: PageSettings = PageSettings::default(),
        /// MQTT.
        pub mqtt: MqttSettings = MqttSettings::default(),
        /// State kept across restarts.
        pub state: StateSettings = StateSettings::default(),
        /// Path of the status file; empty = none.
        pub status_path: String = STATUS_PATH.into(),
        /// Whether it has learned ranges.
        pub status_ranges: bool = false,
        /// Least severity written to standard error.
        pub log_level: tracing::Level = tracing::Level::INFO,
    }
}

keyed! {
    /// Where frames come from.
    pub struct SensorSettings {
        /// Where frames come from; the option --source takes precedence. auto is a Kinect, or the simulated sensor if none is plugged in; kinect waits for one.
        source: String = source::AUTO.into() => Text(
            "\"auto\", \"kinect\", \"kinect:SERIAL\", \"simulated\", \"simulated:SCENE\" or the path of a recording",
            |source| !source.is_empty()
        ),
        /// Face model file; the option --model takes precedence.
        model: String = String::new() => Text("a path, or empty for the built-in model", |_| true),
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
    /// The face model's file, if it is not the built-in one.
    pub(crate) fn model(&self) -> Option<&Path> {
        Some(Path::new(&self.model)).filter(|path| !path.as_os_str().is_empty())
    }
}

impl Settings {
    /// The gesture that is being read or printed.
    pub(super) fn gesture(&mut self) -> &mut mien_outputs::gesture::Gesture {
        let last = self.gestures.last_mut();
        last.expect("keys of gestures are asked for only while there is one")
    }

    /// Every output reads the names and gains of its units in its own view.
    pub(super) fn hand_on_units(&mut self) {
        for view in [
            &mut self.osc.view,
            &mut self.vmc.view,
            &mut self.vrchat.view,
            &mut self.serial.view,
            &mut self.live_link.view,
            &mut self.websocket.view,
            &mut self.mqtt.view,
        ] {
            view.units.clone_from(&self.units);
        }
    }

    /// Names of the gestures, in their order.
    pub fn gesture_names(&self) -> Vec<&str> {
        let names = self.gestures.iter().map(|gesture| gesture.name.as_str());
        names.collect()
    }
}
