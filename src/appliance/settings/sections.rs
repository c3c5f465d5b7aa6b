//! Everything that can be configured, section by section, in the stages' own types.

use std::path::Path;

use crate::appliance::source;
use crate::base::defaults;
use crate::output::features::{
    ArtNetSettings, LightSettings, LiveLinkSettings, MqttSettings, PageSettings, SacnSettings,
    WebSocketSettings,
};
use crate::{expression, landmarks, output, pipeline, pose, segment, users};

/// Everything that can be configured, in the stages' own types.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Settings {
    /// Where frames come from.
    pub sensor: SensorSettings,
    /// Head segmentation.
    pub segment: segment::Settings,
    /// Head pose.
    pub pose: pose::Settings,
    /// Landmarks.
    pub landmarks: landmarks::StageSettings,
    /// Learning of ranges.
    pub learning: expression::Settings,
    /// Which people are tracked, and what happens when a face is lost.
    pub users: users::Settings,
    /// Names and gains of units, for every output.
    pub units: Vec<output::UnitView>,
    /// OSC over UDP.
    pub osc: output::osc::Settings,
    /// OSC for avatar programs, VMC protocol.
    pub vmc: output::osc::vmc::Settings,
    /// OSC for VRChat.
    pub vrchat: output::osc::vrchat::Settings,
    /// OSC as FaceOSC sends it.
    pub faceosc: output::osc::faceosc::Settings,
    /// The serial line.
    pub serial: output::serial::Settings,
    /// Gestures, and the device that presses their keys.
    pub gestures: Vec<output::gesture::Gesture>,
    /// The device.
    pub keys: KeySettings,
    /// Settings of the optional outputs.
    pub network: NetworkSettings,
    /// State kept across restarts.
    pub state: StateSettings,
    /// Status files.
    pub status: StatusSettings,
    /// Logging.
    pub log: LogSettings,
}

defaults! {
    /// Where frames come from.
    #[derive(Clone, Debug, PartialEq)]
    pub struct SensorSettings {
        /// As [`source::SourceName`] reads it.
        pub source: String = source::DEFAULT.into(),
        /// Path of a face model; empty = the built-in one.
        pub model: String = String::new(),
        /// What can be chosen about a sensor on USB.
        pub device: source::SensorSettings = source::SensorSettings::default(),
    }

    /// Settings of the outputs that are optional build features; every build reads all of them.
    #[derive(Clone, Debug, PartialEq)]
    pub struct NetworkSettings {
        /// Name of the box; empty = the host name.
        pub name: String = String::new(),
        /// The table of channels.
        pub lights: LightSettings = LightSettings::default(),
        /// Art-Net.
        pub artnet: ArtNetSettings = ArtNetSettings::default(),
        /// sACN.
        pub sacn: SacnSettings = SacnSettings::default(),
        /// Unreal's Live Link.
        pub live_link: LiveLinkSettings = LiveLinkSettings::default(),
        /// JSON for pages.
        pub websocket: WebSocketSettings = WebSocketSettings::default(),
        /// The page of the box.
        pub page: PageSettings = PageSettings::default(),
        /// MQTT.
        pub mqtt: MqttSettings = MqttSettings::default(),
    }

    /// The device that presses keys.
    #[derive(Clone, Debug, PartialEq)]
    pub struct KeySettings {
        /// Path of `uinput` or of a USB HID gadget.
        pub device: String = "/dev/uinput".into(),
    }

    /// State kept across restarts.
    #[derive(Clone, Debug, PartialEq)]
    pub struct StateSettings {
        /// Whether people who left are saved; only from a live sensor.
        pub persist: bool = true,
        /// Path of the file.
        pub path: String = "/var/lib/mien/people.ranges".into(),
    }

    /// Status files.
    #[derive(Clone, Debug, PartialEq)]
    pub struct StatusSettings {
        /// Path of the status file; empty = none.
        pub path: String = "/run/mien/status.json".into(),
    }

    /// Logging.
    #[derive(Clone, Debug, PartialEq)]
    pub struct LogSettings {
        /// Least severity written to standard error.
        pub level: tracing::Level = tracing::Level::INFO,
    }
}

impl SensorSettings {
    /// The face model's file, if it is not the built-in one.
    pub(in crate::appliance) fn model(&self) -> Option<&Path> {
        Some(Path::new(&self.model)).filter(|path| !path.as_os_str().is_empty())
    }
}

impl Settings {
    /// The gesture that is being read or printed.
    pub(super) fn gesture(&mut self) -> &mut output::gesture::Gesture {
        let last = self.gestures.last_mut();
        last.expect("keys of gestures are asked for only while there is one")
    }

    /// Every output reads the names and gains of its units in its own view.
    pub(super) fn hand_on_units(&mut self) {
        let network = &mut self.network;
        for view in [
            &mut self.osc.view,
            &mut self.vmc.view,
            &mut self.vrchat.view,
            &mut self.serial.view,
            &mut network.lights.view,
            &mut network.live_link.view,
            &mut network.websocket.view,
            &mut network.mqtt.view,
            &mut network.page.view,
        ] {
            view.units.clone_from(&self.units);
        }
    }

    /// Names of the gestures, in their order.
    #[must_use]
    pub fn gesture_names(&self) -> Vec<&str> {
        let names = self.gestures.iter().map(|gesture| gesture.name.as_str());
        names.collect()
    }

    /// The part used by the stages.
    #[must_use]
    pub fn stages(&self) -> pipeline::Settings {
        pipeline::Settings {
            segment: self.segment,
            pose: self.pose,
            landmarks: self.landmarks,
            learning: self.learning.clone(),
            users: self.users.clone(),
        }
    }
}
