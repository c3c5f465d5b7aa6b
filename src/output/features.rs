//! Settings of the outputs that are optional build features: lights, Live Link, web, discovery, MQTT. Every build knows them, so
//! that all builds read the same configuration; enabling an output that is not built in is an error.

#[cfg(any(feature = "web", feature = "mqtt"))]
use super::OutputError;
use super::{LossPolicy, View};

/// Which unit goes to which channel, for Art-Net and sACN alike.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LightSettings {
    /// Rows `UNIT UNIVERSE CHANNEL [8|16] [CURVE] [MIN MAX] [hold]`.
    pub channels: Vec<String>,
    /// Names, gains and mirroring of the units.
    pub view: View,
    /// What is sent when a face is lost.
    pub loss: LossPolicy,
}

/// Art-Net.
#[derive(Clone, Debug, PartialEq)]
pub struct ArtNetSettings {
    /// Whether this output is enabled.
    pub enabled: bool,
    /// Each `host:port`.
    pub targets: Vec<String>,
}

impl Default for ArtNetSettings {
    fn default() -> Self {
        Self {
            enabled: false,
            targets: vec!["127.0.0.1:6454".to_owned()],
        }
    }
}

/// sACN (E1.31).
#[derive(Clone, Debug, PartialEq)]
pub struct SacnSettings {
    /// Whether this output is enabled.
    pub enabled: bool,
    /// Each `host:port`; none = the multicast group of each universe.
    pub targets: Vec<String>,
    /// 0 to 200; the highest of several sources wins.
    pub priority: u32,
}

impl Default for SacnSettings {
    fn default() -> Self {
        Self {
            enabled: false,
            targets: Vec::new(),
            priority: 100,
        }
    }
}

/// Unreal's Live Link, in the format of the Live Link Face app.
#[derive(Clone, Debug, PartialEq)]
pub struct LiveLinkSettings {
    /// Whether this output is enabled.
    pub enabled: bool,
    /// Each `host:port`.
    pub targets: Vec<String>,
    /// Subject name in Unreal; empty = the name of the box.
    pub subject: String,
    /// Names, gains and mirroring of the units.
    pub view: View,
    /// What is sent when a face is lost.
    pub loss: LossPolicy,
}

impl Default for LiveLinkSettings {
    fn default() -> Self {
        Self {
            enabled: false,
            targets: vec!["127.0.0.1:11111".to_owned()],
            subject: String::new(),
            view: View::default(),
            loss: LossPolicy::default(),
        }
    }
}

/// A server of web pages' data: WebSocket, or OSCQuery.
#[derive(Clone, Debug, PartialEq)]
pub struct ServerSettings {
    /// Whether anybody is served.
    pub enabled: bool,
    /// `address:port`.
    pub listen: String,
    /// Names, gains and mirroring of the units.
    pub view: View,
    /// What is sent when a face is lost.
    pub loss: LossPolicy,
}

impl ServerSettings {
    fn at(listen: &str) -> Self {
        Self {
            enabled: false,
            listen: listen.to_owned(),
            view: View::default(),
            loss: LossPolicy::default(),
        }
    }

    /// WebSocket's own.
    #[must_use]
    pub fn websocket() -> Self {
        Self::at("127.0.0.1:9133")
    }

    /// OSCQuery's own.
    #[must_use]
    pub fn oscquery() -> Self {
        Self::at("127.0.0.1:9132")
    }
}

/// The page of the box.
#[derive(Clone, Debug, PartialEq)]
pub struct PageSettings {
    /// Whether it is served.
    pub enabled: bool,
    /// `address:port`.
    pub listen: String,
    /// A file with the password; empty = none, and only local networks are served.
    pub password_file: String,
    /// How the units are shown.
    pub view: View,
}

impl Default for PageSettings {
    fn default() -> Self {
        Self {
            enabled: false,
            listen: "127.0.0.1:9134".to_owned(),
            password_file: String::new(),
            view: View::default(),
        }
    }
}

/// mDNS.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DiscoverySettings {
    /// Whether the box announces its services.
    pub enabled: bool,
}

/// MQTT.
#[derive(Clone, Debug, PartialEq)]
pub struct MqttSettings {
    /// Whether this output is enabled.
    pub enabled: bool,
    /// `host:port`.
    pub broker: String,
    /// Whether the connection is TLS.
    pub tls: bool,
    /// A file with the certificates, in PEM, that the broker's must be signed by.
    pub ca_file: String,
    /// 4 for MQTT 3.1.1, 5.
    pub version: u32,
    /// For brokers that ask for one; empty = none.
    pub user: String,
    /// A file with the password; empty = none.
    pub password_file: String,
    /// What every topic starts with.
    pub prefix: String,
    /// Weights a second; 0 = none.
    pub rate_hz: f32,
    /// Seconds between two reports of health.
    pub health_s: f32,
    /// Whether commands are taken.
    pub commands: bool,
    /// Whether the box announces itself to Home Assistant.
    pub home_assistant: bool,
    /// Names, gains and mirroring of the units.
    pub view: View,
    /// What is sent when a face is lost.
    pub loss: LossPolicy,
}

impl Default for MqttSettings {
    fn default() -> Self {
        Self {
            enabled: false,
            broker: "127.0.0.1:1883".to_owned(),
            tls: false,
            ca_file: "/etc/ssl/certs/ca-certificates.crt".to_owned(),
            version: 4,
            user: String::new(),
            password_file: String::new(),
            prefix: "mien".to_owned(),
            rate_hz: 5.0,
            health_s: 10.0,
            commands: false,
            home_assistant: false,
            view: View::default(),
            loss: LossPolicy::default(),
        }
    }
}

/// The first line of a password file; `None` if no file is named.
///
/// # Errors
/// If the file cannot be read.
#[cfg(any(feature = "web", feature = "mqtt"))]
pub(super) fn password(path: &str) -> Result<Option<String>, OutputError> {
    if path.is_empty() {
        return Ok(None);
    }
    match std::fs::read_to_string(path) {
        Ok(text) => Ok(Some(text.lines().next().unwrap_or_default().to_owned())),
        Err(source) => Err(OutputError::Password {
            path: path.to_owned(),
            source,
        }),
    }
}
