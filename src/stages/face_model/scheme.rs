//! The 68 landmarks of iBUG / Multi-PIE, 0-based: groups, mirror pairs and stable points.
//!
//! Sides are the subject's: L is at the right of the image.

use core::ops::Range;

use crate::base::capacity::LANDMARKS;
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;

/// Jaw from the right to the left ear; 8 is the chin. Points of the head, not of the silhouette.
pub const JAW: Range<usize> = 0..17;
/// Bridge of the nose (27–30), then the nostrils (31–35).
pub const NOSE: Range<usize> = 27..36;
/// Both lips: outer contour 48–59, inner contour 60–67.
pub const MOUTH: Range<usize> = 48..68;
/// All but the jaw.
pub const INNER: Range<usize> = 17..68;
/// The chin.
pub const CHIN: [usize; 3] = [7, 8, 9];
/// Outer end of the right brow.
pub const OUTER_BROW_R: [usize; 2] = [17, 18];
/// Outer end of the left brow.
pub const OUTER_BROW_L: [usize; 2] = [25, 26];
/// Inner end of the right brow.
pub const INNER_BROW_R: [usize; 2] = [20, 21];
/// Inner end of the left brow.
pub const INNER_BROW_L: [usize; 2] = [22, 23];
/// The base of the nose, between the nostrils.
pub const NOSE_BASE: usize = 33;
/// The nose's lower edge, from one wing to the other.
pub const NOSE_LINE: [usize; 5] = [31, 32, 33, 34, 35];
/// Outer edge of the right nostril.
pub const NOSTRIL_R: [usize; 2] = [31, 32];
/// Outer edge of the left nostril.
pub const NOSTRIL_L: [usize; 2] = [34, 35];
/// Both corners of the right eye, outer first.
pub const EYE_CORNERS_R: [usize; 2] = [36, 39];
/// Both corners of the left eye, inner first.
pub const EYE_CORNERS_L: [usize; 2] = [42, 45];
/// Upper lid of the right eye.
pub const UPPER_LID_R: [usize; 2] = [37, 38];
/// Upper lid of the left eye.
pub const UPPER_LID_L: [usize; 2] = [43, 44];
/// Lower lid of the right eye.
pub const LOWER_LID_R: [usize; 2] = [40, 41];
/// Lower lid of the left eye.
pub const LOWER_LID_L: [usize; 2] = [46, 47];
/// Right corner of the mouth.
pub const MOUTH_CORNER_R: usize = 48;
/// Left corner of the mouth.
pub const MOUTH_CORNER_L: usize = 54;
/// Middle of the upper lip's outer edge.
pub const UPPER_LIP: [usize; 3] = [50, 51, 52];
/// Middle of the lower lip's outer edge.
pub const LOWER_LIP: [usize; 3] = [56, 57, 58];
/// Middle of the upper lip's inner edge.
pub const UPPER_LIP_INSIDE: [usize; 3] = [61, 62, 63];
/// Middle of the lower lip's inner edge.
pub const LOWER_LIP_INSIDE: [usize; 3] = [65, 66, 67];
/// Inner corners of the right and left eye.
pub const INNER_EYE_CORNERS: [usize; 2] = [39, 42];
/// Outer corners of the right and left eye: their distance is the unit of landmark errors.
pub const OUTER_EYE_CORNERS: [usize; 2] = [36, 45];

/// Regions by name, in order of their points, covering all 68 without overlap.
pub const REGIONS: [(&str, Range<usize>); 5] = [
    ("jaw", JAW),
    ("brows", 17..27),
    ("nose", NOSE),
    ("eyes", 36..48),
    ("mouth", MOUTH),
];

/// Points that hardly move with expression: eye corners, bridge and base of the nose. They define the head frame.
pub const STABLE: [usize; 9] = [27, 28, 29, 30, 33, 36, 39, 42, 45];

/// `MIRROR[i]`: landmark that `i` becomes when the face is mirrored left to right.
pub const MIRROR: [usize; LANDMARKS] = mirror();

const fn mirror() -> [usize; LANDMARKS] {
    let mut permutation = [0; LANDMARKS];
    let mut i = 0;
    while i < LANDMARKS {
        permutation[i] = match i {
            0..17 => 16 - i,
            17..27 => 43 - i,
            31..36 => 66 - i,
            36..40 | 42..46 => 81 - i,
            40..42 | 46..48 => 87 - i,
            48..55 => 102 - i,
            55..60 => 114 - i,
            60..65 => 124 - i,
            65..68 => 132 - i,
            _ => i,
        };
        i += 1;
    }
    permutation
}

/// Distance of the outer eye corners in the image, in the unit of the points.
pub fn outer_eye_distance(points: &[[f32; 2]; LANDMARKS]) -> f32 {
    let [r, l] = OUTER_EYE_CORNERS;
    (points[r][0] - points[l][0]).hypot(points[r][1] - points[l][1])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn eyes_are_as_far_apart_as_their_outer_corners() {
        let mut points = [[7.0, 7.0]; LANDMARKS];
        (points[36], points[45]) = ([10.0, 50.0], [40.0, 90.0]);
        assert_eq!(outer_eye_distance(&points), 50.0);
    }

    #[test]
    fn mirroring_twice_changes_nothing() {
        for i in 0..LANDMARKS {
            assert_eq!(MIRROR[MIRROR[i]], i, "landmark {i}");
        }
    }

    #[test]
    fn mirroring_swaps_the_sides() {
        for (right, left) in [
            (0, 16),
            (17, 26),
            (21, 22),
            (31, 35),
            (36, 45),
            (37, 44),
            (38, 43),
            (39, 42),
            (40, 47),
            (41, 46),
            (48, 54),
            (59, 55),
            (60, 64),
            (67, 65),
        ] {
            assert_eq!(MIRROR[right], left);
        }
        for middle in [8, 27, 28, 29, 30, 33, 51, 57, 62, 66] {
            assert_eq!(MIRROR[middle], middle);
        }
    }

    #[test]
    fn regions_cover_all_points_once() {
        let mut next = 0;
        for (name, range) in REGIONS {
            assert_eq!(range.start, next, "{name}");
            next = range.end;
        }
        assert_eq!(next, LANDMARKS);
    }
}
