//! What is published, under which topics, and which commands are read; and what Home Assistant is told of the box (MQTT
//! discovery): its entities, and where their values are.

use super::stream::{Trust, trust};
use crate::output::features::{MqttSettings, password};
use crate::output::{Command, OutputError};

/// What is published, and to which broker.
pub(super) struct Talk {
    pub(super) settings: MqttSettings,
    pub(super) trust: Trust,
    pub(super) client: String,
    pub(super) password: Option<String>,
    /// Prefix and name.
    pub(super) base: String,
    pub(super) presence: String,
    /// Topics and payloads for Home Assistant.
    pub(super) entities: Box<[(String, String)]>,
    /// Topic of the commands, if any are accepted.
    pub(super) commands: Option<String>,
}

impl Talk {
    pub(super) fn new(
        settings: &MqttSettings,
        name: &str,
        gestures: &[&str],
    ) -> Result<Self, OutputError> {
        let base = format!("{}/{name}", settings.prefix);
        let entities = settings
            .home_assistant
            .then(|| entities(&base, name, settings.commands, gestures));
        Ok(Self {
            trust: trust(settings)?,
            client: format!("mien-{name}"),
            password: password(&settings.password_file)?,
            presence: format!("{base}/presence"),
            entities: entities.unwrap_or_default(),
            commands: settings.commands.then(|| format!("{base}/cmd/+")),
            base,
            settings: settings.clone(),
        })
    }

    /// The command in a message on one of our topics.
    pub(super) fn command(&self, topic: &[u8], payload: &[u8]) -> Option<Command> {
        let topic = std::str::from_utf8(topic).ok()?;
        let what = topic.strip_prefix(&self.base)?.strip_prefix("/cmd/")?;
        let payload = std::str::from_utf8(payload).ok()?;
        Command::of_words(what, payload.split_whitespace())
    }
}

/// Topics and payloads of the entities. `base` is prefix and name.
fn entities(base: &str, name: &str, commands: bool, gestures: &[&str]) -> Box<[(String, String)]> {
    let entity = |kind: &str, id: &str, what: String| entity(base, name, kind, id, &what);
    let switch = |condition: &str| format!("'ON' if {condition} else 'OFF'");
    let value = |topic: &str, template: &str, rest: &str| {
        format!(
            "\"state_topic\":\"{base}/{topic}\",\"value_template\":\"{{{{ {template} }}}}\",{rest}"
        )
    };
    let face = value(
        "faces",
        &switch("value|int > 0"),
        r#""name":"Face","device_class":"occupancy""#,
    );
    let faces = value(
        "faces",
        "value",
        r#""name":"Faces","state_class":"measurement""#,
    );
    let sensor = value(
        "health",
        &switch("value_json.sensor"),
        r#""name":"Depth camera","device_class":"connectivity","entity_category":"diagnostic""#,
    );
    let rate = value(
        "health",
        "value_json.rate_hz",
        r#""name":"Rate","unit_of_measurement":"Hz","device_class":"frequency","entity_category":"diagnostic""#,
    );
    let shown = [
        entity("binary_sensor", "face", face),
        entity("sensor", "faces", faces),
        entity("binary_sensor", "sensor", sensor),
        entity("sensor", "rate", rate),
    ];
    let buttons = [("forget", "Forget"), ("neutral", "Set neutral")];
    let buttons = buttons.into_iter().filter(|_| commands);
    let buttons = buttons.map(|(id, shown)| {
        let topic = format!("\"name\":\"{shown}\",\"command_topic\":\"{base}/cmd/{id}\"");
        entity("button", id, topic + ",\"payload_press\":\"0\"")
    });
    // A sensor to show, and a trigger for automations.
    let gestures = gestures.iter().flat_map(|gesture| {
        let (id, shown) = (format!("gesture_{gesture}"), gesture.replace('_', " "));
        let lamp = format!("\"name\":\"{shown}\",\"state_topic\":\"{base}/gesture/{gesture}\"");
        let trigger = format!(
            "\"automation_type\":\"trigger\",\"type\":\"gesture\",\"subtype\":\"{shown}\",\"topic\":\"{base}/gesture/{gesture}\",\"payload\":\"ON\""
        );
        let lamp = entity("binary_sensor", &id, lamp);
        [lamp, entity("device_automation", &id, trigger)]
    });
    shown.into_iter().chain(buttons).chain(gestures).collect()
}

fn entity(base: &str, name: &str, kind: &str, id: &str, what: &str) -> (String, String) {
    let version = env!("CARGO_PKG_VERSION");
    (
        format!("homeassistant/{kind}/mien_{name}/{id}/config"),
        format!(
            "{{\"unique_id\":\"mien_{name}_{id}\",{what},\"availability_topic\":\"{base}/presence\",\"device\":{{\"identifiers\":[\"mien_{name}\"],\"name\":\"mien {name}\",\"model\":\"mien\",\"sw_version\":\"{version}\"}}}}"
        ),
    )
}
