//! The 68 landmarks (iBUG order) and the ten derived control points by name, and their mirror partners.
//!
//! Sides are the subject's own. Counting goes outwards from the middle: `brow_L1` is the inner end of the left brow,
//! `jaw_L1` is beside the chin, `jaw_L8` at the ear.

use std::sync::LazyLock;

pub use mien_stages::base::capacity::LANDMARKS;
use mien_stages::face_model::scheme::MIRROR;

/// Number of derived points, half of them on each side.
const DERIVED: usize = 10;

/// Names in the order of the 68 landmarks, then the derived points.
pub static NAMES: LazyLock<Vec<&str>> = LazyLock::new(|| POINTS.split_whitespace().collect());

const POINTS: &str = "
    jaw_R8 jaw_R7 jaw_R6 jaw_R5 jaw_R4 jaw_R3 jaw_R2 jaw_R1 chin
    jaw_L1 jaw_L2 jaw_L3 jaw_L4 jaw_L5 jaw_L6 jaw_L7 jaw_L8
    brow_R5 brow_R4 brow_R3 brow_R2 brow_R1 brow_L1 brow_L2 brow_L3 brow_L4 brow_L5
    nose_root nose_bridge nose_lower nose_tip
    nostril_R2 nostril_R1 nose_base nostril_L1 nostril_L2
    eye_R_outer lid_R_upper_outer lid_R_upper_inner eye_R_inner lid_R_lower_inner lid_R_lower_outer
    eye_L_inner lid_L_upper_inner lid_L_upper_outer eye_L_outer lid_L_lower_outer lid_L_lower_inner
    mouth_R lip_upper_R2 lip_upper_R1 lip_upper lip_upper_L1 lip_upper_L2
    mouth_L lip_lower_L2 lip_lower_L1 lip_lower lip_lower_R1 lip_lower_R2
    mouth_inner_R lip_upper_inner_R lip_upper_inner lip_upper_inner_L
    mouth_inner_L lip_lower_inner_L lip_lower_inner lip_lower_inner_R
    cheek_inner_L cheek_mid_L cheek_low_L forehead_low_L forehead_high_L
    cheek_inner_R cheek_mid_R cheek_low_R forehead_low_R forehead_high_R";

/// Index of a name.
pub fn index(name: &str) -> Option<usize> {
    NAMES.iter().position(|n| *n == name)
}

/// The name of the other side's unit or measure: a trailing L becomes R and vice versa.
pub fn swapped(name: &str) -> String {
    match (name.strip_suffix('L'), name.strip_suffix('R')) {
        (Some(stem), _) => format!("{stem}R"),
        (_, Some(stem)) => format!("{stem}L"),
        _ => name.to_owned(),
    }
}

/// The control point on the other side of the face; a point on the middle line is its own partner.
pub fn mirrored(point: usize) -> usize {
    match point.checked_sub(LANDMARKS) {
        None => MIRROR[point],
        // The left side's come first.
        Some(derived) => LANDMARKS + (derived + DERIVED / 2) % DERIVED,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mirroring_twice_is_the_identity_and_mirroring_once_crosses_the_face() {
        for k in 0..NAMES.len() {
            assert_eq!(mirrored(mirrored(k)), k);
            assert_eq!(index(NAMES[k]), Some(k));
        }
        assert_eq!(
            (mirrored(8), mirrored(36), mirrored(31), mirrored(61)),
            (8, 45, 35, 63)
        );
        assert_eq!((0..NAMES.len()).filter(|&k| mirrored(k) == k).count(), 10);
    }
}
