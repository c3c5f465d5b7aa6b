//! One frame in each of the styles.

use core::fmt::Write;

use super::cobs;
use super::line::Line;
use super::settings::Style;
use crate::base::geometry::{Rigid, Vector, rotation_from_yaw_pitch_roll, yaw_pitch_roll};
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;
use crate::output::TrackingState;

/// Everything in a frame except its weights.
pub(super) struct Frame {
    pub(super) count: u16,
    /// Value of a weight of 1 in the text styles.
    pub(super) full: u32,
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
        let full = self.full as f32;
        match style {
            Style::Text => {
                line.sentence(|line| {
                    write!(
                        line,
                        "AU,{count},{ms},{},{}",
                        self.state.code(),
                        (self.confidence * 99.0).round()
                    )?;
                    weights.try_for_each(|weight| write!(line, ",{}", (weight * full).round()))
                });
                if let Some(pose) = &self.pose {
                    line.sentence(|line| write_pose(count, pose, line));
                }
            }
            Style::Plot => {
                line.all_or_nothing(|line| {
                    for (i, (name, weight)) in names.iter().zip(weights).enumerate() {
                        let comma = if i > 0 { "," } else { "" };
                        write!(line, "{comma}{name}:{}", (weight * full).round())?;
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
    pub(super) fn longest(pose: bool, full: u32) -> Self {
        // Four digits and a sign, as many as the sensor sees, and angles have as many.
        let far = || {
            let turn = rotation_from_yaw_pitch_roll(-3.1, -1.5, -3.1);
            Rigid::from_parts(Vector::repeat(-9.999).into(), turn)
        };
        Self {
            count: u16::MAX,
            full,
            ms: u32::MAX,
            state: TrackingState::Lost,
            confidence: 1.0,
            flags: u8::MAX,
            pose: pose.then(far),
        }
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
            let frame = Frame {
                count: random.u16(..),
                full,
                ms: random.u32(..),
                state: TrackingState::Held,
                confidence: random.f32(),
                flags: 0,
                pose: None,
            };
            let mut line = Line::new();
            frame.write(Style::Text, &[], weights.iter().copied(), &mut line);
            let text = core::str::from_utf8(line.bytes()).unwrap();
            let (sentence, _) = text.strip_prefix("$AU,").unwrap().split_once('*').unwrap();
            let numbers: Vec<u32> = sentence
                .split(',')
                .map(|word| word.parse().unwrap())
                .collect();
            assert_eq!(numbers[..3], [frame.count.into(), frame.ms, 3]);
            assert!((numbers[3] as f32 / 99.0 - frame.confidence).abs() <= 0.5 / 99.0 + 1e-6);
            assert_eq!(numbers.len(), 4 + units);
            for (number, weight) in numbers[4..].iter().zip(&weights) {
                let back = *number as f32 / full as f32;
                assert!(
                    (back - weight).abs() <= 0.5 / full as f32 + 1e-6,
                    "{back} {weight}"
                );
            }
            let mut longest = Line::new();
            let ones = core::iter::repeat_n(1.0, units);
            Frame::longest(false, full).write(Style::Text, &[], ones, &mut longest);
            assert!(line.bytes().len() <= longest.bytes().len());
        }
    }
}
