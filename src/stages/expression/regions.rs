//! Which regions of the face each input and each unit needs to be seen, as sets of [`VISIBLE_REGIONS`].
//!
//! A unit needs the region where FACS describes it; the jaw and the cheeks below the eyes belong to the mouth. Brows and nostrils
//! are measured from the eye corners, so their units and inputs need the eye of their side too: behind dark glasses the raised
//! brows of a still face would read up to 0.9. The mouth's inputs need the mouth alone. Where they are measured from the eyes or
//! the nose, the distance is long, and the fit places these points from the rest of the face.

use super::features::{self, GAZE};
use super::measures::Measure;
use super::units::UnitName;
use crate::base::capacity::{INPUTS, LEARNT_MEASURES, LENGTHS, REGIONS};
use crate::face_model::scheme::{CHIN, VISIBLE_REGIONS};

/// A set of regions: bit k is region k of [`VISIBLE_REGIONS`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RegionSet(u8);

/// Both brows.
const BROWS: RegionSet = RegionSet(0b00_0011);
/// Both eyes.
const EYES: RegionSet = RegionSet(0b00_1100);
/// The nose.
const NOSE: RegionSet = RegionSet(0b01_0000);
/// The mouth with the jaw and the cheeks.
pub const MOUTH: RegionSet = RegionSet(0b10_0000);

impl RegionSet {
    /// No region.
    pub const NONE: Self = Self(0);

    const fn and(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// The side of the regions that a name's last letter says, `L` or `R`; both without one.
    fn side(self, name: &str) -> Self {
        let side = match name.as_bytes().last() {
            Some(b'L') => 0b11_0101,
            Some(b'R') => 0b11_1010,
            _ => 0b11_1111,
        };
        Self(self.0 & side)
    }

    /// Regions that a unit needs.
    pub fn of_unit(unit: &str) -> Self {
        let number = unit.trim_start_matches(|c: char| !c.is_ascii_digit());
        let number = number.trim_end_matches(|c: char| !c.is_ascii_digit());
        let regions = match number.parse::<u32>() {
            Ok(1 | 2 | 4) => BROWS.and(EYES),
            Ok(5..=7 | 43..=46 | 61..=64) => EYES,
            Ok(9) => NOSE.and(EYES),
            _ => MOUTH,
        };
        regions.side(unit)
    }

    /// Regions that an input computed from some landmarks needs; the mouth for one by depth alone.
    fn of_landmarks(landmarks: impl Iterator<Item = usize>) -> Self {
        let (mut all, mut count) = (0, 0);
        for landmark in landmarks {
            count += 1;
            if CHIN.contains(&landmark) {
                all |= MOUTH.0;
            }
            for (k, (_, points)) in VISIBLE_REGIONS.iter().enumerate() {
                all |= u8::from(points.contains(&landmark)) << k;
            }
        }
        if count == 0 || all & MOUTH.0 != 0 {
            MOUTH
        } else {
            Self(all)
        }
    }

    /// Regions that each input of the readings needs.
    pub fn of_inputs() -> [Self; INPUTS] {
        core::array::from_fn(|input| match input.checked_sub(LEARNT_MEASURES) {
            None => Self::of_landmarks(Measure::ALL[input].landmarks()),
            Some(k) if k < LENGTHS => Self::of_landmarks(features::ALL[k].landmarks()),
            Some(k) => EYES.side(GAZE[k - LENGTHS]),
        })
    }

    /// Names of the regions.
    pub fn names(self) -> impl Iterator<Item = &'static str> {
        let all = VISIBLE_REGIONS.iter().enumerate();
        all.filter_map(move |(k, (name, _))| (self.0 & (1 << k) != 0).then_some(*name))
    }

    /// Whether the sets share a region.
    pub fn intersects(self, other: Self) -> bool {
        self.0 & other.0 != 0
    }

    /// How far the least visible of the regions is seen, 0…1, of all regions' `seen`.
    pub fn seen(self, seen: &[f32; REGIONS]) -> f32 {
        let own = seen.iter().enumerate();
        let own = own.filter(|(k, _)| self.0 & (1 << k) != 0);
        own.fold(1.0, |least, (_, &seen)| least.min(seen))
    }
}

/// Regions of each of some units.
pub fn of_units<'a, const N: usize>(units: impl Iterator<Item = &'a UnitName>) -> [RegionSet; N] {
    let mut all = [RegionSet::default(); N];
    for (regions, unit) in all.iter_mut().zip(units) {
        *regions = RegionSet::of_unit(unit);
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::expression::readings::input_named;

    #[test]
    fn units_need_the_region_that_facs_names() {
        for (unit, regions) in [
            ("AU1L", &["brow_L", "eye_L"][..]),
            ("AU4R", &["brow_R", "eye_R"]),
            ("AU43L", &["eye_L"]),
            ("AU61", &["eye_L", "eye_R"]),
            ("AU9R", &["eye_R", "nose"]),
            ("AU12L", &["mouth"]),
            ("AU26", &["mouth"]),
            ("AU34R", &["mouth"]),
        ] {
            let names: Vec<&str> = RegionSet::of_unit(unit).names().collect();
            assert_eq!(names, regions, "{unit}");
        }
    }

    #[test]
    fn inputs_need_all_their_regions_but_those_of_the_mouth_the_mouth_alone() {
        let inputs = RegionSet::of_inputs();
        for (input, expected) in [
            ("jaw_drop", MOUTH),
            ("corner_L", MOUTH),
            ("cheek_R", MOUTH),
            ("brow_L", RegionSet(0b101)),
            ("brow_distance", BROWS),
            ("lid_R", RegionSet(0b1000)),
            ("nostril_L", RegionSet(0b1_0100)),
            ("nose_width", NOSE),
            ("gaze_up", EYES),
        ] {
            let input_index = input_named(input).expect("an input");
            assert_eq!(inputs[input_index], expected, "{input}");
        }
    }

    #[test]
    fn the_least_visible_region_counts() {
        let seen = [1.0, 0.3, 1.0, 0.6, 1.0, 0.0];
        assert_eq!(BROWS.seen(&seen), 0.3);
        assert_eq!(EYES.seen(&seen), 0.6);
        assert_eq!(NOSE.seen(&seen), 1.0);
        assert_eq!(RegionSet::of_unit("AU26").seen(&seen), 0.0);
    }
}
