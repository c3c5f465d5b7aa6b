//! Receives the schema that [`super::Osc`] sends, for `mien-studio preview`.
//!
//! Any prefix is accepted: only `…/<user>/frame` matters. Input is untrusted: a message that is malformed or unknown,
//! has other arguments, names an impossible slot or unit, or contains a non-finite number is counted and otherwise
//! ignored. Weights without names (style `vector`) wait for the schema, which is sent every five seconds.

use super::packet::Argument::{self, Bool, Float, Int, Text};
use super::packet::{messages, parse};
use super::{ALIVE, AU, FRAME, FROZEN, GESTURE, MIEN, POSE, PRESENT, RANGE, SCHEMA, SEEN, SET_UP};
use crate::gesture::SetUpFacts;
use crate::is_name;
use crate::received::{Receive, Sample, UnitRange};
use mien_stages::base::capacity::{REGIONS, USERS};
use mien_stages::base::prelude::*;
use mien_stages::face_model::scheme::VISIBLE_REGIONS;
use mien_stages::users::TrackingState;

/// Most units of a schema.
const MAX_UNITS: usize = 256;

/// State of a stream.
#[derive(Default)]
pub struct Receiver {
    units: Vec<String>,
    /// Whether a schema named the units, which vectors require.
    named: bool,
    users: [User; USERS],
}

#[derive(Default)]
struct User {
    sample: Sample,
    ranges: Vec<Option<UnitRange>>,
    /// Whether the present datagram changed it.
    changed: [bool; 2],
}

impl Receiver {
    /// Processes one datagram.
    pub fn take(&mut self, datagram: &[u8], to: &dyn Receive) {
        let units = self.units.clone();
        let [taken, refused] = messages(datagram, &mut |one| self.message(one, to).is_some());
        to.count(taken, refused);
        if units != self.units {
            to.schema(&self.units);
        }
        for (slot, user) in self.users.iter_mut().enumerate() {
            let [sample, ranges] = std::mem::take(&mut user.changed);
            if sample {
                user.sample.weights.resize(self.units.len(), 0.0);
                to.sample(&user.sample);
            }
            if ranges {
                user.ranges.resize(self.units.len(), None);
                to.ranges(slot, &user.ranges);
            }
        }
    }

    fn message(&mut self, bytes: &[u8], to: &dyn Receive) -> Option<()> {
        let mut values = Vec::new();
        let address = parse(bytes, |value| {
            values.push(match value {
                Bool(truth) => Int(truth.into()),
                other => other,
            });
            Some(())
        })?;
        let words: Vec<&str> = address.strip_prefix('/')?.split('/').collect();
        match (&words[..], &values[..]) {
            ([.., SCHEMA], [Int(_), names @ ..]) => {
                let name = |name: &Argument| match *name {
                    Text(name) if is_name(name) => Some(name.to_owned()),
                    _ => None,
                };
                let names: Option<Vec<String>> = names.iter().map(name).collect();
                self.rename(names.filter(|names| names.len() <= MAX_UNITS)?);
                self.named = true;
                return Some(());
            }
            ([MIEN, GESTURE, name, user @ ..], [Int(is_on)]) if is_name(name) => {
                let user = match user {
                    [] => None,
                    [word] => Some(slot(word)?),
                    _ => return None,
                };
                to.gesture(name, user, *is_on != 0);
                return Some(());
            }
            ([MIEN, SET_UP, name], numbers) if is_name(name) => {
                to.set_up(name, &SetUpFacts::from_osc(numbers)?);
                return Some(());
            }
            ([.., ALIVE], [Int(_), Text(_), Float(_)]) => return Some(()),
            _ => {}
        }
        // The slot is the last word but one or two.
        let at = words.len().checked_sub(2)?;
        if let Some(slot) = slot(words[at]) {
            return self.fact(slot, words[at + 1], &values);
        }
        let slot = slot(words[at.checked_sub(1)?])?;
        self.unit(slot, words[at], words[at + 1], &values)
    }

    /// Processes a message about a user.
    fn fact(&mut self, slot: usize, what: &str, values: &[Argument]) -> Option<()> {
        let named = self.named;
        let count = self.units.len();
        let user = &mut self.users[slot];
        match (what, values) {
            (
                FRAME,
                &[
                    Int(number),
                    Int(ms),
                    Int(code),
                    Float(confidence),
                    ref more @ ..,
                ],
            ) if confidence.is_finite() => {
                let number = u64::try_from(number).ok()?;
                let state = *TrackingState::ALL.get(usize::try_from(code).ok()?)?;
                let sample = &mut user.sample;
                (sample.user, sample.number) = (Some(slot), number);
                sample.seconds = f64::from(ms) * 1e-3;
                (sample.state, sample.confidence) = (state, confidence);
                sample.latency_ms = match more {
                    [Float(ms), ..] if ms.is_finite() && *ms > 0.0 => Some(*ms),
                    _ => None,
                };
                // Of the frame before; visibility is sent on change, and not without a face.
                sample.pose = None;
                sample.seen = sample.seen.filter(|_| state.has_face());
            }
            (FROZEN, &[Int(frozen @ 0..=1)]) => user.sample.frozen = frozen == 1,
            (AU, values) if named && values.len() == count => {
                user.sample.weights = floats(values)?;
            }
            // Vectors are ignored until the schema arrives.
            (AU, values) if !named => return floats(values).map(drop),
            (POSE, values) if values.len() == 7 => {
                user.sample.pose = floats(values)?.try_into().ok();
            }
            (PRESENT, [Int(0..=1)]) => return Some(()),
            _ => return None,
        }
        user.changed[0] = true;
        Some(())
    }

    /// Processes a message about a unit or a region of a user.
    fn unit(&mut self, slot: usize, what: &str, name: &str, values: &[Argument]) -> Option<()> {
        let numbers = floats(values)?;
        if !is_name(name) {
            return None;
        }
        if what == SEEN {
            let region = VISIBLE_REGIONS.iter().position(|(one, _)| *one == name)?;
            let [share @ 0.0..=1.0] = numbers[..] else {
                return None;
            };
            let sample = &mut self.users[slot].sample;
            sample.seen.get_or_insert([1.0; REGIONS])[region] = share;
            self.users[slot].changed[0] = true;
            return Some(());
        }
        let unit = match self.units.iter().position(|unit| unit == name) {
            Some(unit) => unit,
            None if !self.named && what == AU && self.units.len() < MAX_UNITS => {
                self.units.push(name.to_owned());
                self.units.len() - 1
            }
            None => return None,
        };
        let user = &mut self.users[slot];
        match (what, &numbers[..]) {
            (AU, &[weight]) => {
                let weights = &mut user.sample.weights;
                weights.resize(weights.len().max(unit + 1), 0.0);
                weights[unit] = weight;
                user.changed[0] = true;
            }
            (RANGE, &[low, rest, high, ref ready @ ..]) if ready.len() <= 1 => {
                let ranges = &mut user.ranges;
                ranges.resize(ranges.len().max(unit + 1), None);
                ranges[unit] = Some(([low, rest, high], ready.first().copied()));
                user.changed[1] = true;
            }
            _ => return None,
        }
        Some(())
    }

    /// Applies another schema: values move from their old index to that of the same name.
    fn rename(&mut self, names: Vec<String>) {
        if names == self.units {
            return;
        }
        for user in &mut self.users {
            let old = |name: &String| self.units.iter().position(|unit| unit == name);
            let weight = |name| user.sample.weights.get(old(name)?).copied();
            let weights = names.iter().map(|name| weight(name).unwrap_or(0.0));
            let weights = weights.collect();
            let range = |name| user.ranges.get(old(name)?).copied().flatten();
            user.ranges = names.iter().map(range).collect();
            user.sample.weights = weights;
        }
        self.units = names;
    }
}

fn slot(word: &str) -> Option<usize> {
    word.parse().ok().filter(|&slot| slot < USERS)
}

/// All values as finite floats.
fn floats(values: &[Argument]) -> Option<Vec<f32>> {
    let float = |value: &Argument| match *value {
        Float(number) if number.is_finite() => Some(number),
        _ => None,
    };
    values.iter().map(float).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gesture::{Gesture, SetUpState};
    use crate::osc::packet::Packet;
    use crate::osc::{Osc, Settings};
    use crate::received::tests::Recorder;
    use crate::{Output, Report};
    use mien_stages::base::geometry::Rigid;
    use mien_stages::base::time::Timestamp;
    use mien_stages::expression::UnitRange;
    use mien_stages::landmarks::Landmarks;
    use std::net::UdpSocket;
    use std::time::Duration;

    /// The datagrams of a sender of these reports, and a receiver that has had them.
    fn received(units: &[&str], reports: &[Report]) -> (Vec<Vec<u8>>, Receiver, Recorder) {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        socket
            .set_read_timeout(Some(Duration::from_millis(200)))
            .unwrap();
        let settings = Settings {
            targets: vec![socket.local_addr().unwrap().to_string()],
            ranges: true,
            ..Settings::default()
        };
        let mut osc = Osc::new(settings, units).unwrap();
        for report in reports {
            osc.send(report).unwrap();
        }
        let (recorder, mut receiver) = (Recorder::default(), Receiver::default());
        let mut all = Vec::new();
        let mut bytes = [0; 2000];
        while let Ok(length) = socket.recv(&mut bytes) {
            receiver.take(&bytes[..length], &recorder);
            all.push(bytes[..length].to_vec());
        }
        (all, receiver, recorder)
    }

    #[test]
    fn a_set_up_comes_back_as_it_was_sent_and_nonsense_is_refused() {
        let facts = SetUpFacts {
            index: 3,
            state: SetUpState::Act,
            seen: 2,
            levels: Gesture::named("smile").levels(),
            can_undo: true,
            count: 7,
            tracked_s: 3600,
        };
        let (recorder, mut receiver) = (Recorder::default(), Receiver::default());
        let mut take = |arguments: &[Argument]| {
            let (mut packet, arguments) = (Packet::default(), arguments.iter().copied());
            assert!(packet.push("", format_args!("/mien/setup/smile"), arguments));
            receiver.take(packet.bytes(), &recorder);
        };
        take(&facts.to_osc());
        for (k, wrong) in [
            (0, Int(16)),
            (1, Int(7)),
            (3, Float(f32::NAN)),
            (8, Int(-1)),
        ] {
            let mut arguments = facts.to_osc();
            arguments[k] = wrong;
            take(&arguments);
        }
        take(&facts.to_osc()[..9]);
        assert_eq!(*recorder.set_ups.borrow(), [("smile".to_owned(), facts)]);
        assert_eq!(recorder.counts.get(), [1, 5]);
    }

    /// The datagrams of a sender that reports a face, and a receiver that has had them.
    fn sent() -> (Vec<Vec<u8>>, Receiver, Recorder) {
        let pose = Rigid::translation(0.1, 0.0, 0.7);
        let landmarks = Landmarks {
            seen: [1.0, 1.0, 0.75, 1.0, 1.0, 0.0],
            ..Landmarks::default()
        };
        let report = Report {
            at: Timestamp::from_us(1_500_000),
            user: Some(2),
            state: TrackingState::Tracking,
            confidence: 0.75,
            sensor_from_face: Some(&pose),
            landmarks: Some(&landmarks),
            weights: &[0.25, 0.5],
            ranges: &[[0.1, 0.2, 0.3], [1.0, 2.0, 3.0]].map(|[low, rest, high]| UnitRange {
                low,
                rest,
                high,
                readiness: 0.75,
                ..UnitRange::default()
            }),
            latency_us: 12_500,
            ..Report::default()
        };
        received(&["AU25", "AU26"], &[report])
    }

    #[test]
    fn messages_of_our_sender_arrive_whole() {
        let (_, _, recorder) = sent();
        assert_eq!(recorder.refused(), 0);
        assert_eq!(*recorder.units.borrow(), ["AU25", "AU26"]);
        let expected = Sample {
            user: Some(2),
            seconds: 1.5,
            state: TrackingState::Tracking,
            confidence: 0.75,
            latency_ms: Some(12_500.0 * 1e-3),
            pose: Some([0.1, 0.0, 0.7, 0.0, 0.0, 0.0, 1.0]),
            seen: Some([1.0, 1.0, 0.75, 1.0, 1.0, 0.0]),
            weights: vec![0.25, 0.5],
            ..Sample::default()
        };
        assert_eq!(recorder.last(), expected);
        let ranges = [([0.1, 0.2, 0.3], Some(0.75)), ([1.0, 2.0, 3.0], Some(0.75))];
        let ranges = ranges.map(Some).to_vec();
        assert_eq!(recorder.ranges.borrow().last(), Some(&(2, ranges)));
    }

    #[test]
    fn a_head_without_a_face_keeps_its_pose_on_the_page() {
        let (_, mut receiver, recorder) = sent();
        let refused = recorder.refused();
        let mut bytes = b"/face/2/frame\0\0\0,iiif\0\0\0".to_vec();
        bytes.extend([[0, 0, 0, 7], [0, 0, 6, 0], [0, 0, 0, 5], [0; 4]].concat());
        receiver.take(&bytes, &recorder);
        assert_eq!(recorder.refused(), refused);
        let sample = &receiver.users[2].sample;
        assert_eq!(sample.state, TrackingState::Posed);
        assert_eq!(sample.seen, None, "regions are those of a face");
        // A state that there is not.
        *bytes.iter_mut().rfind(|byte| **byte == 5).unwrap() = 6;
        receiver.take(&bytes, &recorder);
        assert_eq!(recorder.refused(), refused + 1);
    }

    #[test]
    fn frozen_state_reaches_every_page_until_the_box_changes_it() {
        let reports = [false, true, true, false].map(|frozen| Report {
            user: Some(0),
            state: TrackingState::Tracking,
            frozen,
            weights: &[0.5],
            ..Report::default()
        });
        let (_, _, recorder) = received(&["AU26"], &reports);
        assert_eq!(recorder.refused(), 0);
        let samples = recorder.samples.borrow();
        let frozen: Vec<bool> = samples.iter().map(|sample| sample.frozen).collect();
        assert_eq!(frozen, [false, true, true, false]);
    }

    #[test]
    fn a_refused_message_takes_nothing_away() {
        let (_, mut receiver, recorder) = sent();
        let before = receiver.users[2].sample.clone();
        // A frame with a number below 0.
        let mut bytes = b"/face/2/frame\0\0\0,iiif\0\0\0".to_vec();
        bytes.extend([[0xff; 4], [0; 4], [0, 0, 0, 2], [0; 4]].concat());
        receiver.take(&bytes, &recorder);
        assert_eq!(recorder.refused(), 1);
        assert_eq!(receiver.users[2].sample, before);
    }

    #[test]
    fn garbage_changes_only_the_counter() {
        let (datagrams, mut receiver, recorder) = sent();
        let before = recorder.samples.borrow().clone();
        let refused = recorder.refused();
        let mut random = fastrand::Rng::with_seed(11);
        for k in 0..10_000 {
            let length = random.usize(1..600);
            let mut bytes: Vec<u8> = (0..length).map(|_| random.u8(..)).collect();
            match k % 4 {
                0 => bytes
                    .splice(0..0, *b"#bundle\0\0\0\0\0\0\0\0\x01")
                    .for_each(drop),
                1 => bytes.splice(0..0, *b"/face/9/au\0\0,f\0\0").for_each(drop),
                // A true datagram, the schema, cut short.
                2 => {
                    let whole = &datagrams[0];
                    bytes = whole[..random.usize(17..whole.len())].to_vec();
                    bytes.truncate(bytes.len() / 4 * 4 + 1);
                }
                _ => {}
            }
            receiver.take(&bytes, &recorder);
        }
        assert_eq!(*recorder.samples.borrow(), before);
        assert_eq!(*recorder.units.borrow(), ["AU25", "AU26"]);
        assert!(recorder.refused() >= refused + 10_000);
    }
}
