//! Landmarks to geometric measures: the distances and height differences of paper section 2.1, in the head frame.
//!
//! Method: Jiang Na et al., *Unsupervised real-time facial animation generation using geometric measurements*, section
//! 2.1. Rigid motion is already removed from the landmarks, so "height" is along the head's y and "forward" along its −z, in
//! any head pose.
//!
//! Scale: g' = g / w with w the distance of the inner eye corners. [`Scale::Frame`] divides by the frame's own w, as the
//! paper says. But w is a constant of the person, and the jitter of its two landmarks enters every large measure (a jaw
//! drop of 3 w moves by three times the relative error of w); [`Scale::Learnt`] therefore divides by a running robust
//! estimate, [`EyeDistance`].
//!
//! Units: [`raw`] gives metres; after [`scaled`] everything is in units of w except the eye distance itself, which stays
//! in metres. Cost: some hundred additions a frame, no memory. Degenerate: coinciding eye corners (w ≈ 0) give no measures.
//! Limitation: the brow is measured from the middle of the eye-corner line, so a roll of the head frame does not affect it, but
//! half of an error in one corner does.

use serde::Deserialize;

use crate::base::capacity::{LANDMARKS, MEASURES};
use crate::base::geometry::Point;
use crate::base::prelude::*;
use crate::face_model::refinement::PUFFS;
use crate::face_model::scheme::{
    CHIN, EYE_CORNERS_L, EYE_CORNERS_R, INNER_BROW_L, INNER_BROW_R, INNER_EYE_CORNERS, LOWER_LID_L,
    LOWER_LID_R, LOWER_LIP, LOWER_LIP_INSIDE, MOUTH_CORNER_L, MOUTH_CORNER_R, NOSE_BASE, NOSTRIL_L,
    NOSTRIL_R, UPPER_LID_L, UPPER_LID_R, UPPER_LIP, UPPER_LIP_INSIDE,
};
use crate::landmarks::Landmarks;

macro_rules! measures {
    ($($(#[$about:meta])* $measure:ident $name:literal [$($group:expr),*],)*) => {
        /// The measures in the order of all arrays and columns.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Deserialize)]
        #[serde(try_from = "String")]
        #[repr(usize)]
        pub enum Measure {
            $($(#[$about])* $measure,)*
        }

        impl Measure {
            /// All measures, in order.
            pub const ALL: [Self; MEASURES] = [$(Self::$measure),*];
        }

        /// Name and groups of landmarks of each measure. Without a formula in [`with_cheeks`], a measure is the height of the
        /// second group below the first.
        const TABLE: [(&str, &[&[usize]]); MEASURES] = [$(($name, &[$($group),*])),*];
    };
}

measures! {
    /// Height of the lower lip's inner edge, mean(65, 66, 67), below the upper one's, mean(61, 62, 63).
    LipGap "lip_gap" [&UPPER_LIP_INSIDE, &LOWER_LIP_INSIDE],
    /// Distance of the mouth corners 48 and 54.
    MouthWidth "mouth_width" [&[MOUTH_CORNER_R], &[MOUTH_CORNER_L]],
    /// Lower-lip middle minus upper-lip middle, towards the subject's left.
    LipShift "lip_shift" [&UPPER_LIP, &LOWER_LIP],
    /// Lower-lip middle minus upper-lip middle, towards the camera.
    LipThrust "lip_thrust" [&UPPER_LIP, &LOWER_LIP],
    /// Both lip middles forward of the inner eye corners.
    LipProtrusion "lip_protrusion" [&UPPER_LIP, &LOWER_LIP, &INNER_EYE_CORNERS],
    /// Height of the left brow (22–26) above the middle of the eye-corner line (42, 45).
    BrowL "brow_L" [&LEFT_BROW, &EYE_CORNERS_L],
    /// Height of the right brow (17–21) above the middle of the eye-corner line (36, 39).
    BrowR "brow_R" [&RIGHT_BROW, &EYE_CORNERS_R],
    /// Height of the left lower lid (46, 47) below the upper one (43, 44).
    LidL "lid_L" [&UPPER_LID_L, &LOWER_LID_L],
    /// Height of the right lower lid (40, 41) below the upper one (37, 38).
    LidR "lid_R" [&UPPER_LID_R, &LOWER_LID_R],
    /// Height of the left nostril (34, 35) below the left inner eye corner (42).
    NostrilL "nostril_L" [&[INNER_EYE_L], &NOSTRIL_L],
    /// Height of the right nostril (31, 32) below the right inner eye corner (39).
    NostrilR "nostril_R" [&[INNER_EYE_R], &NOSTRIL_R],
    /// Height of the chin (7–9) below the inner eye corners.
    JawDrop "jaw_drop" [&INNER_EYE_CORNERS, &CHIN],
    /// Height of the left mouth corner (54) above the base of the nose (33).
    CornerL "corner_L" [&[MOUTH_CORNER_L], &[NOSE_BASE]],
    /// Height of the right mouth corner (48) above the base of the nose.
    CornerR "corner_R" [&[MOUTH_CORNER_R], &[NOSE_BASE]],
    /// Height of the left brow's inner end (22, 23) above the middle of the eye-corner line (42, 45).
    InnerBrowL "inner_brow_L" [&INNER_BROW_L, &EYE_CORNERS_L],
    /// Height of the right brow's inner end (20, 21) above the middle of the eye-corner line (36, 39).
    InnerBrowR "inner_brow_R" [&INNER_BROW_R, &EYE_CORNERS_R],
    /// Height of the upper lip's left edge (52, 53) below the base of the nose (33, 34).
    UpperLipL "upper_lip_L" [&BESIDE_NOSE_BASE_L, &UPPER_LIP_L],
    /// Height of the upper lip's right edge (49, 50) below the base of the nose (32, 33).
    UpperLipR "upper_lip_R" [&BESIDE_NOSE_BASE_R, &UPPER_LIP_R],
    /// How far the left cheek is puffed out, measured by depth.
    CheekL "cheek_L" [],
    /// How far the right cheek is puffed out, measured by depth.
    CheekR "cheek_R" [],
    /// Distance of the inner eye corners, in metres even after scaling.
    EyeDistance "eye_distance" [&INNER_EYE_CORNERS],
}

impl Measure {
    /// Column name without the leading `m_`.
    pub const fn name(self) -> &'static str {
        TABLE[self as usize].0
    }

    /// The measure with that name.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|measure| measure.name() == name)
    }

    /// Groups of landmarks it is computed from; empty for measures by depth.
    pub const fn groups(self) -> &'static [&'static [usize]] {
        TABLE[self as usize].1
    }

    /// Landmarks it is computed from.
    pub fn landmarks(self) -> impl Iterator<Item = usize> {
        self.groups().iter().copied().flatten().copied()
    }
}

impl TryFrom<String> for Measure {
    type Error = &'static str;

    fn try_from(name: String) -> Result<Self, Self::Error> {
        let learnt = Self::named(&name).filter(|measure| *measure != Self::EyeDistance);
        learnt.ok_or("expected a measure such as lip_gap")
    }
}

/// Which eye-corner distance the measures are divided by.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Scale {
    /// [`Scale::Frame`] for the paper's method, [`Scale::Learnt`] for the robust one.
    #[default]
    ByMethod,
    /// The frame's, g' = g / w, as in the paper.
    Frame,
    /// The person's, [`EyeDistance`].
    Learnt,
}

/// Mean of some landmarks.
pub(super) fn mean(points: &[Point; LANDMARKS], indices: &[usize]) -> Point {
    let sum = indices
        .iter()
        .fold(nalgebra::Vector3::zeros(), |sum, &i| sum + points[i].coords);
    Point::from(sum / indices.len() as f32)
}

/// Left brow.
const LEFT_BROW: [usize; 5] = [22, 23, 24, 25, 26];
/// Right brow.
const RIGHT_BROW: [usize; 5] = [17, 18, 19, 20, 21];
const INNER_EYE_R: usize = INNER_EYE_CORNERS[0];
const INNER_EYE_L: usize = INNER_EYE_CORNERS[1];
/// Left outer edge of the upper lip.
const UPPER_LIP_L: [usize; 2] = [52, 53];
/// Right outer edge of the upper lip.
const UPPER_LIP_R: [usize; 2] = [49, 50];
/// Base of the nose above the lip's left edge.
const BESIDE_NOSE_BASE_L: [usize; 2] = [33, 34];
/// Base of the nose above the lip's right edge.
const BESIDE_NOSE_BASE_R: [usize; 2] = [32, 33];

/// Motion of a cheek by a full puff, metres.
const PUFF_M: f32 = 0.01;

/// All measures in metres, from landmarks in the head frame, with the cheeks at 0.
pub fn raw(points: &[Point; LANDMARKS]) -> [f32; MEASURES] {
    with_cheeks(points, [0.0; PUFFS])
}

/// All measures in metres, from landmarks in the head frame and the puff of the right and the left cheek
/// ([`Landmarks::cheeks`]).
pub fn with_cheeks(points: &[Point; LANDMARKS], cheeks: [f32; PUFFS]) -> [f32; MEASURES] {
    let upper_lip = mean(points, &UPPER_LIP);
    let lower_lip = mean(points, &LOWER_LIP);
    let eyes = mean(points, &INNER_EYE_CORNERS);
    let lips = nalgebra::center(&upper_lip, &lower_lip);
    Measure::ALL.map(|measure| match measure {
        Measure::MouthWidth => nalgebra::distance(&points[MOUTH_CORNER_R], &points[MOUTH_CORNER_L]),
        Measure::LipShift => lower_lip.x - upper_lip.x,
        Measure::LipThrust => upper_lip.z - lower_lip.z,
        Measure::LipProtrusion => eyes.z - lips.z,
        Measure::CheekR => PUFF_M * cheeks[0],
        Measure::CheekL => PUFF_M * cheeks[1],
        Measure::EyeDistance => nalgebra::distance(&points[INNER_EYE_R], &points[INNER_EYE_L]),
        height => {
            let [above, below] = [0, 1].map(|k| mean(points, height.groups()[k]));
            below.y - above.y
        }
    })
}

/// g' = g / w for all except the eye distance, which stays in metres; `w` > 0 in metres.
pub fn scaled(raw: &[f32; MEASURES], w: f32) -> [f32; MEASURES] {
    let mut scaled = raw.map(|g| g / w);
    scaled[Measure::EyeDistance as usize] = raw[Measure::EyeDistance as usize];
    scaled
}

/// Mean confidence of a measure's landmarks, 0…1.
pub fn confidence(measure: Measure, landmarks: &Landmarks) -> f32 {
    mean_confidence(measure.landmarks(), landmarks)
}

/// Mean confidence of some landmarks, 0…1; the face's if there are none.
pub(super) fn mean_confidence(indices: impl Iterator<Item = usize>, landmarks: &Landmarks) -> f32 {
    let points = indices.map(|i| landmarks.point_confidence[i]);
    let (sum, count) = points.fold((0.0, 0.0), |(sum, n), c| (sum + c, n + 1.0));
    if count > 0.0 {
        sum / count
    } else {
        landmarks.confidence
    }
}

/// Plausible eye-corner distances, metres: adults and children span 0.022 to 0.045.
const PLAUSIBLE_M: core::ops::Range<f64> = 0.015..0.06;
/// Limit of an innovation, as a share of the estimate.
const CLIP: f64 = 0.06;
/// Weight of the population's mean, seconds: people differ by ten times the noise of one frame.
const PRIOR_S: f64 = 0.0005;
/// Time constant of the settled estimate, seconds: slow enough to be a constant of the person.
const MEMORY_S: f64 = 60.0;

/// Running robust estimate of one person's inner-eye-corner distance.
///
/// A mean with clipped innovations: exact for clean data; an outlier counts as at most a 6 % error. Starts at the population's
/// mean, which the first frames outweigh.
#[derive(Clone, Debug)]
pub struct EyeDistance {
    prior: f64,
    estimate: f64,
    seconds: f64,
}

impl EyeDistance {
    /// Starts at the population's mean, in metres.
    pub fn new(prior_m: f32) -> Self {
        let prior = f64::from(prior_m);
        Self {
            prior,
            estimate: prior,
            seconds: PRIOR_S,
        }
    }

    /// Adds a frame's distance (metres) with weight ω dt (seconds).
    pub fn observe(&mut self, w: f32, omega_dt: f64) {
        let w = f64::from(w);
        if !PLAUSIBLE_M.contains(&w) || omega_dt <= 0.0 {
            return;
        }
        // Young estimates are not clipped: the population spreads by more than the clip.
        let young = self.seconds < PRIOR_S + 0.5;
        let clip = if young {
            f64::INFINITY
        } else {
            CLIP * self.estimate
        };
        self.seconds = (self.seconds + omega_dt).min(MEMORY_S);
        let innovation = (w - self.estimate).clamp(-clip, clip);
        self.estimate += innovation * (omega_dt / self.seconds).min(1.0);
    }

    /// The estimate in metres.
    pub fn get(&self) -> f32 {
        self.estimate as f32
    }

    /// Forgets the person.
    pub fn reset(&mut self) {
        *self = Self::new(self.prior as f32);
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::base::geometry::Vector;

    pub(crate) use crate::toy_face::toy_face;

    fn measured(p: &[Point; LANDMARKS], measure: Measure) -> f32 {
        raw(p)[measure as usize]
    }

    #[test]
    fn known_lengths_of_the_toy_face() {
        let raw = raw(&toy_face());
        let expected_mm = [
            0.0, 50.0, 0.0, -2.0, 11.0, 20.0, 20.0, 10.0, 10.0, 40.0, 40.0, 90.0, -20.0, -20.0,
            20.0, 20.0, 15.0, 15.0, 0.0, 0.0, 30.0,
        ];
        for (measure, expected) in Measure::ALL.into_iter().zip(expected_mm) {
            let found = raw[measure as usize] * 1e3;
            assert!(
                (found - expected).abs() < 1e-4,
                "{}: {found} mm",
                measure.name()
            );
        }
        let scaled = scaled(&raw, 0.03);
        assert!((scaled[Measure::JawDrop as usize] - 3.0).abs() < 1e-6);
        assert!((scaled[Measure::EyeDistance as usize] - 0.03).abs() < 1e-8);
    }

    #[test]
    fn every_measure_has_the_documented_sign() {
        // Displacement of some landmarks in mm, and the measure that must rise by exactly so much.
        let cases: [(&[usize], Vector, Measure, f32); 18] = [
            (&[65, 66, 67], Vector::y(), Measure::LipGap, 1.0),
            (&[54], Vector::x(), Measure::MouthWidth, 1.0),
            (&[56, 57, 58], Vector::x(), Measure::LipShift, 1.0),
            (&[56, 57, 58], -Vector::z(), Measure::LipThrust, 1.0),
            (
                &[50, 51, 52, 56, 57, 58],
                -Vector::z(),
                Measure::LipProtrusion,
                1.0,
            ),
            (&[22, 23, 24, 25, 26], -Vector::y(), Measure::BrowL, 1.0),
            (&[17, 18, 19, 20, 21], -Vector::y(), Measure::BrowR, 1.0),
            (&[43, 44], Vector::y(), Measure::LidL, -1.0),
            (&[37, 38], Vector::y(), Measure::LidR, -1.0),
            (&[34, 35], -Vector::y(), Measure::NostrilL, -1.0),
            (&[31, 32], -Vector::y(), Measure::NostrilR, -1.0),
            (&[7, 8, 9], Vector::y(), Measure::JawDrop, 1.0),
            (&[54], -Vector::y(), Measure::CornerL, 1.0),
            (&[48], -Vector::y(), Measure::CornerR, 1.0),
            (&[22, 23], -Vector::y(), Measure::InnerBrowL, 1.0),
            (&[20, 21], -Vector::y(), Measure::InnerBrowR, 1.0),
            (&[52, 53], -Vector::y(), Measure::UpperLipL, -1.0),
            (&[49, 50], -Vector::y(), Measure::UpperLipR, -1.0),
        ];
        for (points, direction, measure, rise_mm) in cases {
            let mut p = toy_face();
            let before = measured(&p, measure);
            for &i in points {
                p[i] += direction * 1e-3;
            }
            let rise = (measured(&p, measure) - before) * 1e3;
            assert!(
                (rise - rise_mm).abs() < 1e-3,
                "{} rose by {rise} mm",
                measure.name()
            );
        }
    }

    #[test]
    fn each_measure_depends_on_its_landmarks_only() {
        for measure in Measure::ALL {
            for i in 0..LANDMARKS {
                let mut p = toy_face();
                p[i] += Vector::new(1e-3, 2e-3, 3e-3);
                let moved = (measured(&p, measure) - measured(&toy_face(), measure)).abs() > 1e-7;
                assert_eq!(
                    moved,
                    measure.landmarks().any(|own| own == i),
                    "{} and point {i}",
                    measure.name()
                );
            }
        }
    }

    #[test]
    fn sizes_cancel_and_shifts_do_not_matter() {
        let p = toy_face();
        let q = p.map(|p| Point::from(p.coords * 1.2 + Vector::new(0.01, 0.02, 0.03)));
        let (a, b) = (raw(&p), raw(&q));
        let w = Measure::EyeDistance as usize;
        let (a, b) = (scaled(&a, a[w]), scaled(&b, b[w]));
        for measure in Measure::ALL
            .into_iter()
            .filter(|&m| m != Measure::EyeDistance)
        {
            let i = measure as usize;
            assert!(
                (a[i] - b[i]).abs() < 1e-5,
                "{}: {} and {}",
                measure.name(),
                a[i],
                b[i]
            );
        }
    }

    #[test]
    fn eye_distance_is_learnt_within_a_second_despite_outliers() {
        let mut w = EyeDistance::new(0.031);
        let dt = 1.0 / 30.0;
        for frame in 0..900 {
            let outlier = frame % 20 == 19;
            w.observe(if outlier { 0.05 } else { 0.035 }, dt);
            if frame == 10 {
                assert!(
                    (w.get() - 0.035).abs() < 0.0012,
                    "after a third of a second: {}",
                    w.get()
                );
            }
        }
        // A plain mean would sit at 0.03575.
        assert!((w.get() - 0.035).abs() < 0.00015, "{}", w.get());
        w.observe(f32::NAN, dt);
        w.observe(0.0, dt);
        assert!(w.get().is_finite());
        w.reset();
        assert!((w.get() - 0.031).abs() < 1e-7);
    }

    #[test]
    fn a_measure_is_as_certain_as_its_landmarks_on_average() {
        let mut face = Landmarks {
            head: toy_face(),
            point_confidence: [0.5; LANDMARKS],
            confidence: 0.75,
            ..Landmarks::default()
        };
        let corners: Vec<usize> = Measure::MouthWidth.landmarks().collect();
        face.point_confidence[corners[0]] = 0.9;
        let expected = 0.5 + 0.4 / corners.len() as f32;
        let found = confidence(Measure::MouthWidth, &face);
        assert!((found - expected).abs() < 1e-6, "{found} and {expected}");
        assert!((confidence(Measure::BrowL, &face) - 0.5).abs() < 1e-6);
        // Measures without landmarks have the face's confidence.
        for measure in Measure::ALL {
            if measure.groups().is_empty() {
                assert_eq!(confidence(measure, &face), 0.75, "{}", measure.name());
            }
        }
    }
}
