//! Lights and servos: a table of which unit drives which channel of which universe, sent as Art-Net ([`artnet`]) and sACN
//! ([`sacn`]). One face: the first seen, until lost.
//!
//! A row is `UNIT UNIVERSE CHANNEL [8|16] [CURVE] [MIN MAX] [hold]`: channels count from 1, 16-bit ones take two, coarse first.
//! The curve maps a weight of 0…1: `linear`, `square` (perceptually even on a lamp), `root`, or `smooth` (slow at both ends, for
//! servos). MIN and MAX are percentages of full scale; MIN above MAX inverts the channel. `hold` keeps the last value when the
//! face is lost, and on exit; otherwise it returns to MIN as on other outputs. Besides units a row may name `present` (0 or 1)
//! and the head's `yaw`, `pitch` and `roll`, −45° to 45° over the scale.
//!
//! Every universe is sent with every frame, changed or not, as receivers expect: 30 a second, where DMX carries up to 44.
//! Memory: a datagram per universe. Limits: no RDM, no ArtPoll, no universe discovery, no synchronisation.

pub mod artnet;
pub mod sacn;

use std::ops::RangeInclusive;

use super::features::LightSettings;
use super::osc::Sender;
use super::{OneFace, Output, OutputError, Report, Tally, TrackingState};
use crate::base::geometry::smoothstep;

/// Channels of a universe.
pub const CHANNELS: usize = 512;
/// Datagrams that end a stream.
const LAST: usize = 3;
/// Most universes.
const UNIVERSES: usize = 16;
/// Head angles at the ends of a channel's range, radians.
const TURN: f32 = std::f32::consts::FRAC_PI_4;

/// What a weight is on a channel.
type Curve = fn(f32) -> f32;
/// Curves by name.
const CURVES: [(&str, Curve); 4] = [
    ("linear", |weight| weight),
    ("square", |weight| weight * weight),
    ("root", f32::sqrt),
    ("smooth", |weight| smoothstep(0.0, 1.0, weight)),
];

/// A row of the table, without its unit.
#[derive(Clone, Debug)]
pub struct Row {
    universe: u16,
    /// From 1.
    channel: usize,
    wide: bool,
    curve: Curve,
    /// Shares of full scale.
    ends: [f32; 2],
    hold: bool,
}

impl Row {
    /// Parses a row and its driver: a unit, or `present`, `yaw`, `pitch`, `roll`; `None` if malformed.
    ///
    /// ```
    /// use mien::output::lights::Row;
    /// assert!(Row::read("AU26 1 17 16 smooth 10 90 hold").is_some());
    /// assert!(Row::read("AU26 1 513").is_none());
    /// ```
    #[must_use]
    pub fn read(text: &str) -> Option<(&str, Self)> {
        let mut words = text.split_whitespace().peekable();
        let unit = words.next()?;
        let universe = words.next()?.parse().ok()?;
        let channel: usize = words.next()?.parse().ok()?;
        let wide = words.next_if(|word| ["8", "16"].contains(word)) == Some("16");
        let is_named = |word: &&str| CURVES.iter().any(|(name, _)| name == word);
        let name = words.next_if(is_named).unwrap_or("linear");
        let (_, curve) = CURVES.into_iter().find(|curve| curve.0 == name)?;
        let mut ends = [0.0, 1.0];
        if words.peek().is_some_and(|word| *word != "hold") {
            for end in &mut ends {
                let percent: f32 = words.next()?.parse().ok()?;
                *end = Some(percent / 100.0).filter(|share| (0.0..=1.0).contains(share))?;
            }
        }
        let hold = words.next_if_eq(&"hold").is_some();
        let last = channel + usize::from(wide);
        let fits = channel > 0 && last <= CHANNELS && words.next().is_none();
        let row = Self {
            universe,
            channel,
            wide,
            curve,
            ends,
            hold,
        };
        fits.then_some((unit, row))
    }

    /// The channel value for 0…1: 8 bits, or 16.
    fn value(&self, weight: f32) -> u16 {
        let [low, high] = self.ends;
        let share = low + (high - low) * (self.curve)(weight);
        let full = if self.wide { u16::MAX } else { u8::MAX.into() };
        (share * f32::from(full)).round() as u16
    }
}

/// What drives a channel.
#[derive(Clone, Copy, Debug)]
enum Driver {
    /// Index of the weight.
    Unit(usize),
    Present,
    /// Index among yaw, pitch, roll.
    Turn(usize),
}

impl Driver {
    /// By its name in a row; `None` if there is no such unit.
    fn named(name: &str, units: &[&str]) -> Option<Self> {
        Some(match name {
            "present" => Self::Present,
            "yaw" => Self::Turn(0),
            "pitch" => Self::Turn(1),
            "roll" => Self::Turn(2),
            unit => Self::Unit(units.iter().position(|known| *known == unit)?),
        })
    }
}

/// What differs between the protocols.
struct Protocol {
    /// The section of the configuration.
    name: &'static str,
    /// Universes, in numbers and words.
    universes: RangeInclusive<u16>,
    expected: &'static str,
    /// Which byte of a datagram counts, and its first value.
    number_at: usize,
    first: u8,
    /// Which byte has which value in the last datagrams, if a stream has an end.
    end: Option<(usize, u8)>,
}

/// A sender.
pub struct Lights {
    protocol: Protocol,
    desk: Desk,
    /// One per universe, or one for all.
    to: Box<[Sender]>,
    number: u8,
}

impl Lights {
    /// `header` is what stands before a universe's values; `open` opens the sockets for universes.
    fn new(
        protocol: Protocol,
        settings: &LightSettings,
        units: &[&str],
        header: impl Fn(u16) -> Vec<u8>,
        open: impl FnOnce(&[u16]) -> Result<Box<[Sender]>, OutputError>,
    ) -> Result<Self, OutputError> {
        let desk = Desk::new(settings, units, &protocol, header)?;
        let universes: Vec<u16> = desk.universes.iter().map(|(number, _)| *number).collect();
        Ok(Self {
            to: open(&universes)?,
            number: protocol.first,
            desk,
            protocol,
        })
    }

    fn send_all(&mut self) {
        for (at, (_, datagram)) in self.desk.universes.iter_mut().enumerate() {
            datagram[self.protocol.number_at] = self.number;
            let which = at.min(self.to.len() - 1);
            self.to[which].send(datagram);
        }
        let next = self.number.checked_add(1);
        self.number = next.unwrap_or(self.protocol.first);
    }
}

impl Output for Lights {
    fn send(&mut self, report: &Report) -> Result<(), OutputError> {
        if self.desk.observe(report) {
            self.send_all();
        }
        Ok(())
    }

    fn tally(&self) -> Tally {
        let mut all = Tally::of(self.protocol.name);
        all.not_numbers = self.desk.face.weights.not_numbers;
        for one in self.to.iter().map(|one| one.tally(all.name, 0)) {
            (all.sent, all.dropped) = (all.sent + one.sent, all.dropped + one.dropped);
        }
        all
    }
}

impl Drop for Lights {
    /// Nobody, then the end of the stream.
    fn drop(&mut self) {
        if !self.to.iter().any(Sender::is_used) {
            return;
        }
        self.desk.neutral();
        self.send_all();
        if let Some((at, ended)) = self.protocol.end {
            for (_, datagram) in &mut self.desk.universes {
                datagram[at] = ended;
            }
            (0..LAST).for_each(|_| self.send_all());
        }
    }
}

/// The table with its current values.
struct Desk {
    face: OneFace,
    channels: Box<[Channel]>,
    /// Numbers and datagrams, which end with the values.
    universes: Box<[(u16, Vec<u8>)]>,
    /// Yaw, pitch and roll, 0…1.
    turn: [f32; 3],
}

struct Channel {
    driver: Driver,
    row: Row,
    /// Index of the universe.
    at: usize,
}

impl Desk {
    fn new(
        settings: &LightSettings,
        units: &[&str],
        protocol: &Protocol,
        header: impl Fn(u16) -> Vec<u8>,
    ) -> Result<Self, OutputError> {
        let refuse = |row: &str, expected| OutputError::Channel(row.to_owned(), expected);
        let mut universes: Vec<(u16, Vec<u8>)> = Vec::new();
        let mut taken: Vec<[bool; CHANNELS]> = Vec::new();
        let mut channels = Vec::new();
        for text in &settings.channels {
            let form = "UNIT UNIVERSE CHANNEL [8|16] [CURVE] [MIN MAX] [hold]";
            let (unit, row) = Row::read(text).ok_or_else(|| refuse(text, form))?;
            let driver = Driver::named(unit, units)
                .ok_or_else(|| refuse(text, "a unit that is measured with these settings"))?;
            if !protocol.universes.contains(&row.universe) {
                return Err(refuse(text, protocol.expected));
            }
            let known = universes.iter().position(|known| known.0 == row.universe);
            let at = known.unwrap_or(universes.len());
            if at == UNIVERSES {
                return Err(refuse(text, "at most 16 universes"));
            }
            if known.is_none() {
                let mut datagram = header(row.universe);
                datagram.resize(datagram.len() + CHANNELS, 0);
                universes.push((row.universe, datagram));
                taken.push([false; CHANNELS]);
            }
            for slot in &mut taken[at][row.channel - 1..row.channel + usize::from(row.wide)] {
                if std::mem::replace(slot, true) {
                    return Err(refuse(text, "a channel that no row above uses"));
                }
            }
            channels.push(Channel { driver, row, at });
        }
        let mut desk = Self {
            face: OneFace::new(units, &settings.view),
            channels: channels.into(),
            universes: universes.into(),
            turn: [0.5; 3],
        };
        desk.set(false, false);
        Ok(desk)
    }

    /// Takes a report; whether its face is the one shown.
    fn observe(&mut self, report: &Report) -> bool {
        let Some(state) = self.face.follow(report) else {
            return false;
        };
        let present = state.is_present();
        if let Some(angles) = self.face.view.angles(report) {
            self.turn = angles.map(|angle| super::unit_range(0.5 + 0.5 * angle / TURN));
        }
        self.set(present, state != TrackingState::Absent);
        true
    }

    /// Nobody, for the end.
    fn neutral(&mut self) {
        self.face.weights.reset();
        self.set(false, false);
    }

    /// Computes the channels. Without a head, the angles are 0 unless held.
    fn set(&mut self, present: bool, known: bool) {
        for Channel { driver, row, at } in &self.channels {
            let weights = &self.face.weights;
            let weight = match *driver {
                Driver::Unit(unit) if row.hold => weights.kept(unit),
                Driver::Unit(unit) => weights.shown().nth(unit).unwrap_or(0.0),
                Driver::Present if row.hold => f32::from(u8::from(present || known)),
                Driver::Present => f32::from(u8::from(present)),
                Driver::Turn(axis) if present || row.hold => self.turn[axis],
                Driver::Turn(_) => 0.5,
            };
            let value = row.value(weight).to_be_bytes();
            // Coarse and fine, or the lower byte alone.
            let bytes = &value[usize::from(!row.wide)..];
            let datagram = &mut self.universes[*at].1;
            let start = datagram.len() - CHANNELS + row.channel - 1;
            datagram[start..][..bytes.len()].copy_from_slice(bytes);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::time::Timestamp;

    fn desk(rows: &[&str]) -> Result<Desk, OutputError> {
        let settings = LightSettings {
            channels: rows.iter().map(|&row| row.to_owned()).collect(),
            ..LightSettings::default()
        };
        let protocol = Protocol {
            name: "",
            universes: 1..=63_999,
            expected: "an sACN universe, 1 to 63999",
            number_at: 0,
            first: 0,
            end: None,
        };
        Desk::new(&settings, &["AU26", "AU12L"], &protocol, |_| Vec::new())
    }

    #[test]
    fn rows_are_read_in_every_short_form_and_nothing_else_is() {
        let (_, row) = Row::read("AU26 3 511 16 smooth 90 10 hold").unwrap();
        assert_eq!((row.universe, row.channel, row.wide), (3, 511, true));
        assert_eq!(
            ((row.curve)(0.25), row.ends, row.hold),
            (0.15625, [0.9, 0.1], true)
        );
        let (_, row) = Row::read("AU26 1 1 hold").unwrap();
        assert_eq!(
            ((row.curve)(0.25), row.ends, row.hold),
            (0.25, [0.0, 1.0], true)
        );
        assert_eq!((Row::read("AU26 1 1 root").unwrap().1.curve)(0.25), 0.5);
        assert_eq!(Row::read("AU26 1 1 5 50").unwrap().1.ends, [0.05, 0.5]);
        for bad in [
            "",
            "AU26",
            "AU26 1",
            "AU26 1 0",
            "AU26 1 513",
            "AU26 1 512 16",
            "AU26 -1 1",
            "AU26 1 1 9",
            "AU26 1 1 8 wave",
            "AU26 1 1 8 linear 0",
            "AU26 1 1 0 101",
            "AU26 1 1 nan 1",
            "AU26 1 1 hold 8",
            "AU26 99999 1",
        ] {
            assert!(Row::read(bad).is_none(), "{bad:?}");
        }
    }

    #[test]
    fn tables_that_contradict_themselves_are_refused_with_one_sentence() {
        for (rows, part) in [
            (
                &["AU26 1 5 16", "AU12L 1 6"][..],
                "\"AU12L 1 6\", expected a channel that no row above uses",
            ),
            (&["AU99 1 5"], "expected a unit that is measured"),
            (&["AU26 0 5"], "an sACN universe, 1 to 63999"),
        ] {
            let told = desk(rows).err().unwrap().to_string();
            assert!(told.contains(part), "{told}");
        }
        let many: Vec<String> = (1..18)
            .map(|universe| format!("AU26 {universe} 1"))
            .collect();
        let many: Vec<&str> = many.iter().map(String::as_str).collect();
        assert!(desk(&many).is_err() && desk(&many[..16]).is_ok());
    }

    #[test]
    fn channels_are_what_the_table_says_of_each_weight() {
        let mut desk = desk(&[
            "AU26 1 1",
            "AU26 1 2 16",
            "AU26 1 4 8 square",
            "AU26 1 5 8 linear 100 20",
            "AU12L 2 512 8 root hold",
            "present 1 6",
            "yaw 1 7 16",
            "AU12L 1 9 smooth 10 90",
        ])
        .unwrap();
        assert_eq!(desk.universes[0].1[..6], [0, 0, 0, 0, 255, 0]);
        let turned = crate::base::geometry::Rigid::from_parts(
            nalgebra::Translation3::identity(),
            crate::base::geometry::rotation_from_yaw_pitch_roll(TURN / 2.0, 0.0, 0.0),
        );
        let mut report = Report {
            user: Some(0),
            state: TrackingState::Tracking,
            weights: &[0.5, 0.25],
            sensor_from_face: Some(&turned),
            ..Report::default()
        };
        assert!(desk.observe(&report));
        let [one, two] = [0, 1].map(|at| desk.universes[at].1.clone());
        // 0.5 of 255 and of 65535, 0.25 of 255, 100 to 20 percent halfway.
        assert_eq!(one[..6], [128, 128, 0, 64, 153, 255]);
        let yaw = f32::from(u16::from_be_bytes([one[6], one[7]])) / 65535.0;
        assert!((yaw - 0.75).abs() < 1e-4, "{yaw}");
        // 10 % and 80 % of 0.15625.
        assert_eq!(one[8], (255.0_f32 * 0.225).round() as u8);
        assert_eq!((desk.universes[1].0, two[511]), (2, 128));
        // Lost for long: back to the ends, but what is to be held.
        (report.state, report.weights, report.sensor_from_face) = (TrackingState::Lost, &[], None);
        report.at = Timestamp::from_us(9_000_000);
        assert!(desk.observe(&report));
        assert_eq!(desk.universes[0].1[..6], [0, 0, 0, 0, 255, 0]);
        assert_eq!(desk.universes[0].1[6..9], [128, 0, 26]);
        assert_eq!(desk.universes[1].1[511], 128);
        desk.neutral();
        assert_eq!(desk.universes[1].1[511], 128);
        // Somebody else's report changes nothing.
        report.aside = true;
        report.user = Some(1);
        assert!(!desk.observe(&report));
    }
}
