//! One frame in each of the styles.

use core::fmt::Write;

use super::cobs;
use super::line::Line;
use super::settings::Style;
use crate::base::geometry::{Rigid, Vector, rotation_from_yaw_pitch_roll, yaw_pitch_roll};
use crate::base::prelude::*;
use crate::output::TrackingState;

/// How a weight is written in the styles `text` and `plot`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Scale {
    /// The number of a weight of 1.
    pub(super) full: u32,
    /// Whether there are tenths; a number that needs none has none.
    pub(super) tenths: bool,
}

impl Scale {
    /// `full` from which whole numbers are within 1/255 of the weight.
    pub(super) const FINE: u32 = 128;

    fn write(self, weight: f32, line: &mut Line) -> core::fmt::Result {
        if !self.tenths {
            return write!(line, "{}", (weight * self.full as f32).round());
        }
        // A cast of what is not a number gives 0.
        let tenths = (weight * (10 * self.full) as f32).round() as u32;
        match tenths % 10 {
            0 => write!(line, "{}", tenths / 10),
            tenth => write!(line, "{}.{tenth}", tenths / 10),
        }
    }

    /// The weight with the longest number.
    pub(super) fn longest(self) -> f32 {
        if self.tenths {
            1.0 - 0.1 / self.full as f32
        } else {
            1.0
        }
    }
}

/// Everything in a frame except its weights.
pub(super) struct Frame {
    pub(super) count: u16,
    /// How a weight is written in the styles `text` and `plot`.
    pub(super) scale: Scale,
    pub(super) ms: u32,
    pub(super) state: TrackingState,
    pub(super) confidence: f32,
    pub(super) flags: u8,
    pub(super) pose: Option<Rigid>,
}

impl Frame {
    /// Appends the frame in a style; nothing, if there is no room.
    pub(super) fn write(
        &self,
        style: Style,
        names: &[String],
        mut weights: impl ExactSizeIterator<Item = f32>,
        line: &mut Line,
    ) {
        let (count, ms) = (self.count, self.ms);
        match style {
            Style::Text => {
                line.sentence(|line| {
                    write!(
                        line,
                        "AU,{count},{ms},{},{}",
                        self.state.code(),
                        (self.confidence * 99.0).round()
                    )?;
                    weights.try_for_each(|weight| {
                        line.write_char(',')?;
                        self.scale.write(weight, line)
                    })
                });
                if let Some(pose) = &self.pose {
                    line.sentence(|line| write_pose(count, pose, line));
                }
            }
            Style::Plot => {
                line.all_or_nothing(|line| {
                    for (i, (name, weight)) in names.iter().zip(weights).enumerate() {
                        let comma = if i > 0 { "," } else { "" };
                        write!(line, "{comma}{name}:")?;
                        self.scale.write(weight, line)?;
                    }
                    line.put(b"\r\n")
                });
            }
            Style::Cobs => {
                cobs::weights(count, ms, self.flags, self.confidence, weights, line);
                if let Some(pose) = &self.pose {
                    cobs::pose(count, ms, pose, line);
                }
            }
        }
    }

    /// The longest there is.
    pub(super) fn longest(pose: bool, scale: Scale) -> Self {
        // Four digits and a sign, as many as the sensor sees, and angles have as many.
        let far = || {
            let turn = rotation_from_yaw_pitch_roll(-3.1, -1.5, -3.1);
            Rigid::from_parts(Vector::repeat(-9.999).into(), turn)
        };
        Self {
            count: u16::MAX,
            scale,
            ms: u32::MAX,
            state: TrackingState::Lost,
            confidence: 1.0,
            flags: u8::MAX,
            pose: pose.then(far),
        }
    }
}

/// Appends that a gesture is on or off, if the style has that.
#[cfg(feature = "wires")]
pub(super) fn switch(
    style: Style,
    switch: &crate::output::gesture::Switch<'_>,
    line: &mut Line,
) -> core::fmt::Result {
    match style {
        Style::Text => write!(line, "!{switch} {}\r\n", u8::from(switch.is_on)),
        Style::Plot => Ok(()),
        Style::Cobs => cobs::switch(switch, line),
    }
}

/// Place in millimetres, angles in tenths of a degree.
fn write_pose(count: u16, sensor_from_head: &Rigid, line: &mut Line) -> core::fmt::Result {
    let place = sensor_from_head.translation.vector * 1000.0;
    let (yaw, pitch, roll) = yaw_pitch_roll(&sensor_from_head.rotation);
    let angles = [yaw, pitch, roll].map(|angle| 10.0 * angle.to_degrees());
    write!(line, "AUP,{count}")?;
    // A cast of what is not a number gives 0.
    let mut numbers = place.iter().chain(&angles);
    numbers.try_for_each(|number| write!(line, ",{}", number.round() as i32))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_read_back_to_half_a_step_and_none_is_longer_than_the_longest() {
        let mut random = fastrand::Rng::with_seed(4);
        for _ in 0..2000 {
            let units = random.usize(1..60);
            let weights: Vec<f32> = (0..units).map(|_| random.f32()).collect();
            let full = random.u32(10..=10_000);
            let tenths = random.bool();
            let scale = Scale { full, tenths };
            let frame = Frame {
                count: random.u16(..),
                scale,
                ms: random.u32(..),
                state: TrackingState::Held,
                confidence: random.f32(),
                flags: 0,
                pose: None,
            };
            let mut line = Line::default();
            frame.write(Style::Text, &[], weights.iter().copied(), &mut line);
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
            let mut longest = Line::default();
            let most = core::iter::repeat_n(scale.longest(), units);
            Frame::longest(false, scale).write(Style::Text, &[], most, &mut longest);
            assert!(line.bytes().len() <= longest.bytes().len());
        }
    }
}
