//! How an output presents the units: names, gains, and whether left and right are mirrored.
//!
//! A gain of 1.5 on `AU26` opens every rig's jaw half as far again; a name replaces `AU26` in addresses, headers and plots.
//! Mirroring swaps left and right and reflects the head pose, for a person who looks at their own avatar. The CSV is not
//! affected.

use super::report::Report;
use mien_stages::base::capacity::REGIONS;
use mien_stages::base::geometry::{Rigid, Rotation};
use mien_stages::base::prelude::*;
use mien_stages::base::settings::keyed;
use mien_stages::expression::units::{Units, other_side};

/// Longest output name of a unit, bytes.
pub(super) const LONGEST_NAME: usize = 24;
/// Index of each of [`mien_stages::face_model::scheme::VISIBLE_REGIONS`] on the other side.
const OTHER_SIDES: [usize; REGIONS] = [1, 0, 3, 2, 4, 5];

/// Name and gain of one unit.
#[derive(Clone, Debug, PartialEq)]
pub struct UnitView {
    /// The unit's FACS name, as `AU12L`.
    pub unit: String,
    /// Its name in outputs.
    pub name: String,
    /// Factor on its weight before clamping to 0…1.
    pub gain: f32,
}

keyed! {
    /// Behaviour when a face is lost: hold the last weights, then fade to neutral.
    #[derive(Copy)]
    pub struct LossPolicy {
        /// How long the last weights of a lost face are held.
        hold_s: f32 = 0.2 => seconds(),
        /// How long they then take to fade to neutral.
        decay_s: f32 = 0.4 => seconds(),
    }
    /// How an output presents faces and units. Units that are not listed keep their name and a gain of 1. Names and gains come
    /// from the section `[units]` and are copied into every view.
    pub struct View {
        /// Whether left and right are swapped, as in a mirror.
        mirror: bool = false => Bool(),
        ..loss: LossPolicy,
        ..units: Vec<UnitView>,
    }
}

/// Source of an output weight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Channel {
    /// Index among the weights of a report.
    pub(super) source: usize,
    pub(super) gain: f32,
}

impl View {
    fn unit_view(&self, unit: &str) -> Option<&UnitView> {
        self.units.iter().find(|view| view.unit == unit)
    }

    /// The output name of a unit.
    pub fn name<'a>(&'a self, unit: &'a str) -> &'a str {
        self.unit_view(unit).map_or(unit, |view| view.name.as_str())
    }

    /// The output names of units, in their order.
    pub(super) fn names<'a>(&self, units: impl Iterator<Item = &'a str>) -> Box<[String]> {
        units.map(|unit| self.name(unit).to_owned()).collect()
    }

    /// A channel for every unit, in the order of `units`.
    pub(super) fn channels(&self, units: &[&str]) -> Box<[Channel]> {
        let source = |i: usize| {
            let opposite = Some(units[i]).filter(|_| self.mirror).and_then(other_side);
            let found = opposite.and_then(|name| units.iter().position(|unit| *unit == name));
            found.unwrap_or(i)
        };
        let channel = |i: usize| Channel {
            source: source(i),
            gain: self.unit_view(units[i]).map_or(1.0, |view| view.gain),
        };
        (0..units.len()).map(channel).collect()
    }

    /// Pose of a report, mirrored if configured: position in metres and quaternion x, y, z, w, sensor frame. `None` without a pose
    /// or if a number is not finite.
    pub(super) fn pose_numbers(&self, report: &Report) -> Option<[f32; 7]> {
        let numbers = numbers(&self.pose(report.pose()?));
        let all_finite = numbers.iter().all(|number| number.is_finite());
        all_finite.then_some(numbers)
    }

    /// Yaw, pitch and roll of the pose, mirrored if configured, radians; `None` as for [`Self::pose_numbers`].
    #[cfg(feature = "wires")]
    pub(super) fn angles(&self, report: &Report) -> Option<[f32; 3]> {
        self.pose_numbers(report)?;
        let pose = self.pose(report.pose()?);
        Some(mien_stages::base::geometry::yaw_pitch_roll(&pose.rotation).into())
    }

    /// How far each region can be seen ([`Report::seen`]), mirrored if configured.
    pub(super) fn seen(&self, report: &Report) -> Option<[f32; REGIONS]> {
        let seen = report.seen()?;
        Some(if self.mirror {
            OTHER_SIDES.map(|k| seen[k])
        } else {
            seen
        })
    }

    /// The pose, mirrored if configured.
    pub fn pose(&self, sensor_from_head: &Rigid) -> Rigid {
        if self.mirror {
            mirrored(sensor_from_head)
        } else {
            *sensor_from_head
        }
    }
}

/// A pose as position in metres and quaternion x, y, z, w.
pub fn numbers(pose: &Rigid) -> [f32; 7] {
    let (p, q) = (pose.translation.vector, pose.rotation.coords);
    [p.x, p.y, p.z, q.x, q.y, q.z, q.w]
}

/// Whether a text is a valid unit name for every output: in an OSC address, between commas, before a colon.
pub fn is_name(text: &str) -> bool {
    let plain = |c: char| c.is_ascii_graphic() && !"#*,?[]{}/:$".contains(c);
    !text.is_empty() && text.len() <= LONGEST_NAME && text.chars().all(plain)
}

/// Names of all units of both methods of learning.
pub fn all_units() -> Vec<String> {
    let table = Units::shipped();
    let mut names: Vec<String> = Vec::new();
    for name in [false, true].iter().flat_map(|&paper| table.columns(paper)) {
        if !names.iter().any(|known| *known == name.as_str()) {
            names.push(name.as_str().to_owned());
        }
    }
    names
}

/// Whether `name` is a unit.
pub(crate) fn is_unit(name: &str) -> bool {
    all_units().iter().any(|known| known == name)
}

/// Reflects a pose in the sensor's plane x = 0, for a symmetric head.
fn mirrored(pose: &Rigid) -> Rigid {
    let (p, q) = (pose.translation.vector, pose.rotation.coords);
    let rotation = nalgebra::Quaternion::new(q.w, q.x, -q.y, -q.z);
    let position = nalgebra::Translation3::new(-p.x, p.y, p.z);
    Rigid::from_parts(position, Rotation::new_unchecked(rotation))
}

#[cfg(test)]
mod tests {
    use super::*;
    use mien_stages::base::geometry::{rotation_from_yaw_pitch_roll, yaw_pitch_roll};
    use mien_stages::face_model::scheme::VISIBLE_REGIONS;

    #[test]
    fn a_mirror_swaps_the_sides_and_leaves_the_rest() {
        let view = View {
            mirror: true,
            units: vec![UnitView {
                unit: "AU12L".into(),
                name: "smile".into(),
                gain: 2.0,
            }],
            ..View::default()
        };
        let units = ["AU26", "AU12L", "AU12R", "AU9L", "AU62", "AU61", "AU63"];
        let sources: Vec<_> = view
            .channels(&units)
            .iter()
            .map(|c| (c.source, c.gain))
            .collect();
        // The gain belongs to the output unit; a unit without an opposite side is not swapped.
        let [mouth, eyes] = [
            [(0, 1.0), (2, 2.0), (1, 1.0), (3, 1.0)].as_slice(),
            &[(5, 1.0), (4, 1.0), (6, 1.0)],
        ];
        assert_eq!(sources, [mouth, eyes].concat());
        assert_eq!(units.map(|unit| view.name(unit))[1], "smile");
    }

    #[test]
    fn a_mirror_swaps_the_regions_of_the_sides() {
        let names = VISIBLE_REGIONS.map(|(name, _)| name);
        for (name, other) in names.iter().zip(OTHER_SIDES) {
            let expected = other_side(name).unwrap_or_else(|| (*name).to_owned());
            assert_eq!(names[other], expected);
        }
    }

    #[test]
    fn a_mirrored_head_turns_and_leans_the_other_way() {
        let pose = Rigid::from_parts(
            nalgebra::Vector3::new(0.1, 0.2, 0.7).into(),
            rotation_from_yaw_pitch_roll(0.3, -0.2, 0.1),
        );
        let back = mirrored(&pose);
        let (yaw, pitch, roll) = yaw_pitch_roll(&back.rotation);
        assert!(
            (yaw + 0.3).abs() < 1e-6 && (pitch + 0.2).abs() < 1e-6 && (roll + 0.1).abs() < 1e-6
        );
        assert_eq!(
            back.translation.vector,
            nalgebra::Vector3::new(-0.1, 0.2, 0.7)
        );
        assert!((mirrored(&back).to_homogeneous() - pose.to_homogeneous()).norm() < 1e-6);
    }

    #[test]
    fn names_are_such_that_every_wire_carries_them() {
        assert!(is_name("AU12L") && is_name("jaw-open_1"));
        for bad in [
            "",
            "a b",
            "a,b",
            "a/b",
            "a*",
            "ü",
            "x".repeat(25).as_str(),
            "a:b",
        ] {
            assert!(!is_name(bad), "{bad}");
        }
    }
}
