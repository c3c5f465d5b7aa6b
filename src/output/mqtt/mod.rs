//! MQTT 3.1.1, for buildings and fleets: presence, state, health, weights at a chosen rate, commands, and Home Assistant's discovery.
//! Topics start with the prefix and the box's name:
//!
//! | topic | payload | when |
//! | --- | --- | --- |
//! | `presence` | `online`, `offline` (by the broker too, as the last will) | on connecting and leaving; retained |
//! | `faces` | number of people | on change; retained |
//! | `<slot>/state` | `{"state":"tracking","present":true,"changes":7,"time_us":400000}` | on change; retained |
//! | `health` | `{"sensor":true,"rate_hz":30.0,"latency_ms":9.1,"faces":1,"frames":900,"uptime_s":30.1,"dropped":0}` | every `health_s`; retained |
//! | `<slot>/weights` | `{"time_us":400000,"AU26":0.2500,…}` | at `rate_hz` while somebody is there |
//! | `cmd/forget`, `cmd/neutral` | slot | received, if commands are enabled |
//! | `cmd/freeze` | slot, and 0 or 1 | |
//!
//! Presence, faces and states are sent with QoS 1, one after the other, each until the broker acknowledges it, also across
//! reconnects; when 64 of them wait, the oldest is dropped. Weights and health are sent once; weights that a slow
//! broker does not accept are dropped and counted. All of it runs in a separate thread: a broker that is unreachable, slow,
//! refuses or sends garbage is retried after 1, 2, 4, … at most 30 s, without affecting anything else. Retained commands are
//! ignored, since they would be repeated at every connection. With TLS ([`stream`]) that thread allocates while running.

mod client;
mod home_assistant;
mod packet;
mod stream;
mod talk;
mod watch;

use super::board::Front;
use super::features::{MqttSettings, password};
use super::{OutputError, identity};

/// Starts connecting to the broker. `units` are the names in the order of the weights, `name` is the box's.
///
/// # Errors
/// If the password or the certificates cannot be read or no thread can be started; not if the broker is unreachable.
pub fn open(settings: &MqttSettings, name: &str, units: &[&str]) -> Result<Front, OutputError> {
    let trust = stream::trust(settings)?;
    let password = password(&settings.password_file)?;
    let talk = talk::Talk::new(settings, &identity::name(name), trust, password, units);
    let work = move |shared, bell| client::run(talk, &shared, bell);
    Front::start("mqtt", units, &settings.view, settings.loss, work)
}

/// What a broker sends, for `tests/fuzz`.
#[cfg(fuzzing)]
pub fn fuzz(mut bytes: &[u8]) {
    while let Ok(Some((told, used))) = packet::read(bytes) {
        if let packet::Told::Message { topic, payload, .. } = told {
            assert!(topic.len() + payload.len() < used);
        }
        bytes = &bytes[used..];
    }
}
