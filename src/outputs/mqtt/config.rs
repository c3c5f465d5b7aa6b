//! Configuration of the connection: topics, login, commands, and the entities for Home Assistant (MQTT discovery).

use serde_json::{Value, json};

use super::stream::{Trust, trust};
use crate::features::{MqttSettings, password};
use crate::{Command, OutputError};

/// Everything about the connection that is fixed at start-up.
pub(super) struct BrokerConfig {
    pub(super) settings: MqttSettings,
    pub(super) trust: Trust,
    pub(super) client: String,
    pub(super) password: Option<String>,
    /// Prefix and name of the box, with which every topic starts.
    pub(super) base: String,
    pub(super) presence: String,
    /// Topics and payloads of the discovery messages.
    pub(super) entities: Box<[(String, String)]>,
    /// Topic of the commands, if they are accepted.
    pub(super) commands: Option<String>,
}

impl BrokerConfig {
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

    /// The command in a message; `None` if topic or payload is not one.
    pub(super) fn command(&self, topic: &[u8], payload: &[u8]) -> Option<Command> {
        let topic = std::str::from_utf8(topic).ok()?;
        let command = topic.strip_prefix(&self.base)?.strip_prefix("/cmd/")?;
        let payload = std::str::from_utf8(payload).ok()?;
        Command::from_words(command, payload.split_whitespace())
    }
}

/// Topics and payloads of the discovery messages. `base` is prefix and name of the box.
fn entities(base: &str, name: &str, commands: bool, gestures: &[&str]) -> Box<[(String, String)]> {
    let topic = |topic: &str| format!("{base}/{topic}");
    let entity = |kind: &str, id: &str, mut entity_json: Value| {
        entity_json["unique_id"] = format!("mien_{name}_{id}").into();
        entity_json["availability_topic"] = topic("presence").into();
        let (box_id, name) = (format!("mien_{name}"), format!("mien {name}"));
        let version = env!("CARGO_PKG_VERSION");
        entity_json["device"] =
            json!({"identifiers": [box_id], "name": name, "model": "mien", "sw_version": version});
        let topic = format!("homeassistant/{kind}/{box_id}/{id}/config");
        (topic, entity_json.to_string())
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
        let entity_json = json!({"name": shown, "command_topic": command, "payload_press": "0"});
        entity("button", id, entity_json)
    });
    // Per gesture a sensor for display and a trigger for automations.
    let gestures = gestures.iter().flat_map(|gesture| {
        let (id, shown) = (format!("gesture_{gesture}"), gesture.replace('_', " "));
        let state_topic = topic(&format!("gesture/{gesture}"));
        let state = json!({"name": shown, "state_topic": state_topic});
        let trigger = json!({
            "automation_type": "trigger", "type": "gesture", "subtype": shown, "topic": state_topic, "payload": "ON",
        });
        let state = entity("binary_sensor", &id, state);
        [state, entity("device_automation", &id, trigger)]
    });
    shown.into_iter().chain(buttons).chain(gestures).collect()
}
