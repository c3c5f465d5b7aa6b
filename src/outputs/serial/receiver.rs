//! Receives a line in any of the three styles, distinguished by their bytes, for `mien-studio preview`.
//!
//! A text line needs a valid checksum, a binary frame a valid CRC; a plot line has neither and must consist of
//! `name:number` only. Anything else is counted. Weights of a text or plot line are numbers from 0 to `full` (100
//! unless `serial.full` of the sender differs). Memory: 4 kB.

use super::cobs;
use super::encoder::{CONFIDENCE, HEADER, POSE, WEIGHTS};
use super::line::checksum;
use crate::is_name;
use crate::received::{Receive, Sample};
use mien_stages::base::capacity::USERS;
use mien_stages::base::checksum::crc16;
use mien_stages::base::geometry::rotation_from_yaw_pitch_roll;
use mien_stages::base::prelude::*;
use mien_stages::users::TrackingState;

/// Longest line or frame, bytes.
const MAX_LINE: usize = 4096;

/// Unparsed bytes, and the state parsed so far.
pub struct Receiver {
    full: f32,
    line: Vec<u8>,
    units: Vec<String>,
    sample: Sample,
}

impl Receiver {
    /// An empty receiver.
    pub fn new(full: f32) -> Self {
        Self {
            full,
            line: Vec::new(),
            units: Vec::new(),
            sample: Sample::default(),
        }
    }

    /// Processes received bytes.
    pub fn take(&mut self, bytes: &[u8], to: &dyn Receive) {
        for &byte in bytes {
            if byte != 0 && byte != b'\n' {
                if self.line.len() < MAX_LINE {
                    self.line.push(byte);
                }
                continue;
            }
            let line = std::mem::take(&mut self.line);
            let understood = if byte == 0 {
                unstuffed(&line).and_then(|payload| self.frame(&payload, to))
            } else {
                // Bytes before it do not belong to a text line.
                let mut lines = line.rsplit(|&byte| byte == b'\n');
                let text = std::str::from_utf8(lines.next().unwrap_or_default()).ok();
                text.and_then(|text| self.text(text.trim_end_matches('\r'), to))
            };
            match understood {
                Some(()) => to.count(1, 0),
                // A line feed may be part of a binary frame: bytes are kept until the zero.
                None if byte == b'\n' && line.len() < MAX_LINE && !line.starts_with(b"$") => {
                    self.line = line;
                    self.line.push(byte);
                }
                None => to.count(0, u64::from(!line.is_empty())),
            }
        }
        if self.line.len() >= MAX_LINE {
            self.line.clear();
            to.count(0, 1);
        }
    }

    fn name(&mut self, names: Vec<String>, to: &dyn Receive) -> Option<()> {
        if !names.iter().all(|name| is_name(name)) {
            return None;
        }
        if names != self.units {
            self.units = names;
            to.schema(&self.units);
        }
        Some(())
    }

    /// Parses a line of the styles text and plot.
    fn text(&mut self, line: &str, to: &dyn Receive) -> Option<()> {
        // Bytes before a dollar are the remainder of a truncated line.
        let Some(at) = line.rfind('$') else {
            return self.plot(line, to);
        };
        let (body, sum) = line[at + 1..].split_once('*')?;
        if u8::from_str_radix(sum, 16).ok()? != checksum(body.as_bytes()) {
            return None;
        }
        let words: Vec<&str> = body.split(',').collect();
        match &words[..] {
            [HEADER, _, _, names @ ..] => {
                self.name(names.iter().map(|&name| name.to_owned()).collect(), to)
            }
            [WEIGHTS, rest @ ..] => {
                let numbers: Vec<f64> = numbers(rest)?;
                let [number, ms, state, confidence, weights @ ..] = &numbers[..] else {
                    return None;
                };
                let mut states = TrackingState::ALL.into_iter();
                let state = states.find(|known| f64::from(known.code()) == *state)?;
                self.sample.user = Some(0);
                self.sample.number = *number as u64;
                self.sample.seconds = ms * 1e-3;
                self.sample.state = state;
                self.sample.confidence = *confidence as f32 / CONFIDENCE;
                self.sample.weights = weights.iter().map(|w| *w as f32 / self.full).collect();
                self.send_sample(to);
                Some(())
            }
            [POSE, rest @ ..] => {
                let [_, x, y, z, yaw, pitch, roll] = numbers(rest)?.try_into().ok()?;
                let angle = |tenths: f64| (tenths * 0.1).to_radians() as f32;
                let turn = rotation_from_yaw_pitch_roll(angle(yaw), angle(pitch), angle(roll));
                let [i, j, k, w] = [turn.i, turn.j, turn.k, turn.w];
                let metres = |mm: f64| (mm * 1e-3) as f32;
                // Shown with the next weights, as a line has the pose after them.
                self.sample.pose = Some([metres(x), metres(y), metres(z), i, j, k, w]);
                Some(())
            }
            _ => None,
        }
    }

    fn plot(&mut self, line: &str, to: &dyn Receive) -> Option<()> {
        let mut names = Vec::new();
        let mut weights = Vec::new();
        for pair in line.split(',') {
            let (name, number) = pair.split_once(':')?;
            names.push(name.to_owned());
            let number = number.parse::<f32>().ok()?;
            weights.push((number.is_finite() && number >= 0.0).then_some(number / self.full)?);
        }
        self.name(names, to)?;
        self.sample.user = Some(0);
        self.sample.number += 1;
        // The style has no time and no state: frames come 30 times a second while a face is tracked.
        self.sample.seconds = self.sample.number as f64 / 30.0;
        (self.sample.state, self.sample.confidence) = (TrackingState::Tracking, f32::NAN);
        self.sample.weights = weights;
        self.send_sample(to);
        Some(())
    }

    /// Parses a binary frame after unstuffing.
    fn frame(&mut self, payload: &[u8], to: &dyn Receive) -> Option<()> {
        let (body, crc) = payload.split_last_chunk::<2>()?;
        if crc16(body) != u16::from_le_bytes(*crc) {
            return None;
        }
        match body {
            [
                cobs::WEIGHTS,
                number,
                low,
                high,
                flags,
                confidence,
                count,
                weights @ ..,
            ] if weights.len() == usize::from(*count) => {
                // Number and time wrap around and are continued.
                let before = self.sample.number;
                self.sample.number += u64::from(number.wrapping_sub(before as u8));
                let ms = u16::from_le_bytes([*low, *high]);
                let before = (self.sample.seconds * 1e3).round() as u64;
                let passed = ms.wrapping_sub(before as u16);
                self.sample.seconds = (before + u64::from(passed)) as f64 * 1e-3;
                self.sample.state = state(*flags);
                self.sample.frozen = flags & cobs::FROZEN != 0;
                self.sample.user = Some(usize::from(flags >> cobs::SLOT) % USERS);
                self.sample.confidence = f32::from(*confidence) / cobs::SHARE;
                self.sample.weights = weights
                    .iter()
                    .map(|&w| f32::from(w) / cobs::SHARE)
                    .collect();
                self.send_sample(to);
                Some(())
            }
            [cobs::POSE, _, _, _, numbers @ ..] if numbers.len() == 14 => {
                let at = |k: usize| {
                    let [low, high] = [numbers[2 * k], numbers[2 * k + 1]];
                    f32::from(i16::from_le_bytes([low, high]))
                };
                self.sample.pose = Some(std::array::from_fn(|k| {
                    at(k) * if k < 3 { 1e-3 } else { 1.0 / cobs::QUATERNION }
                }));
                Some(())
            }
            // Gestures reach the page by OSC.
            [cobs::GESTURE, ..] => Some(()),
            [cobs::HELLO, _, _, names @ ..] => self.name(spelt(names)?, to),
            [cobs::MORE_NAMES, _, first, names @ ..] => {
                let mut all = self.units.get(..usize::from(*first))?.to_vec();
                all.extend(spelt(names)?);
                self.name(all, to)
            }
            _ => None,
        }
    }

    fn send_sample(&mut self, to: &dyn Receive) {
        // Weights need names.
        if self.units.len() == self.sample.weights.len() {
            to.sample(&self.sample);
        }
    }
}

fn numbers(words: &[&str]) -> Option<Vec<f64>> {
    let number = |word: &&str| word.parse::<f64>().ok().filter(|number| number.is_finite());
    words.iter().map(number).collect()
}

/// Parses length-prefixed names.
fn spelt(mut bytes: &[u8]) -> Option<Vec<String>> {
    let mut names = Vec::new();
    while let Some((&length, rest)) = bytes.split_first() {
        let (name, rest) = rest.split_at_checked(length.into())?;
        names.push(String::from_utf8(name.to_vec()).ok()?);
        bytes = rest;
    }
    Some(names)
}

/// Removes the stuffing; the closing zero is already removed.
fn unstuffed(frame: &[u8]) -> Option<Vec<u8>> {
    let mut out = vec![0; frame.len()];
    let report = ::cobs::decode(frame, &mut out).ok()?;
    out.truncate(report.frame_size());
    Some(out)
}

/// The state in the flags of a binary frame. A lost face is sent as held while it fades.
fn state(flags: u8) -> TrackingState {
    let bits = flags & cobs::STATE;
    let found = TrackingState::ALL
        .into_iter()
        .find(|state| cobs::state_bits(*state) == bits);
    found.unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Report;
    use crate::received::tests::Recorder;
    use crate::serial::{Encoder, Settings, Style};
    use mien_stages::base::geometry::Rigid;
    use mien_stages::base::time::Timestamp;

    fn sentence(body: &str) -> String {
        format!("${body}*{:02X}\r\n", checksum(body.as_bytes()))
    }

    #[test]
    fn every_style_reads_back_what_its_encoder_writes() {
        let names = ["AU25", "AU26"];
        for style in [Style::Text, Style::Plot, Style::Cobs] {
            let settings = Settings {
                style,
                pose: true,
                ..Settings::default()
            };
            let mut encoder = Encoder::new(&settings, &names).unwrap();
            let (recorder, mut receiver) = (Recorder::default(), Receiver::new(100.0));
            let pose = Rigid::translation(0.1, -0.05, 0.7);
            receiver.take(encoder.header().bytes(), &recorder);
            let mut states = TrackingState::ALL;
            // Nobody comes after somebody.
            states.rotate_left(1);
            for (k, state) in states.into_iter().enumerate() {
                let report = Report {
                    at: Timestamp::from_us(33_000 * (k as u64 + 1)),
                    user: Some(0),
                    state,
                    confidence: 1.0,
                    frozen: k == 2,
                    sensor_from_face: Some(&pose),
                    weights: &[0.2, 1.0],
                    ..Report::default()
                };
                // The pose of a frame comes after its weights.
                for _ in 0..2 {
                    let line = encoder.encode(&report).unwrap();
                    receiver.take(line.bytes(), &recorder);
                }
                let read = recorder.last();
                let shown = encoder.face.weights.shown();
                for (read, sent) in read.weights.iter().zip(shown) {
                    assert!((read - sent).abs() < 0.6 / 255.0, "{style:?} {state:?}");
                }
                if style == Style::Plot {
                    continue;
                }
                let faded = style == Style::Cobs && state == TrackingState::Lost;
                let expected = if faded { TrackingState::Held } else { state };
                assert_eq!(read.state, expected, "{style:?}");
                assert_eq!(read.seconds, 33.0 * (k as f64 + 1.0) * 1e-3);
                assert_eq!(read.frozen, style == Style::Cobs && k == 2);
                if state.is_present() {
                    assert_eq!(read.confidence, 1.0);
                    let [x, y, z, .., w] = read.pose.unwrap();
                    for (read, sent) in [x, y, z, w].into_iter().zip([0.1, -0.05, 0.7, 1.0]) {
                        assert!((read - sent).abs() < 1e-6, "{style:?}: {read} for {sent}");
                    }
                }
            }
            assert_eq!(*recorder.units.borrow(), names);
            assert_eq!(recorder.refused(), 0, "{style:?}");
        }
    }

    #[test]
    fn text_lines_are_believed_with_their_checksum() {
        let (recorder, mut receiver) = (Recorder::default(), Receiver::new(100.0));
        let lines = [
            "rest of a li\r\n".to_owned(),
            sentence("AUH,1,1,AU25,AU26"),
            sentence("AUP,4,100,-50,700,0,0,0"),
            sentence("AU,4,133,2,99,25.5,50"),
            "$AU,5,166,2,99,99,99*00\r\n".to_owned(),
        ];
        receiver.take(lines.concat().as_bytes(), &recorder);
        let frame = recorder.last();
        assert_eq!(frame.weights, [0.255, 0.5]);
        assert_eq!(frame.pose, Some([0.1, -0.05, 0.7, 0.0, 0.0, 0.0, 1.0]));
        assert_eq!((frame.seconds, frame.confidence), (0.133, 1.0));
        // The rest of a line stays until it is plain that it is no frame; the false checksum is counted at once.
        assert_eq!(recorder.counts.get()[0], 3);
        assert!(recorder.refused() >= 1);
    }

    #[test]
    fn plot_lines_name_themselves() {
        let (recorder, mut receiver) = (Recorder::default(), Receiver::new(100.0));
        receiver.take(b"AU25:10,AU26:90\r\nAU25:20.5,AU26:80\r\n", &recorder);
        assert_eq!(recorder.last().weights, [0.205, 0.8]);
    }

    #[test]
    fn binary_frames_are_the_reference_frames() {
        let (recorder, mut receiver) = (Recorder::default(), Receiver::new(100.0));
        let mut hello = b"\x10\x01\x03\x04AU25\x04AU26\x03AU9".to_vec();
        hello.extend(crc16(&hello).to_le_bytes());
        // No zero inside, so that one run is all the stuffing there is.
        assert!(!hello.contains(&0));
        let mut wire = vec![hello.len() as u8 + 1];
        wire.extend(hello);
        wire.push(0);
        wire.extend([
            0x04, 1, 1, 0x21, 0x04, 1, 0xc8, 3, 0x05, 0x80, 0xff, 0x17, 0x79, 0,
        ]);
        receiver.take(&wire, &recorder);
        let frame = recorder.last();
        assert_eq!(frame.weights, [0.0, 128.0 / 255.0, 1.0]);
        assert_eq!(
            (frame.state, frame.seconds),
            (TrackingState::Tracking, 0.033)
        );
        assert_eq!(recorder.refused(), 0);
    }

    #[test]
    fn a_head_without_a_face_is_posed_in_both_styles() {
        let (recorder, mut receiver) = (Recorder::default(), Receiver::new(100.0));
        receiver.take(sentence("AUH,1,1,AU25").as_bytes(), &recorder);
        receiver.take(sentence("AU,1,33,5,50,0").as_bytes(), &recorder);
        assert_eq!(recorder.last().state, TrackingState::Posed);
        receiver.take(sentence("AU,2,66,6,50,0").as_bytes(), &recorder);
        assert_eq!(recorder.refused(), 1, "a state that there is not");
        // Flags: posed, held or fading, slot 2.
        let mut payload = vec![1, 3, 99, 0, 0b0110_1000, 128, 1, 0];
        payload.extend(crc16(&payload).to_le_bytes());
        receiver.frame(&payload, &recorder);
        let frame = recorder.last();
        assert_eq!((frame.state, frame.user), (TrackingState::Posed, Some(2)));
    }

    #[test]
    fn garbage_changes_only_the_counter() {
        let (recorder, mut receiver) = (Recorder::default(), Receiver::new(100.0));
        receiver.take(sentence("AUH,1,1,AU25").as_bytes(), &recorder);
        let mut random = fastrand::Rng::with_seed(5);
        for _ in 0..10_000 {
            let bytes: Vec<u8> = (0..random.usize(1..80)).map(|_| random.u8(..)).collect();
            receiver.take(&bytes, &recorder);
        }
        assert_eq!(*recorder.units.borrow(), ["AU25"]);
        assert!(recorder.samples.borrow().is_empty());
        assert!(recorder.refused() > 1000);
        // A receiver that has seen garbage goes on at the next whole line.
        receiver.take(
            &[b"\n\0".as_slice(), sentence("AU,1,33,2,99,70").as_bytes()].concat(),
            &recorder,
        );
        assert_eq!(recorder.last().weights, [0.7]);
    }
}
