//! MQTT 3.1.1, for buildings and fleets: presence, state, health, weights at a chosen rate, commands, and Home Assistant's discovery.
//! Topics start with the prefix and the box's name:
//!
//! | topic | payload | when |
//! | --- | --- | --- |
//! | `presence` | `online`, `offline` (by the broker too, as the last will) | on connecting and leaving; retained |
//! | `faces` | number of people | on change; retained |
//! | `<slot>/state` | `{"state":"tracking","present":true,"changes":7,"time_us":400000}` | on change; retained |
//! | `gesture/<name>` | `ON`, `OFF`: whether anybody makes it | on change; retained |
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
mod packet;
mod stream;
mod talk;
mod watch;

use std::sync::Arc;

use super::board::Front;
use super::features::MqttSettings;
use super::{OutputError, identity};

/// Starts connecting to the broker. `units` are the names in the order of the weights, `gestures` those of the gestures, `name`
/// is the box's.
///
/// # Errors
/// If the password or the certificates cannot be read or no thread can be started; not if the broker is unreachable.
pub fn open(
    settings: &MqttSettings,
    name: &str,
    units: &[&str],
    gestures: &[&str],
) -> Result<Front, OutputError> {
    let talk = talk::Talk::new(settings, &identity::name(name), gestures)?;
    let watch = watch::Watch::new(&settings.view, units, gestures);
    let work = move |shared: Arc<_>, bell| client::run(&talk, watch, &shared, bell);
    Front::start("mqtt", units, &settings.view, work)
}

/// Whether the password and the certificates can be used.
///
/// # Errors
/// If one cannot be read.
pub fn check(settings: &MqttSettings) -> Result<(), OutputError> {
    talk::Talk::new(settings, "", &[]).map(drop)
}

/// What a broker sends, for `tests/fuzz`.
#[cfg(fuzzing)]
pub fn fuzz(mut bytes: &[u8]) {
    while let Ok(Some((told, used))) = packet::read(bytes) {
        if let packet::FromBroker::Message { topic, payload, .. } = told {
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

    /// Accepts one client and acknowledges what it publishes until it leaves: topics and payloads.
    fn broker(listener: &TcpListener) -> Vec<(String, String)> {
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
            while let Ok(Some((told, used))) = packet::read(&bytes) {
                if let packet::FromBroker::Message {
                    topic,
                    payload,
                    number,
                    ..
                } = told
                {
                    let text = |bytes: &[u8]| String::from_utf8(bytes.to_vec()).unwrap();
                    all.push((text(topic), text(payload)));
                    if let Some(number) = number {
                        packet::acknowledge(number, &mut out);
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
        let told = std::thread::spawn(move || broker(&listener));
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
        let told = told.join().unwrap();
        let of = |topic: &str| -> Vec<&str> {
            let of = told.iter().filter(|(told, _)| told == topic);
            of.map(|(_, payload)| payload.as_str()).collect()
        };
        assert_eq!(of("mien/hall/gesture/smile"), ["OFF", "ON", "OFF"]);
        assert_eq!(of("mien/hall/gesture/kiss"), ["OFF"]);
        let faces = of("mien/hall/faces");
        assert_eq!((faces.first(), faces.last()), (Some(&"1"), Some(&"0")));
        // As often as asked for, of one person.
        let weights = of("mien/hall/0/weights");
        let most = |rate_hz: f32| (passed * rate_hz) as usize + 2;
        assert!(
            (10..=most(20.0)).contains(&weights.len()),
            "{}",
            weights.len()
        );
        let (mut first, told) = (weights[..10].iter(), ",\"AU26\":0.5000}");
        assert!(first.all(|weights| weights.ends_with(told)), "{weights:?}");
        assert!(of("mien/hall/1/weights").is_empty());
        let health = of("mien/hall/health");
        assert!((2..=most(2.0)).contains(&health.len()), "{health:?}");
        assert!(health[1].contains("\"sensor\":true") && health[1].contains("\"faces\":1"));
        for kind in ["binary_sensor", "device_automation"] {
            let entity = of(&format!(
                "homeassistant/{kind}/mien_hall/gesture_smile/config"
            ));
            assert!(
                entity.len() == 1 && entity[0].contains("mien/hall/gesture/smile"),
                "{entity:?}"
            );
        }
    }
}
