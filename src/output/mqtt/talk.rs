//! What is published, under which topics, and which commands are read.

use std::time::Duration;

use super::home_assistant;
use super::stream::Trust;
use crate::output::Command;
use crate::output::features::MqttSettings;

/// What is published, and to which broker.
pub(super) struct Talk {
    pub(super) broker: String,
    pub(super) trust: Trust,
    pub(super) client: String,
    pub(super) user: Option<String>,
    pub(super) password: Option<String>,
    /// Prefix and name.
    pub(super) base: String,
    pub(super) presence: String,
    /// Output names of the units.
    pub(super) units: Box<[String]>,
    pub(super) gestures: Box<[String]>,
    /// Topics and payloads for Home Assistant.
    pub(super) entities: Box<[(String, String)]>,
    /// Topic of the commands, if any are accepted.
    pub(super) commands: Option<String>,
    pub(super) weights_each: Option<Duration>,
    pub(super) health_each: Duration,
}

impl Talk {
    pub(super) fn new(
        settings: &MqttSettings,
        name: &str,
        trust: Trust,
        password: Option<String>,
        [units, gestures]: [&[&str]; 2],
    ) -> Self {
        let base = format!("{}/{name}", settings.prefix);
        let entities = settings
            .home_assistant
            .then(|| home_assistant::entities(&base, name, settings.commands, gestures));
        let names = units.iter().map(|unit| settings.view.name(unit).to_owned());
        Self {
            broker: settings.broker.clone(),
            trust,
            client: format!("mien-{name}"),
            user: Some(settings.user.clone()).filter(|user| !user.is_empty()),
            password,
            presence: format!("{base}/presence"),
            units: names.collect(),
            gestures: gestures.iter().map(|&name| name.to_owned()).collect(),
            entities: entities.unwrap_or_default(),
            commands: settings.commands.then(|| format!("{base}/cmd/+")),
            base,
            weights_each: (settings.rate_hz > 0.0)
                .then(|| Duration::from_secs_f32(1.0 / settings.rate_hz)),
            health_each: Duration::from_secs_f32(settings.health_s),
        }
    }

    /// The command in a message on one of our topics.
    pub(super) fn command(&self, topic: &[u8], payload: &[u8]) -> Option<Command> {
        let topic = std::str::from_utf8(topic).ok()?;
        let what = topic.strip_prefix(&self.base)?.strip_prefix("/cmd/")?;
        let payload = std::str::from_utf8(payload).ok()?;
        Command::of_words(what, payload.split_whitespace())
    }
}
