//! Additional lengths of the face that distinguish units.
//!
//! A rolled-in lip is thin, lowered brows come closer together, a raised chin comes closer to the lip: section 2.1's measures
//! show little of that. Head frame, metres; divided by the inner-eye-corner distance like the measures. Used by
//! [`super::readings`] only. Cost: some hundred additions a frame, no memory.

use super::measures::mean;
use crate::base::capacity::{FEATURES, LANDMARKS, LENGTHS};
use crate::base::geometry::Point;
use crate::face_model::scheme::{
    CHIN, EYE_CORNERS_L, EYE_CORNERS_R, LOWER_LID_L, LOWER_LID_R, LOWER_LIP, LOWER_LIP_INSIDE,
    MOUTH_CORNER_L, MOUTH_CORNER_R, NOSE_BASE, OUTER_BROW_L, OUTER_BROW_R, UPPER_LID_L,
    UPPER_LID_R, UPPER_LIP, UPPER_LIP_INSIDE,
};

/// A signed length along an axis of the head: mean of one group of points minus mean of another.
#[derive(Clone, Copy, Debug)]
pub struct Feature {
    /// Its name in `config/units.toml`.
    pub name: &'static str,
    /// Axis: 0 is x, towards the subject's left; 1 is y, down.
    axis: usize,
    /// Landmarks of the first mean.
    to: &'static [usize],
    /// Landmarks of the subtracted mean.
    from: &'static [usize],
}

const fn feature(
    name: &'static str,
    axis: usize,
    to: &'static [usize],
    from: &'static [usize],
) -> Feature {
    Feature {
        name,
        axis,
        to,
        from,
    }
}

/// All lengths, in the order of the inputs.
pub const ALL: [Feature; LENGTHS] = [
    feature("brow_distance", 0, &[22], &[21]),
    feature("upper_lid_L", 1, &EYE_CORNERS_L, &UPPER_LID_L),
    feature("upper_lid_R", 1, &EYE_CORNERS_R, &UPPER_LID_R),
    feature("lower_lid_L", 1, &LOWER_LID_L, &EYE_CORNERS_L),
    feature("lower_lid_R", 1, &LOWER_LID_R, &EYE_CORNERS_R),
    feature("upper_lip_height", 1, &UPPER_LIP_INSIDE, &UPPER_LIP),
    feature("lower_lip_height", 1, &LOWER_LIP, &LOWER_LIP_INSIDE),
    feature("chin_height", 1, &CHIN, &LOWER_LIP),
    feature("lower_lip_drop", 1, &LOWER_LIP, &[NOSE_BASE]),
    feature("corner_out_L", 0, &[MOUTH_CORNER_L], &[NOSE_BASE]),
    feature("corner_out_R", 0, &[NOSE_BASE], &[MOUTH_CORNER_R]),
    feature("outer_brow_L", 1, &EYE_CORNERS_L, &OUTER_BROW_L),
    feature("outer_brow_R", 1, &EYE_CORNERS_R, &OUTER_BROW_R),
    feature("lower_lip_L", 1, &[55], &[NOSE_BASE]),
    feature("lower_lip_R", 1, &[59], &[NOSE_BASE]),
    feature("nose_width", 0, &[35], &[31]),
    feature("upper_lip_shift", 0, &[51], &[NOSE_BASE]),
    feature("upper_lip_drop", 1, &UPPER_LIP, &[NOSE_BASE]),
];

impl Feature {
    /// Its length on a face (head frame, metres), metres.
    pub fn raw(&self, points: &[Point; LANDMARKS]) -> f32 {
        (mean(points, self.to) - mean(points, self.from))[self.axis]
    }

    /// The landmarks it is computed from.
    pub fn landmarks(&self) -> impl Iterator<Item = usize> + '_ {
        self.to.iter().chain(self.from).copied()
    }
}

/// Names of the features of [`super::gaze`], after the lengths: gaze to the subject's left and up, lift of the upper lids.
pub const GAZE: [&str; FEATURES - LENGTHS] = ["gaze_left", "gaze_up", "lid_lift"];

/// Names of all features, in their order.
pub fn names() -> impl Iterator<Item = &'static str> {
    ALL.iter().map(|feature| feature.name).chain(GAZE)
}
