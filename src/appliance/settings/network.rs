//! Keys of the outputs that are optional build features.
//! One table, like that of the other keys; every build reads all of it.

use super::keys::{Key, Kind, MIRROR, is_host_port, key, single, targets};

const ENABLED: &str = "Whether this output is enabled.";
const TARGET: &str = "Destinations: hosts, broadcast addresses or multicast groups.";
const HOLD: &str = "How long the last weights of a lost face are held.";
const DECAY: &str = "How long they then take to fade to neutral.";
const FILE: &str = "the path of a file, or empty";
const LISTEN: &str =
    "Address to serve on; 127.0.0.1 serves this machine only, 0.0.0.0 anyone who can reach it.";

/// `address:port` of this machine.
fn listen(value: &mut String) -> Kind<'_> {
    Kind::Text {
        value,
        form: "address:port",
        valid: |text| text.parse::<std::net::SocketAddr>().is_ok(),
    }
}

fn seconds(value: &mut f32) -> Kind<'_> {
    single(value, 0.0, 60.0, "s")
}

fn text<'a>(value: &'a mut String, form: &'static str, valid: fn(&str) -> bool) -> Kind<'a> {
    Kind::Text { value, form, valid }
}

/// Whether a row of the channel table is well-formed; whether its unit is measured depends on the learning method.
fn is_channel(row: &str) -> bool {
    #[cfg(feature = "lights")]
    let read = crate::output::lights::Row::read(row).map(|(unit, _)| unit);
    // Rows that nothing reads are not judged.
    #[cfg(not(feature = "lights"))]
    let read = row.split_whitespace().next();
    read.is_some_and(|unit| {
        ["present", "yaw", "pitch", "roll"].contains(&unit) || super::units::is_unit(unit)
    })
}

/// The keys, in the order printed.
pub(super) const KEYS: &[Key] = &[
    key(
        "network",
        "name",
        "Name of the box on the network; empty = the host name.",
        |s| {
            text(
                &mut s.network.name,
                "at most 63 letters, digits and -, or empty",
                |name| {
                    name.len() <= 63 && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '-')
                },
            )
        },
    ),
    key(
        "lights",
        "channels",
        "Channels count from 1, 16-bit ones take two; the curve is linear, square, root or smooth; MIN and MAX are percentages; hold keeps the value when the face is lost.",
        |s| Kind::Texts {
            value: &mut s.network.lights.channels,
            form: "rows \"UNIT UNIVERSE CHANNEL [8|16] [CURVE] [MIN MAX] [hold]\", like [\"AU26 1 17 16 smooth 10 90\"]; for UNIT also present, yaw, pitch, roll",
            valid: is_channel,
            least: 0,
        },
    ),
    key("lights", "mirror", MIRROR, |s| Kind::Bool {
        value: &mut s.network.lights.view.mirror,
    }),
    key("lights", "hold_s", HOLD, |s| {
        seconds(&mut s.network.lights.loss.hold_s)
    }),
    key("lights", "decay_s", DECAY, |s| {
        seconds(&mut s.network.lights.loss.decay_s)
    }),
    key("artnet", "enabled", ENABLED, |s| Kind::Bool {
        value: &mut s.network.artnet.enabled,
    }),
    key(
        "artnet",
        "target",
        "Destinations: hosts or broadcast addresses.",
        |s| targets(&mut s.network.artnet.targets),
    ),
    key("sacn", "enabled", ENABLED, |s| Kind::Bool {
        value: &mut s.network.sacn.enabled,
    }),
    key(
        "sacn",
        "target",
        "Destinations; [] = the multicast group of each universe.",
        |s| Kind::Texts {
            value: &mut s.network.sacn.targets,
            form: "host:port, or several, or []",
            valid: is_host_port,
            least: 0,
        },
    ),
    key(
        "sacn",
        "priority",
        "Priority; receivers use the source with the highest.",
        |s| Kind::Integer {
            value: &mut s.network.sacn.priority,
            min: 0,
            max: 200,
            unit: "",
        },
    ),
    key("live_link", "enabled", ENABLED, |s| Kind::Bool {
        value: &mut s.network.live_link.enabled,
    }),
    key("live_link", "target", TARGET, |s| {
        targets(&mut s.network.live_link.targets)
    }),
    key(
        "live_link",
        "subject",
        "Subject name in Unreal; empty = the name of the box.",
        |s| {
            text(
                &mut s.network.live_link.subject,
                "at most 64 bytes",
                |name| name.len() <= 64,
            )
        },
    ),
    key("live_link", "mirror", MIRROR, |s| Kind::Bool {
        value: &mut s.network.live_link.view.mirror,
    }),
    key("live_link", "hold_s", HOLD, |s| {
        seconds(&mut s.network.live_link.loss.hold_s)
    }),
    key("live_link", "decay_s", DECAY, |s| {
        seconds(&mut s.network.live_link.loss.decay_s)
    }),
    key(
        "websocket",
        "enabled",
        "Whether this server is enabled.",
        |s| Kind::Bool {
            value: &mut s.network.websocket.enabled,
        },
    ),
    key("websocket", "listen", LISTEN, |s| {
        listen(&mut s.network.websocket.listen)
    }),
    key("websocket", "mirror", MIRROR, |s| Kind::Bool {
        value: &mut s.network.websocket.view.mirror,
    }),
    key("websocket", "hold_s", HOLD, |s| {
        seconds(&mut s.network.websocket.loss.hold_s)
    }),
    key("websocket", "decay_s", DECAY, |s| {
        seconds(&mut s.network.websocket.loss.decay_s)
    }),
    key("page", "enabled", "Whether this server is enabled.", |s| {
        Kind::Bool {
            value: &mut s.network.page.enabled,
        }
    }),
    key("page", "listen", LISTEN, |s| {
        listen(&mut s.network.page.listen)
    }),
    key(
        "page",
        "password_file",
        "File with the password in its first line, for any user name; empty = none, and local networks only.",
        |s| text(&mut s.network.page.password_file, FILE, |_| true),
    ),
    key(
        "oscquery",
        "enabled",
        "Whether this server is enabled.",
        |s| Kind::Bool {
            value: &mut s.network.oscquery.enabled,
        },
    ),
    key("oscquery", "listen", LISTEN, |s| {
        listen(&mut s.network.oscquery.listen)
    }),
    key(
        "discovery",
        "enabled",
        "Whether the box announces its services.",
        |s| Kind::Bool {
            value: &mut s.network.discovery.enabled,
        },
    ),
    key("mqtt", "enabled", "Whether this output is enabled.", |s| {
        Kind::Bool {
            value: &mut s.network.mqtt.enabled,
        }
    }),
    key("mqtt", "broker", "The broker's address.", |s| {
        text(&mut s.network.mqtt.broker, "host:port", is_host_port)
    }),
    key(
        "mqtt",
        "tls",
        "Whether the connection is encrypted with TLS, usually on port 8883.",
        |s| Kind::Bool {
            value: &mut s.network.mqtt.tls,
        },
    ),
    key(
        "mqtt",
        "ca_file",
        "Trusted CA certificates, in PEM; the default is the system's.",
        |s| {
            text(&mut s.network.mqtt.ca_file, "the path of a file", |path| {
                !path.is_empty()
            })
        },
    ),
    key(
        "mqtt",
        "version",
        "Protocol version: 4 is MQTT 3.1.1, which every broker supports; 5 is MQTT 5.",
        |s| Kind::Integer {
            value: &mut s.network.mqtt.version,
            min: 4,
            max: 5,
            unit: "",
        },
    ),
    key("mqtt", "user", "User name; empty = none.", |s| {
        text(
            &mut s.network.mqtt.user,
            "at most 64 bytes, or empty",
            |name| name.len() <= 64,
        )
    }),
    key(
        "mqtt",
        "password_file",
        "File with the password in its first line; empty = none.",
        |s| text(&mut s.network.mqtt.password_file, FILE, |_| true),
    ),
    key(
        "mqtt",
        "prefix",
        "Prefix of every topic; the name of the box follows it.",
        |s| {
            text(
                &mut s.network.mqtt.prefix,
                "at most 64 bytes without spaces, #, + or a slash at either end",
                |text| {
                    let plain = |c: char| c.is_ascii_graphic() && !"#+\"\\$".contains(c);
                    !text.is_empty()
                        && text.len() <= 64
                        && text.chars().all(plain)
                        && !text.starts_with('/')
                        && !text.ends_with('/')
                },
            )
        },
    ),
    key(
        "mqtt",
        "rate_hz",
        "Maximum rate at which weights are sent; 0 sends none.",
        |s| single(&mut s.network.mqtt.rate_hz, 0.0, 30.0, "Hz"),
    ),
    key(
        "mqtt",
        "health_s",
        "Interval between health messages.",
        |s| single(&mut s.network.mqtt.health_s, 1.0, 3600.0, "s"),
    ),
    key(
        "mqtt",
        "commands",
        "Whether the commands forget, freeze and neutral are accepted.",
        |s| Kind::Bool {
            value: &mut s.network.mqtt.commands,
        },
    ),
    key(
        "mqtt",
        "home_assistant",
        "Whether the box announces itself to Home Assistant (MQTT discovery).",
        |s| Kind::Bool {
            value: &mut s.network.mqtt.home_assistant,
        },
    ),
    key("mqtt", "mirror", MIRROR, |s| Kind::Bool {
        value: &mut s.network.mqtt.view.mirror,
    }),
    key("mqtt", "hold_s", HOLD, |s| {
        seconds(&mut s.network.mqtt.loss.hold_s)
    }),
    key("mqtt", "decay_s", DECAY, |s| {
        seconds(&mut s.network.mqtt.loss.decay_s)
    }),
];
