//! What is published, under which topics, and which commands are read; and what Home Assistant is told of the box (MQTT
//! discovery): its entities, and where their values are.

use serde_json::{Value, json};

use super::stream::{Trust, trust};
use crate::features::{MqttSettings, password};
use crate::{Command, OutputError};

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
    let topic = |topic: &str| format!("{base}/{topic}");
    let entity = |kind: &str, id: &str, mut what: Value| {
        what["unique_id"] = format!("mien_{name}_{id}").into();
        what["availability_topic"] = topic("presence").into();
        let (box_id, name) = (format!("mien_{name}"), format!("mien {name}"));
        let version = env!("CARGO_PKG_VERSION");
        what["device"] =
            json!({"identifiers": [box_id], "name": name, "model": "mien", "sw_version": version});
        let topic = format!("homeassistant/{kind}/{box_id}/{id}/config");
        (topic, what.to_string())
    };
    let face = json!({
        "name": "Face", "device_class": "occupancy",
        "state_topic": topic("faces"), "value_template": "{{ 'ON' if value|int > 0 else 'OFF' }}",
    });
    let faces = json!({
        "name": "Faces", "state_class": "measurement",
        "state_topic": topic("faces"), "value_template": "{{ value }}",
    });
    let sensor = json!({
        "name": "Depth camera", "device_class": "connectivity", "entity_category": "diagnostic",
        "state_topic": topic("health"), "value_template": "{{ 'ON' if value_json.sensor else 'OFF' }}",
    });
    let rate = json!({
        "name": "Rate", "unit_of_measurement": "Hz", "device_class": "frequency", "entity_category": "diagnostic",
        "state_topic": topic("health"), "value_template": "{{ value_json.rate_hz }}",
    });
    let shown = [
        entity("binary_sensor", "face", face),
        entity("sensor", "faces", faces),
        entity("binary_sensor", "sensor", sensor),
        entity("sensor", "rate", rate),
    ];
    let buttons = [("forget", "Forget"), ("neutral", "Set neutral")];
    let buttons = buttons.into_iter().filter(|_| commands);
    let buttons = buttons.map(|(id, shown)| {
        let command = topic(&format!("cmd/{id}"));
        let what = json!({"name": shown, "command_topic": command, "payload_press": "0"});
        entity("button", id, what)
    });
    // A sensor to show, and a trigger for automations.
    let gestures = gestures.iter().flat_map(|gesture| {
        let (id, shown) = (format!("gesture_{gesture}"), gesture.replace('_', " "));
        let from = topic(&format!("gesture/{gesture}"));
        let lamp = json!({"name": shown, "state_topic": from});
        let trigger = json!({
            "automation_type": "trigger", "type": "gesture", "subtype": shown, "topic": from, "payload": "ON",
        });
        let lamp = entity("binary_sensor", &id, lamp);
        [lamp, entity("device_automation", &id, trigger)]
    });
    shown.into_iter().chain(buttons).chain(gestures).collect()
}
