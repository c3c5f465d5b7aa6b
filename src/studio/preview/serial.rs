//! Receives a serial line in any of the three styles that [`mien_outputs::serial`] sends, distinguished by their
//! bytes. An absent port is retried every second.
//!
//! A text line needs a valid checksum, a binary frame a valid CRC; a plot line has neither and must consist of
//! `name:number` only. Anything else is counted. Weights of a text or plot line are numbers from 0 to `full` (100
//! unless `serial.full` of the sender differs). Memory: 4 kB.

use std::io::ErrorKind::{Interrupted, TimedOut, WouldBlock};
use std::io::Read;
use std::net::TcpStream;
use std::time::Duration;

use super::hub::Hub;
use super::sample::Sample;
use mien_outputs::is_name;
use mien_stages::base::capacity::USERS;
use mien_stages::base::checksum::crc16;
use mien_stages::base::geometry::rotation_from_yaw_pitch_roll;
use mien_stages::users::TrackingState;

const RETRY: Duration = Duration::from_secs(1);
/// Timeout of a read.
const READ_TIMEOUT: Duration = Duration::from_millis(500);

/// A serial line.
pub struct Port {
    /// A device, or `tcp:host:port`.
    pub name: String,
    /// Bits per second.
    pub baud: u32,
    /// Value of a weight of 1.
    pub full: f32,
}

fn open(port: &Port) -> std::io::Result<Box<dyn Read>> {
    if let Some(address) = port.name.strip_prefix("tcp:") {
        let stream = TcpStream::connect(address)?;
        stream.set_read_timeout(Some(READ_TIMEOUT))?;
        return Ok(Box::new(stream));
    }
    let line = serialport::new(&port.name, port.baud);
    Ok(Box::new(line.timeout(READ_TIMEOUT).open()?))
}

/// Receives until the process ends.
pub fn listen(port: &Port, hub: &Hub) {
    let mut receiver = Receiver::new(port.full);
    let mut bytes = [0; 1024];
    loop {
        match open(port) {
            Ok(mut reader) => {
                hub.note("");
                loop {
                    match reader.read(&mut bytes) {
                        // End of file: the port was unplugged.
                        Ok(0) => break,
                        Ok(length) => receiver.take(&bytes[..length], hub),
                        Err(error) => match error.kind() {
                            TimedOut | WouldBlock | Interrupted => {}
                            _ => break,
                        },
                    }
                }
                hub.note(&format!("{} was disconnected; waiting for it", port.name));
            }
            Err(error) => hub.note(&format!("waiting for {}: {error}", port.name)),
        }
        std::thread::sleep(RETRY);
    }
}

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
    pub fn take(&mut self, bytes: &[u8], hub: &Hub) {
        for &byte in bytes {
            if byte != 0 && byte != b'\n' {
                if self.line.len() < MAX_LINE {
                    self.line.push(byte);
                }
                continue;
            }
            let line = std::mem::take(&mut self.line);
            let understood = if byte == 0 {
                unstuffed(&line).and_then(|payload| self.frame(&payload, hub))
            } else {
                // Bytes before it do not belong to a text line.
                let mut lines = line.rsplit(|&byte| byte == b'\n');
                let text = std::str::from_utf8(lines.next().unwrap_or_default()).ok();
                text.and_then(|text| self.text(text.trim_end_matches('\r'), hub))
            };
            match understood {
                Some(()) => hub.count(1, 0),
                // A line feed may be part of a binary frame: bytes are kept until the zero.
                None if byte == b'\n' && line.len() < MAX_LINE && !line.starts_with(b"$") => {
                    self.line = line;
                    self.line.push(byte);
                }
                None => hub.count(0, u64::from(!line.is_empty())),
            }
        }
        if self.line.len() >= MAX_LINE {
            self.line.clear();
            hub.count(0, 1);
        }
    }

    fn name(&mut self, names: Vec<String>, hub: &Hub) -> Option<()> {
        if !names.iter().all(|name| is_name(name)) {
            return None;
        }
        if names != self.units {
            self.units = names;
            hub.schema(&self.units);
        }
        Some(())
    }

    /// Parses a line of the styles text and plot.
    fn text(&mut self, line: &str, hub: &Hub) -> Option<()> {
        // Bytes before a dollar are the remainder of a truncated line.
        let Some(at) = line.rfind('$') else {
            return self.plot(line, hub);
        };
        let (body, sum) = line[at + 1..].split_once('*')?;
        let expected = body.bytes().fold(0, |sum, byte| sum ^ byte);
        if u8::from_str_radix(sum, 16).ok()? != expected {
            return None;
        }
        let words: Vec<&str> = body.split(',').collect();
        match &words[..] {
            ["AUH", _, _, names @ ..] => {
                self.name(names.iter().map(|&name| name.to_owned()).collect(), hub)
            }
            ["AU", rest @ ..] => {
                let numbers: Vec<f64> = numbers(rest)?;
                let [number, ms, state, confidence, weights @ ..] = &numbers[..] else {
                    return None;
                };
                self.sample.user = Some(0);
                self.sample.number = *number as u64;
                self.sample.seconds = ms * 1e-3;
                self.sample.state = (0.0..=5.0).contains(state).then_some(*state as u8)?;
                self.sample.confidence = (confidence / 99.0) as f32;
                self.sample.weights = weights.iter().map(|w| *w as f32 / self.full).collect();
                self.send_sample(hub);
                Some(())
            }
            ["AUP", rest @ ..] => {
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

    fn plot(&mut self, line: &str, hub: &Hub) -> Option<()> {
        let mut names = Vec::new();
        let mut weights = Vec::new();
        for pair in line.split(',') {
            let (name, number) = pair.split_once(':')?;
            names.push(name.to_owned());
            let number = number.parse::<f32>().ok()?;
            weights.push((number.is_finite() && number >= 0.0).then_some(number / self.full)?);
        }
        self.name(names, hub)?;
        self.sample.user = Some(0);
        self.sample.number += 1;
        // The style has no time and no state: frames come 30 times a second while a face is tracked.
        self.sample.seconds = self.sample.number as f64 / 30.0;
        (self.sample.state, self.sample.confidence) = (2, f32::NAN);
        self.sample.weights = weights;
        self.send_sample(hub);
        Some(())
    }

    /// Parses a binary frame after unstuffing.
    fn frame(&mut self, payload: &[u8], hub: &Hub) -> Option<()> {
        let (body, crc) = payload.split_last_chunk::<2>()?;
        if crc16(body) != u16::from_le_bytes(*crc) {
            return None;
        }
        match body {
            [1, number, low, high, flags, confidence, count, weights @ ..]
                if weights.len() == usize::from(*count) =>
            {
                // Number and time wrap around and are continued.
                let before = self.sample.number;
                self.sample.number += u64::from(number.wrapping_sub(before as u8));
                let ms = u16::from_le_bytes([*low, *high]);
                let before = (self.sample.seconds * 1e3).round() as u64;
                let passed = ms.wrapping_sub(before as u16);
                self.sample.seconds = (before + u64::from(passed)) as f64 * 1e-3;
                self.sample.state = state(*flags).code();
                self.sample.frozen = flags & 2 != 0;
                self.sample.user = Some(usize::from(flags >> 4) % USERS);
                self.sample.confidence = f32::from(*confidence) / 255.0;
                self.sample.weights = weights.iter().map(|&w| f32::from(w) / 255.0).collect();
                self.send_sample(hub);
                Some(())
            }
            [2, _, _, _, numbers @ ..] if numbers.len() == 14 => {
                let at = |k: usize| {
                    let [low, high] = [numbers[2 * k], numbers[2 * k + 1]];
                    f32::from(i16::from_le_bytes([low, high]))
                };
                self.sample.pose = Some(std::array::from_fn(|k| {
                    at(k) * if k < 3 { 1e-3 } else { 1.0 / 32767.0 }
                }));
                Some(())
            }
            // Gestures reach the page by OSC.
            [3, ..] => Some(()),
            [16, _, _, names @ ..] => self.name(spelt(names)?, hub),
            [18, _, first, names @ ..] => {
                let mut all = self.units.get(..usize::from(*first))?.to_vec();
                all.extend(spelt(names)?);
                self.name(all, hub)
            }
            _ => None,
        }
    }

    fn send_sample(&mut self, hub: &Hub) {
        // Weights need names.
        if self.units.len() == self.sample.weights.len() {
            hub.sample(&self.sample);
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
    let report = cobs::decode(frame, &mut out).ok()?;
    out.truncate(report.frame_size());
    Some(out)
}

/// The state in the flags of a binary frame. A lost face is sent as held while it fades.
fn state(flags: u8) -> TrackingState {
    match flags & 0b100_1101 {
        1 => TrackingState::Tracking,
        4 => TrackingState::Warming,
        8 => TrackingState::Held,
        0b100_1000 => TrackingState::Posed,
        _ => TrackingState::Absent,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn last(hub: &Hub) -> serde_json::Value {
        let (lines, _) = hub.read(0, Duration::ZERO);
        let line = lines.iter().rfind(|line| line.starts_with("data")).unwrap();
        serde_json::from_str(line.strip_prefix("data: ").unwrap()).unwrap()
    }

    fn sentence(body: &str) -> String {
        let sum = body.bytes().fold(0, |sum, byte| sum ^ byte);
        format!("${body}*{sum:02X}\r\n")
    }

    #[test]
    fn text_lines_are_believed_with_their_checksum() {
        let (hub, mut receiver) = (Hub::new(true), Receiver::new(100.0));
        let lines = [
            "rest of a li\r\n".to_owned(),
            sentence("AUH,1,1,AU25,AU26"),
            sentence("AUP,4,100,-50,700,0,0,0"),
            sentence("AU,4,133,2,99,25.5,50"),
            "$AU,5,166,2,99,99,99*00\r\n".to_owned(),
        ];
        receiver.take(lines.concat().as_bytes(), &hub);
        let frame = last(&hub);
        assert_eq!(frame["w"], serde_json::json!([0.255, 0.5]));
        assert_eq!(frame["p"], serde_json::json!([0.1, -0.05, 0.7, 0, 0, 0, 1]));
        assert_eq!((&frame["t"], &frame["c"]), (&0.133.into(), &1.into()));
        // The rest of a line stays until it is plain that it is no frame; the false checksum is counted at once.
        assert_eq!(hub.counts().received, 3);
        assert!(hub.counts().refused >= 1);
    }

    #[test]
    fn plot_lines_name_themselves() {
        let (hub, mut receiver) = (Hub::new(true), Receiver::new(100.0));
        receiver.take(b"AU25:10,AU26:90\r\nAU25:20.5,AU26:80\r\n", &hub);
        assert_eq!(last(&hub)["w"], serde_json::json!([0.205, 0.8]));
    }

    #[test]
    fn binary_frames_are_the_reference_frames() {
        let (hub, mut receiver) = (Hub::new(true), Receiver::new(100.0));
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
        receiver.take(&wire, &hub);
        let frame = last(&hub);
        assert_eq!(frame["w"], serde_json::json!([0, 0.502, 1]));
        assert_eq!((&frame["s"], &frame["t"]), (&2.into(), &0.033.into()));
        assert_eq!(hub.counts().refused, 0);
    }

    #[test]
    fn a_head_without_a_face_is_posed_in_both_styles() {
        let (hub, mut receiver) = (Hub::new(true), Receiver::new(100.0));
        receiver.take(sentence("AUH,1,1,AU25").as_bytes(), &hub);
        receiver.take(sentence("AU,1,33,5,50,0").as_bytes(), &hub);
        assert_eq!(last(&hub)["s"], 5);
        receiver.take(sentence("AU,2,66,6,50,0").as_bytes(), &hub);
        assert_eq!(hub.counts().refused, 1, "a state that there is not");
        // Flags: posed, held or fading, slot 2.
        let mut payload = vec![1, 3, 99, 0, 0b0110_1000, 128, 1, 0];
        payload.extend(crc16(&payload).to_le_bytes());
        receiver.frame(&payload, &hub);
        let frame = last(&hub);
        assert_eq!((&frame["s"], &frame["u"]), (&5.into(), &2.into()));
    }

    #[test]
    fn garbage_changes_only_the_counter() {
        let (hub, mut receiver) = (Hub::new(true), Receiver::new(100.0));
        receiver.take(sentence("AUH,1,1,AU25").as_bytes(), &hub);
        let mut random = fastrand::Rng::with_seed(5);
        for _ in 0..10_000 {
            let bytes: Vec<u8> = (0..random.usize(1..80)).map(|_| random.u8(..)).collect();
            receiver.take(&bytes, &hub);
        }
        // The schema and its regions.
        assert_eq!(hub.read(0, Duration::ZERO).0.len(), 2);
        assert!(hub.counts().refused > 1000);
        // A receiver that has seen garbage goes on at the next whole line.
        receiver.take(
            &[b"\n\0".as_slice(), sentence("AU,1,33,2,99,70").as_bytes()].concat(),
            &hub,
        );
        assert_eq!(last(&hub)["w"], serde_json::json!([0.7]));
    }
}
