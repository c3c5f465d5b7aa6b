//! Settings of the outputs that are optional build features; every build reads all of them.

use crate::output::features::{
    ArtNetSettings, DiscoverySettings, LightSettings, LiveLinkSettings, MqttSettings, PageSettings,
    SacnSettings, ServerSettings,
};

/// Settings of these outputs.
#[derive(Clone, Debug, PartialEq)]
pub struct NetworkSettings {
    /// Name of the box; empty = the host name.
    pub name: String,
    /// The table of channels.
    pub lights: LightSettings,
    /// Art-Net.
    pub artnet: ArtNetSettings,
    /// sACN.
    pub sacn: SacnSettings,
    /// Unreal's Live Link.
    pub live_link: LiveLinkSettings,
    /// JSON for pages.
    pub websocket: ServerSettings,
    /// The page of the box.
    pub page: PageSettings,
    /// OSC's addresses over HTTP.
    pub oscquery: ServerSettings,
    /// mDNS.
    pub discovery: DiscoverySettings,
    /// MQTT.
    pub mqtt: MqttSettings,
}

impl Default for NetworkSettings {
    fn default() -> Self {
        Self {
            name: String::new(),
            lights: LightSettings::default(),
            artnet: ArtNetSettings::default(),
            sacn: SacnSettings::default(),
            live_link: LiveLinkSettings::default(),
            websocket: ServerSettings::websocket(),
            page: PageSettings::default(),
            oscquery: ServerSettings::oscquery(),
            discovery: DiscoverySettings::default(),
            mqtt: MqttSettings::default(),
        }
    }
}
