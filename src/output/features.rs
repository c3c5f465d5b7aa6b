//! Settings of the outputs that are optional build features: Live Link, web, MQTT. Every build knows them, so
//! that all builds read the same configuration; enabling an output that is not built in is an error.

#[cfg(feature = "wires")]
use super::OutputError;
use super::View;
#[cfg(feature = "wires")]
use crate::base::bounded_read;
use crate::base::defaults;

defaults! {
    /// Unreal's Live Link, in the format of the Live Link Face app.
    #[derive(Clone, Debug, PartialEq)]
    pub struct LiveLinkSettings {
        /// Whether this output is enabled.
        pub enabled: bool = false,
        /// Each `host:port`.
        pub targets: Vec<String> = vec!["127.0.0.1:11111".to_owned()],
        /// Subject name in Unreal; empty = the name of the box.
        pub subject: String = String::new(),
        /// Whether shapes that are not measured follow what they go with.
        pub derived: bool = true,
        /// How faces and units are shown.
        pub view: View = View::default(),
    }

    /// JSON over WebSocket.
    #[derive(Clone, Debug, PartialEq)]
    pub struct WebSocketSettings {
        /// Whether anybody is served.
        pub enabled: bool = false,
        /// `address:port`.
        pub listen: String = "127.0.0.1:9133".to_owned(),
        /// How faces and units are shown.
        pub view: View = View::default(),
    }

    /// The page of the box.
    #[derive(Clone, Debug, PartialEq)]
    pub struct PageSettings {
        /// Whether it is served.
        pub enabled: bool = false,
        /// `address:port`.
        pub listen: String = "127.0.0.1:9134".to_owned(),
        /// A file with the password; empty = none, and only local networks are served.
        pub password_file: String = String::new(),
        /// How faces and units are shown.
        pub view: View = View::default(),
    }

    /// MQTT.
    #[derive(Clone, Debug, PartialEq)]
    pub struct MqttSettings {
        /// Whether this output is enabled.
        pub enabled: bool = false,
        /// `host:port`.
        pub broker: String = "127.0.0.1:1883".to_owned(),
        /// Whether the connection is TLS.
        pub tls: bool = false,
        /// A file with the certificates, in PEM, that the broker's must be signed by.
        pub ca_file: String = "/etc/ssl/certs/ca-certificates.crt".to_owned(),
        /// For brokers that ask for one; empty = none.
        pub user: String = String::new(),
        /// A file with the password; empty = none.
        pub password_file: String = String::new(),
        /// What every topic starts with.
        pub prefix: String = "mien".to_owned(),
        /// Weights a second; 0 = none.
        pub rate_hz: f32 = 5.0,
        /// Seconds between two reports of health.
        pub health_s: f32 = 10.0,
        /// Whether commands are taken.
        pub commands: bool = false,
        /// Whether the box announces itself to Home Assistant.
        pub home_assistant: bool = false,
        /// How faces and units are shown.
        pub view: View = View::default(),
    }
}

/// Largest password file, bytes.
#[cfg(feature = "wires")]
const PASSWORD_MOST: usize = 4096;

/// The first line of a password file; `None` if no file is named.
///
/// # Errors
/// If the file cannot be read.
#[cfg(feature = "wires")]
pub(super) fn password(path: &str) -> Result<Option<String>, OutputError> {
    if path.is_empty() {
        return Ok(None);
    }
    let text = bounded_read::regular(path.as_ref(), PASSWORD_MOST);
    let text = text.map_err(|error| OutputError::Password(path.to_owned(), error))?;
    let text = String::from_utf8_lossy(&text);
    Ok(Some(text.lines().next().unwrap_or_default().to_owned()))
}
