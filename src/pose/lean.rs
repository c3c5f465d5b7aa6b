//! Corrects the head pose towards the face in the picture: depth and picture determine the pose together.
//!
//! Under a fringe or beside long hair the depth pose drifts, slowly and confidently, while the 68 points stay on the face. The
//! face has a fixed pose within its head ([`crate::landmarks::LandmarkFitter::strayed`]), so each frame's points imply a head
//! pose. Both are weighted by their certainty: depth by the normal matrix of its alignment (`known`), the picture by
//! standard deviations about and across the line of sight. Small differences are left to depth, which is accurate to a
//! fraction of a degree on a bare head; pitch has more tolerance, because light and a moving mouth affect the picture's
//! estimate of it.
//!
//! Method: one Gauss–Newton step on the sum of the two quadratic forms about the depth pose, where depth's gradient is zero.
//! Head frame, radians and metres. Degenerate: where depth has no information, the picture alone decides.

use nalgebra::{Matrix3, SMatrix, SVector};

use super::plane::WORTH_M2;
use crate::base::frames::{Head, Motion, SensorFromHead};
use crate::base::geometry::{Rigid, Vector};
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;

/// Standard deviations of the picture's estimate: rotation about and across the line of sight, radians; shift across it,
/// metres.
const ROLL_RAD: f64 = 0.012;
const TURN_RAD: f64 = 0.026;
const SHIFT_M: f64 = 0.002;
/// Up to these differences, combined, depth decides: rotation, radians, and shift, metres.
const FREE_RAD: f32 = 0.035;
const FREE_M: f32 = 0.006;
/// Factor on the tolerance for pitch.
const FREE_PITCH: f32 = 1.5;
/// Information in a direction in which depth has none, per unit of weight.
const NOTHING: f64 = 1e-6;

/// The pose between `depth`, whose alignment has the information `known` (rotation and shift in the head frame, per unit of
/// weight), and the picture's estimate `pictured`.
pub(super) fn lean(
    depth: &SensorFromHead,
    known: &SMatrix<f64, 6, 6>,
    pictured: &SensorFromHead,
) -> Option<SensorFromHead> {
    let off = pictured.inverse() * *depth;
    let (turn, shift) = (off.rotation.scaled_axis(), off.translation.vector);
    let roomy = Vector::new(turn.x / FREE_PITCH, turn.y, turn.z);
    let far = (roomy.norm() / FREE_RAD).hypot(shift.norm() / FREE_M);
    if far <= 1.0 {
        return None;
    }
    let beyond = f64::from(1.0 - 1.0 / far);
    let sight = depth.inverse_transform_vector(&depth.translation.vector);
    let sight = sight.try_normalize(1e-6)?.cast::<f64>();
    let along = sight * sight.transpose();
    let across = Matrix3::identity() - along;
    let square = |sigma: f64| WORTH_M2 / (sigma * sigma);
    let mut picture = SMatrix::<f64, 6, 6>::zeros();
    let turns = across * square(TURN_RAD) + along * square(ROLL_RAD);
    picture.fixed_view_mut::<3, 3>(0, 0).copy_from(&turns);
    let shifts = across * square(SHIFT_M);
    picture.fixed_view_mut::<3, 3>(3, 3).copy_from(&shifts);
    let wanted = turn.iter().chain(shift.iter());
    let wanted =
        SVector::<f64, 6>::from_iterator(wanted.map(|component| f64::from(*component) * beyond));
    let depths = known + SMatrix::<f64, 6, 6>::identity() * NOTHING;
    let step = (depths + picture).cholesky()?.solve(&(picture * wanted));
    let [a, b, c, x, y, z] = core::array::from_fn(|k| step[k] as f32);
    let step = Rigid::new(Vector::new(x, y, z), Vector::new(a, b, c));
    Some(*depth * Motion::<Head, Head>::of(step).inverse())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::geometry::{Rotation, rotation_from_yaw_pitch_roll};

    fn depth() -> SensorFromHead {
        SensorFromHead::from_parts(
            Vector::new(0.05, -0.02, 0.8),
            rotation_from_yaw_pitch_roll(0.2, -0.1, 0.05),
        )
    }

    /// In every direction as much as the picture knows of a turn about the line of sight.
    fn equal() -> SMatrix<f64, 6, 6> {
        let mut known = SMatrix::identity() * (WORTH_M2 / (ROLL_RAD * ROLL_RAD));
        for k in 3..6 {
            known[(k, k)] = WORTH_M2 / (SHIFT_M * SHIFT_M);
        }
        known
    }

    #[test]
    fn what_both_know_equally_well_is_met_half_way_beyond_what_is_depths() {
        let depth = depth();
        let sight = depth.translation.vector.normalize();
        let turn = 0.2;
        let pictured = SensorFromHead::from_parts(
            depth.translation,
            Rotation::new(sight * turn) * depth.rotation,
        );
        let leant = lean(&depth, &equal(), &pictured).expect("far apart");
        let moved = (leant.rotation * depth.rotation.inverse()).scaled_axis();
        let half = 0.5 * (turn - FREE_RAD);
        assert!((moved - sight * half).norm() < 0.004, "{moved} {half}");
        assert!((leant.translation.vector - depth.translation.vector).norm() < 1e-4);
    }

    #[test]
    fn where_depth_knows_nothing_the_picture_decides_and_never_how_far_off_a_head_is() {
        let depth = depth();
        let pictured = SensorFromHead::of(
            *depth * Rigid::new(Vector::new(0.01, 0.0, 0.0), Vector::new(0.0, 0.15, 0.0)),
        );
        let leant = lean(&depth, &SMatrix::zeros(), &pictured).expect("far apart");
        assert!(leant.rotation.angle_to(&pictured.rotation) < FREE_RAD + 0.005);
        let along = depth.translation.vector.normalize();
        let moved = leant.translation.vector - depth.translation.vector;
        assert!(moved.dot(&along).abs() < 1e-3, "{moved}");
        // Where depth knows a hundred times more, the pose stays as it is.
        let leant = lean(&depth, &(equal() * 100.0), &pictured).expect("far apart");
        assert!(leant.rotation.angle_to(&depth.rotation) < 0.01);
    }

    #[test]
    fn small_differences_are_depths() {
        let depth = depth();
        let near =
            |turn: Vector, shift: Vector| SensorFromHead::of(*depth * Rigid::new(shift, turn));
        let none = Vector::zeros();
        for (turn, shift, is_left) in [
            (Vector::y() * 0.033, none, true),
            (Vector::y() * 0.037, none, false),
            (Vector::x() * 0.050, none, true),
            (Vector::x() * 0.055, none, false),
            (none, Vector::x() * 0.0055, true),
            (none, Vector::x() * 0.0065, false),
            (Vector::y() * 0.030, Vector::x() * 0.005, false),
        ] {
            let leant = lean(&depth, &equal(), &near(turn, shift));
            assert_eq!(leant.is_none(), is_left, "{turn} {shift}");
        }
    }
}
