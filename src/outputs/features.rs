//! Settings of the outputs that are optional build features: Live Link, web, MQTT. Every build has the settings, so that all
//! builds read the same configuration; enabling an output that is not built in is an error.

#[cfg(feature = "wires")]
use super::OutputError;
use super::View;
#[cfg(feature = "wires")]
use mien_stages::base::bounded_read;
use mien_stages::base::settings::{is_host_port, keyed};

/// Expected value of an optional path, for messages.
const OPTIONAL_FILE: &str = "the path of a file, or empty";

keyed! {
    /// Unreal's Live Link, in the format of the Live Link Face app.
    pub struct LiveLinkSettings {
        /// Whether this output is enabled.
        enabled: bool = false => Bool(),
        /// Destinations: hosts, broadcast addresses or multicast groups.
        targets "target": Vec<String> = vec!["127.0.0.1:11111".to_owned()] => targets(),
        /// Subject name in Unreal; empty = the name of the box.
        subject: String = String::new() => Text("at most 64 bytes", |name| name.len() <= 64),
        /// Whether ARKit shapes that are not measured are derived from related ones, such as raised cheeks from a smile.
        derived: bool = true => Bool(),
        ..view: View,
    }
    /// JSON over WebSocket.
    pub struct WebSocketSettings {
        /// Whether this server is enabled.
        enabled: bool = false => Bool(),
        /// Address to serve on; 127.0.0.1 serves this machine only, 0.0.0.0 anyone who can reach it.
        listen: String = "127.0.0.1:9133".to_owned() => listen(),
        ..view: View,
    }
    /// The page of the box.
    pub struct PageSettings {
        /// Whether this server is enabled.
        enabled: bool = false => Bool(),
        /// Address to serve on; 127.0.0.1 serves this machine only, 0.0.0.0 anyone who can reach it.
        listen: String = "127.0.0.1:9134".to_owned() => listen(),
        /// File whose first line is the password, accepted with any user name; empty = no password, and local networks only.
        password_file: String = String::new() => Text(OPTIONAL_FILE, |_| true),
    }
    /// MQTT.
    pub struct MqttSettings {
        /// Whether this output is enabled.
        enabled: bool = false => Bool(),
        /// The broker's address.
        broker: String = "127.0.0.1:1883".to_owned() => Text("host:port", is_host_port),
        /// Whether the connection is encrypted with TLS, usually on port 8883.
        tls: bool = false => Bool(),
        /// Trusted CA certificates, in PEM; the default is the system's.
        ca_file: String = "/etc/ssl/certs/ca-certificates.crt".to_owned() =>
            Text("the path of a file", |path| !path.is_empty()),
        /// User name; empty = none.
        user: String = String::new() => Text("at most 64 bytes, or empty", |name| name.len() <= 64),
        /// File whose first line is the password; empty = none.
        password_file: String = String::new() => Text(OPTIONAL_FILE, |_| true),
        /// Prefix of every topic; the name of the box follows it.
        prefix: String = "mien".to_owned() =>
            Text("at most 64 bytes without spaces, #, + or a slash at either end", is_topic),
        /// Maximum rate at which weights are sent; 0 sends none.
        rate_hz: f32 = 5.0 => number(0.0, 30.0, "Hz"),
        /// Interval between health messages.
        health_s: f32 = 10.0 => number(1.0, 3600.0, "s"),
        /// Whether commands are accepted: forget, freeze, neutral, and level, hold, teach and undo of gestures.
        commands: bool = false => Bool(),
        /// Whether the box announces itself to Home Assistant (MQTT discovery).
        home_assistant: bool = false => Bool(),
        ..view: View,
    }
}

/// Whether the text is valid as a prefix of MQTT topics.
fn is_topic(text: &str) -> bool {
    let plain = |c: char| c.is_ascii_graphic() && !"#+\"\\$".contains(c);
    let open = text.starts_with('/') || text.ends_with('/');
    (1..=64).contains(&text.len()) && text.chars().all(plain) && !open
}

/// Largest password file, bytes.
#[cfg(feature = "wires")]
const PASSWORD_FILE_MAX: usize = 4096;

/// The first line of a password file; `None` if no file is named.
///
/// # Errors
/// If the file cannot be read.
#[cfg(feature = "wires")]
pub(super) fn password(path: &str) -> Result<Option<String>, OutputError> {
    if path.is_empty() {
        return Ok(None);
    }
    let text = bounded_read::read_regular(path.as_ref(), PASSWORD_FILE_MAX);
    let text = text.map_err(|error| OutputError::Password(path.to_owned(), error))?;
    let text = String::from_utf8_lossy(&text);
    Ok(Some(text.lines().next().unwrap_or_default().to_owned()))
}
