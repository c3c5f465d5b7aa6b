//! Encodes reports as bytes for a line, one face at a time, within the line's capacity.

use core::fmt::Write;

use super::line::{self, Line};
use super::settings::{Settings, Style};
use super::{budget, cobs};
use crate::gesture::Switch;
use crate::{OneFace, OutputError, Report, SCHEMA_VERSION, TrackingState, unit_range};
use mien_stages::base::geometry::{Rigid, Vector, rotation_from_yaw_pitch_roll, yaw_pitch_roll};
use mien_stages::base::prelude::*;

/// Names of the sentences of the style `text`.
pub(super) const HEADER: &str = "AUH";
pub(super) const WEIGHTS: &str = "AU";
pub(super) const POSE: &str = "AUP";
/// The number of a confidence of 1 in the style `text`.
pub(super) const CONFIDENCE: f32 = 99.0;

/// Encodes reports as bytes for a line, one face at a time.
pub struct Encoder {
    format: Format,
    pub(super) face: OneFace,
    line: Line,
    count: u16,
    last_ms: u32,
}

impl Encoder {
    /// Chooses the units the line can carry. `units` are the names in the order of the weights.
    ///
    /// # Errors
    /// If an unknown unit is requested, or the names do not fit a line.
    pub fn new(settings: &Settings, units: &[&str]) -> Result<Self, OutputError> {
        Ok(Self::with_plan(settings, units)?.0)
    }

    /// As [`Self::new`]; also returns the plan.
    pub(super) fn with_plan(
        settings: &Settings,
        units: &[&str],
    ) -> Result<(Self, budget::Plan), OutputError> {
        let (format, plan) = plan(settings, units)?;
        let channels = settings.view.channels(units);
        let channels = plan.units.iter().map(|&unit| channels[unit]);
        let encoder = Self {
            format,
            face: OneFace::with_channels(channels.collect(), &settings.view),
            line: Line::default(),
            count: 0,
            last_ms: 0,
        };
        Ok((encoder, plan))
    }

    /// Output names of the units sent.
    pub fn units(&self) -> &[String] {
        &self.format.names
    }

    /// The header, to be sent on opening and every five seconds.
    pub fn header(&self) -> Line {
        let header = self.format.header();
        header.expect("the same names fitted before")
    }

    /// The next frame; `None` if the report is of a user that this line does not show.
    pub fn encode(&mut self, report: &Report) -> Option<&Line> {
        let state = self.face.follow(report)?;
        self.last_ms = (report.at.as_us() / 1000) as u32;
        Some(self.frame(state, report))
    }

    /// The closing frame, which reports nobody.
    pub fn neutral(&mut self) -> &Line {
        self.face.weights.reset();
        self.frame(TrackingState::Absent, &Report::default())
    }

    fn frame(&mut self, state: TrackingState, report: &Report) -> &Line {
        let present = state.is_present();
        let confidence = if present { report.confidence } else { 0.0 };
        let pose = report.pose().filter(|_| self.format.pose);
        let frame = Frame {
            count: self.count,
            ms: self.last_ms,
            state,
            confidence: unit_range(confidence),
            flags: cobs::flags(state, report),
            pose: pose.map(|pose| self.face.view.pose(pose)),
        };
        self.count = self.count.wrapping_add(1);
        self.line.clear();
        // Always fits: the names fit half a buffer, so weights and pose fit a whole one.
        let weights = self.face.weights.shown();
        self.format.write(&frame, weights, &mut self.line);
        &self.line
    }

    /// Appends the state of a gesture; nothing in the style `plot`.
    ///
    /// # Errors
    /// If there is no room.
    pub fn switch(&self, switch: &Switch<'_>, line: &mut Line) -> core::fmt::Result {
        match self.format.style {
            Style::Text => write!(line, "!{switch} {}\r\n", u8::from(switch.is_on)),
            Style::Plot => Ok(()),
            Style::Cobs => cobs::switch(switch, line),
        }
    }
}

/// Chooses units and resolution: tenths if the line carries all units at the full rate with them.
fn plan(settings: &Settings, units: &[&str]) -> Result<(Format, budget::Plan), OutputError> {
    let index = |name: &String| {
        let found = units.iter().position(|unit| unit == name);
        found.ok_or_else(|| OutputError::Unit(name.clone()))
    };
    let listed = settings.units.iter().map(index);
    let listed: Vec<usize> = listed.collect::<Result<_, _>>()?;
    let wanted = match listed.is_empty() {
        true => (0..units.len()).collect(),
        false => listed.clone(),
    };
    let format = |chosen: &[usize], tenths| Format {
        style: settings.style,
        names: settings.view.names(chosen.iter().map(|&unit| units[unit])),
        full: settings.full,
        tenths,
        pose: settings.pose,
    };
    // Names too long for a line are an error of their own.
    format(&wanted, false).header()?;
    let rank = |unit: usize| match listed.iter().position(|&listed| listed == unit) {
        Some(at) => at,
        None => budget::rank(units[unit]),
    };
    let longest = match settings.style {
        Style::Cobs if settings.pose => budget::AVR_BUFFER + cobs::POSE_BYTES,
        Style::Cobs => budget::AVR_BUFFER,
        _ => line::LARGEST,
    };
    let planned = |tenths| {
        let bytes = |chosen: &[usize]| format(chosen, tenths).bytes();
        let (baud, least) = (settings.baud, settings.min_rate_hz);
        let plan = budget::plan(baud, least, longest, wanted.clone(), rank, bytes);
        (format(&plan.units, tenths), plan)
    };
    if settings.style != Style::Cobs && settings.full < FINE {
        let fine = planned(true);
        if fine.1.left_out.is_empty() && fine.1.rate_hz >= budget::FRAMES_HZ {
            return Ok(fine);
        }
    }
    Ok(planned(false))
}

/// Longest header, bytes: leaves half of the buffer free.
const NAMES_MAX: usize = line::LARGEST / 2;
/// `full` from which whole numbers are fine enough: within 1/255 of the weight.
const FINE: u32 = 128;

/// Format of the frames.
struct Format {
    style: Style,
    /// Output names of the units sent.
    names: Box<[String]>,
    /// The number of a weight of 1 in the styles `text` and `plot`.
    full: u32,
    /// Whether numbers have tenths; a zero tenth is omitted.
    tenths: bool,
    /// Whether poses are sent.
    pose: bool,
}

/// Everything in a frame except its weights.
struct Frame {
    count: u16,
    ms: u32,
    state: TrackingState,
    confidence: f32,
    flags: u8,
    pose: Option<Rigid>,
}

impl Format {
    /// The header.
    ///
    /// # Errors
    /// If the names do not fit.
    fn header(&self) -> Result<Line, OutputError> {
        let (names, mut header) = (&self.names, Line::default());
        let bytes = names.iter().map(|name| name.len() + 5).sum::<usize>() + 64;
        let fit = bytes <= NAMES_MAX
            && match self.style {
                Style::Text => header.sentence(|line| {
                    write!(line, "{HEADER},1,{SCHEMA_VERSION}")?;
                    names.iter().try_for_each(|name| write!(line, ",{name}"))
                }),
                // No header: a plotter would take it for data.
                Style::Plot => true,
                Style::Cobs => cobs::unit_names(names, &mut header).is_ok(),
            };
        fit.then_some(header)
            .ok_or(OutputError::Names(names.len(), bytes, NAMES_MAX))
    }

    /// Appends a frame, or nothing if there is no room.
    fn write(
        &self,
        frame: &Frame,
        mut weights: impl ExactSizeIterator<Item = f32>,
        line: &mut Line,
    ) {
        let Frame { count, ms, .. } = *frame;
        match self.style {
            Style::Text => {
                line.sentence(|line| {
                    let confidence = (frame.confidence * CONFIDENCE).round();
                    let state = frame.state.code();
                    write!(line, "{WEIGHTS},{count},{ms},{state},{confidence}")?;
                    weights.try_for_each(|weight| {
                        line.write_char(',')?;
                        self.write_weight(weight, line)
                    })
                });
                if let Some(pose) = &frame.pose {
                    line.sentence(|line| write_pose(count, pose, line));
                }
            }
            Style::Plot => {
                line.all_or_nothing(|line| {
                    for (i, (name, weight)) in self.names.iter().zip(weights).enumerate() {
                        let comma = if i > 0 { "," } else { "" };
                        write!(line, "{comma}{name}:")?;
                        self.write_weight(weight, line)?;
                    }
                    line.put(b"\r\n")
                });
            }
            Style::Cobs => {
                let _ = cobs::weights(count, ms, frame.flags, frame.confidence, weights, line);
                if let Some(pose) = &frame.pose {
                    let _ = cobs::pose(count, ms, pose, line);
                }
            }
        }
    }

    fn write_weight(&self, weight: f32, line: &mut Line) -> core::fmt::Result {
        if !self.tenths {
            return write!(line, "{}", (weight * self.full as f32).round());
        }
        // NaN casts to 0.
        let tenths = (weight * (10 * self.full) as f32).round() as u32;
        match tenths % 10 {
            0 => write!(line, "{}", tenths / 10),
            tenth => write!(line, "{}.{tenth}", tenths / 10),
        }
    }

    /// Bytes of the longest frame and of the header.
    fn bytes(&self) -> (usize, usize) {
        // Millimetres and tenths of a degree have at most four digits and a sign.
        let turn = rotation_from_yaw_pitch_roll(-3.1, -1.5, -3.1);
        let far = Rigid::from_parts(Vector::repeat(-9.999).into(), turn);
        let longest = Frame {
            count: u16::MAX,
            ms: u32::MAX,
            state: TrackingState::Lost,
            confidence: 1.0,
            flags: u8::MAX,
            pose: self.pose.then_some(far),
        };
        // The weight with the longest number.
        let tenth = if self.tenths { 0.1 } else { 0.0 };
        let weight = 1.0 - tenth / self.full as f32;
        let weights = core::iter::repeat_n(weight, self.names.len());
        let mut line = Line::default();
        self.write(&longest, weights, &mut line);
        let header = self.header().map_or(0, |header| header.bytes().len());
        (line.bytes().len(), header)
    }
}

/// Writes the body of a pose sentence: position in millimetres, angles in tenths of a degree.
fn write_pose(count: u16, sensor_from_head: &Rigid, line: &mut Line) -> core::fmt::Result {
    let position = sensor_from_head.translation.vector * 1000.0;
    let (yaw, pitch, roll) = yaw_pitch_roll(&sensor_from_head.rotation);
    let angles = [yaw, pitch, roll].map(|angle| 10.0 * angle.to_degrees());
    write!(line, "{POSE},{count}")?;
    // NaN casts to 0.
    let mut numbers = position.iter().chain(&angles);
    numbers.try_for_each(|number| write!(line, ",{}", number.round() as i32))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Error of the line of a report, largest of its units.
    fn error(settings: &Settings, weights: &[f32], names: &[&str]) -> f32 {
        let mut encoder = Encoder::new(settings, names).unwrap();
        let report = Report {
            user: Some(0),
            state: TrackingState::Tracking,
            weights,
            ..Report::default()
        };
        let line = encoder.encode(&report).unwrap().bytes().to_vec();
        let text = String::from_utf8(line).unwrap();
        let (body, _) = text.split_once('*').unwrap();
        let sent = body.split(',').skip(5);
        let sent = sent.map(|word| word.parse::<f32>().unwrap() / settings.full as f32);
        let sent: Vec<f32> = sent.collect();
        assert_eq!(sent.len(), encoder.units().len());
        let chosen = encoder.units().iter().map(|unit| {
            let at = names.iter().position(|name| name == unit).unwrap();
            weights[at]
        });
        chosen
            .zip(sent)
            .map(|(weight, sent)| (weight - sent).abs())
            .fold(0.0, f32::max)
    }

    #[test]
    fn a_line_is_as_fine_as_it_is_fast() {
        let names: Vec<String> = (0..38).map(|i| format!("AU{i}")).collect();
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        let weights: Vec<f32> = (0..38).map(|i| (i as f32 * 0.618_034).fract()).collect();
        let settings = Settings::default();
        let fast = error(&settings, &weights, &names);
        assert!(fast <= 0.5e-3 + 1e-6, "{fast}");
        let slow = Settings {
            baud: 19_200,
            ..settings.clone()
        };
        let slow = error(&slow, &weights, &names);
        assert!(slow > 1.0 / 255.0 && slow <= 0.5e-2 + 1e-6, "{slow}");
        let whole = Settings {
            full: 128,
            ..settings
        };
        assert!(error(&whole, &weights, &names) <= 1.0 / 255.0);
    }

    #[test]
    fn lines_read_back_to_half_a_step_and_none_is_longer_than_the_longest() {
        let mut random = fastrand::Rng::with_seed(4);
        for _ in 0..2000 {
            let units = random.usize(1..60);
            let weights: Vec<f32> = (0..units).map(|_| random.f32()).collect();
            let full = random.u32(10..=10_000);
            let tenths = random.bool();
            let format = Format {
                style: Style::Text,
                names: vec![String::new(); units].into(),
                full,
                tenths,
                pose: false,
            };
            let frame = Frame {
                count: random.u16(..),
                ms: random.u32(..),
                state: TrackingState::Held,
                confidence: random.f32(),
                flags: 0,
                pose: None,
            };
            let mut line = Line::default();
            format.write(&frame, weights.iter().copied(), &mut line);
            let text = core::str::from_utf8(line.bytes()).unwrap();
            let (sentence, _) = text.strip_prefix("$AU,").unwrap().split_once('*').unwrap();
            let numbers: Vec<f32> = sentence
                .split(',')
                .map(|word| word.parse().unwrap())
                .collect();
            assert_eq!(numbers[..3], [frame.count.into(), frame.ms as f32, 3.0]);
            assert!((numbers[3] / 99.0 - frame.confidence).abs() <= 0.5 / 99.0 + 1e-6);
            assert_eq!(numbers.len(), 4 + units);
            for (number, weight) in numbers[4..].iter().zip(&weights) {
                let back = number / full as f32;
                let step = if tenths { 0.1 } else { 1.0 } / full as f32;
                assert!(
                    (back - weight).abs() <= 0.5 * step + 1e-6,
                    "{back} {weight}"
                );
            }
            assert!(line.bytes().len() <= format.bytes().0);
        }
    }
}
