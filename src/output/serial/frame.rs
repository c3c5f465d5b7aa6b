//! One frame in each of the styles.

use std::fmt::Write;

use super::line::Line;
use super::{Style, cobs};
use crate::geometry::{Rigid, Vector, rotation_from_yaw_pitch_roll, yaw_pitch_roll};
use crate::output::TrackingState;

/// What a frame says besides its weights.
pub(super) struct Frame {
    pub(super) count: u16,
    /// What a weight of 1 is in the styles of whole numbers.
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
fn write_pose(count: u16, sensor_from_head: &Rigid, line: &mut Line) -> std::fmt::Result {
    let place = sensor_from_head.translation.vector * 1000.0;
    let (yaw, pitch, roll) = yaw_pitch_roll(&sensor_from_head.rotation);
    let angles = [yaw, pitch, roll].map(|angle| 10.0 * angle.to_degrees());
    write!(line, "AUP,{count}")?;
    // A cast of what is not a number gives 0.
    let mut numbers = place.iter().chain(&angles);
    numbers.try_for_each(|number| write!(line, ",{}", number.round() as i32))
}
