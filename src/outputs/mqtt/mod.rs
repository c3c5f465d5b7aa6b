//! MQTT 3.1.1: presence, state, health, weights at a chosen rate, commands, and Home Assistant's discovery. Topics start with the
//! prefix and the box's name:
//!
//! | topic | payload | when |
//! | --- | --- | --- |
//! | `presence` | `online`, `offline` (also published by the broker, as the last will) | on connecting and leaving; retained |
//! | `faces` | number of people | on change; retained |
//! | `<slot>/state` | `{"state":"tracking","present":true,"changes":7,"time_us":400000}` | on change; retained |
//! | `gesture/<name>` | `ON`, `OFF`: whether at least one person makes it | on change; only `OFF` is retained |
//! | `health` | `{"sensor":true,"rate_hz":30.0,"latency_ms":9.1,"faces":1,"frames":900,"uptime_s":30.1,"dropped":0}` | every `health_s`; retained |
//! | `<slot>/weights` | `{"time_us":400000,"AU26":0.2500,…}` | at `rate_hz` while somebody is there |
//! | `cmd/forget`, `cmd/neutral` | slot | received, if commands are enabled |
//! | `cmd/freeze` | slot, and 0 or 1 | |
//!
//! Presence, faces and states are sent with QoS 1, one at a time, and repeated across reconnects until acknowledged; when 64 wait,
//! the oldest is dropped. Weights and health are sent once; weights that a slow broker does not accept are dropped and counted.
//! A separate thread does all this: a broker that is unreachable, slow, refuses or sends garbage is retried after 1, 2, 4, … at
//! most 30 s, without affecting anything else. Retained commands are ignored, because the broker would repeat them at every
//! connection. With TLS ([`stream`]) the thread allocates while running.

mod client;
mod config;
mod messages;
mod packet;
mod stream;

use std::sync::Arc;

use super::features::MqttSettings;
use super::mailbox::ThreadedOutput;
use super::{OutputError, identity};

/// Starts connecting to the broker. `units` are the names in the order of the weights, `gestures` the names of the gestures, `name`
/// the name of the box.
///
/// # Errors
/// If the password or the certificates cannot be read or no thread can be started; not if the broker is unreachable.
pub fn open(
    settings: &MqttSettings,
    name: &str,
    units: &[&str],
    gestures: &[&str],
) -> Result<ThreadedOutput, OutputError> {
    let config = config::BrokerConfig::new(settings, &identity::name(name), gestures)?;
    let messages = messages::Messages::new(&settings.view, units, gestures);
    let work = move |shared: Arc<_>, waker| client::run(&config, messages, &shared, waker);
    ThreadedOutput::start("mqtt", units, &settings.view, work)
}

/// Checks the password and the certificates.
///
/// # Errors
/// If one cannot be read.
pub fn check(settings: &MqttSettings) -> Result<(), OutputError> {
    config::BrokerConfig::new(settings, "", &[]).map(drop)
}

/// Parses bytes from a broker, for `tests/fuzz`.
#[cfg(fuzzing)]
pub fn fuzz(mut bytes: &[u8]) {
    while let Ok(Some((packet, used))) = packet::read(bytes) {
        if let packet::FromBroker::Message { topic, payload, .. } = packet {
            assert!(topic.len() + payload.len() < used);
        }
        bytes = &bytes[used..];
    }
}

#[cfg(test)]
mod tests {
    use std::io::{Read, Write};
    use std::net::TcpListener;
    use std::time::{Duration, Instant};

    use super::*;
    use crate::{Output, Report, TrackingState};

    /// Accepts one client and acknowledges its messages until it leaves; returns their topics, their payloads and whether they are retained.
    fn broker(listener: &TcpListener) -> Vec<(String, String, bool)> {
        let (mut client, _) = listener.accept().unwrap();
        let (mut bytes, mut all) = (Vec::new(), Vec::new());
        let mut room = [0; 4096];
        let mut is_connected = false;
        loop {
            let length = client.read(&mut room).unwrap_or(0);
            if length == 0 {
                return all;
            }
            bytes.extend_from_slice(&room[..length]);
            if !is_connected {
                // Its greeting, which is shorter than 128 bytes, is all it says before it is answered.
                bytes.clear();
                client.write_all(b"\x20\x02\0\0").unwrap();
                is_connected = true;
            }
            let mut out = Vec::new();
            while let Ok(Some((packet, used))) = packet::read(&bytes) {
                if let packet::FromBroker::Message {
                    topic,
                    payload,
                    packet_id,
                    retained,
                } = packet
                {
                    let text = |bytes: &[u8]| String::from_utf8(bytes.to_vec()).unwrap();
                    all.push((text(topic), text(payload), retained));
                    if let Some(packet_id) = packet_id {
                        packet::acknowledge(packet_id, &mut out);
                    }
                }
                bytes.drain(..used);
            }
            // The client may have gone.
            let _ = client.write_all(&out);
        }
    }

    #[test]
    fn a_gesture_is_told_and_off_when_the_run_ends() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let settings = MqttSettings {
            broker: listener.local_addr().unwrap().to_string(),
            home_assistant: true,
            rate_hz: 20.0,
            health_s: 0.5,
            ..MqttSettings::default()
        };
        let broker = std::thread::spawn(move || broker(&listener));
        let mut mqtt = open(&settings, "hall", &["AU26"], &["smile", "kiss"]).unwrap();
        let start = Instant::now();
        for frame in 0..200 {
            let report = Report {
                frame,
                user: Some(0),
                state: TrackingState::Tracking,
                weights: &[0.5],
                gestures: u32::from(frame >= 100),
                ..Report::default()
            };
            mqtt.send(&report).unwrap();
            std::thread::sleep(Duration::from_millis(10));
        }
        drop(mqtt);
        let passed = start.elapsed().as_secs_f32();
        let published = broker.join().unwrap();
        let payloads = |topic: &str| -> Vec<&str> {
            let found = published.iter().filter(|(known, ..)| known == topic);
            found.map(|(_, payload, _)| payload.as_str()).collect()
        };
        assert_eq!(payloads("mien/hall/gesture/smile"), ["OFF", "ON", "OFF"]);
        assert_eq!(payloads("mien/hall/gesture/kiss"), ["OFF"]);
        let is_on = |payload: &str| payload == "ON";
        assert!(published.iter().all(|(_, payload, retained)| {
            payload.starts_with("{\"time_us\"") || *retained != is_on(payload)
        }));
        let faces = payloads("mien/hall/faces");
        assert_eq!((faces.first(), faces.last()), (Some(&"1"), Some(&"0")));
        // As often as asked for, of one person.
        let weights = payloads("mien/hall/0/weights");
        let most = |rate_hz: f32| (passed * rate_hz) as usize + 2;
        assert!(
            (10..=most(20.0)).contains(&weights.len()),
            "{}",
            weights.len()
        );
        let (mut first, ending) = (weights[..10].iter(), ",\"AU26\":0.5000}");
        assert!(
            first.all(|weights| weights.ends_with(ending)),
            "{weights:?}"
        );
        assert!(payloads("mien/hall/1/weights").is_empty());
        let health = payloads("mien/hall/health");
        assert!((2..=most(2.0)).contains(&health.len()), "{health:?}");
        assert!(health[1].contains("\"sensor\":true") && health[1].contains("\"faces\":1"));
        for kind in ["binary_sensor", "device_automation"] {
            let entity = payloads(&format!(
                "homeassistant/{kind}/mien_hall/gesture_smile/config"
            ));
            assert!(
                entity.len() == 1 && entity[0].contains("mien/hall/gesture/smile"),
                "{entity:?}"
            );
        }
    }
}
