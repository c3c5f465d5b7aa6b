//! Weight ω of a sample, from the face's distance and its angle to the camera.
//!
//! Method: Jiang Na et al., section 2.2, equations (4) and (5). Units: metres in, 0…1 out. No state, no memory.
//! Degenerate: a face less than a millimetre from the camera's own position has no line of sight and weighs 0; further
//! than 5 m from the best distance equation (4) becomes negative and is clamped to 0.
//! Interpretation: n_f, "the unit normal when facing the camera", points from the face to the camera, so a face at the image's
//! edge that looks at the camera counts as facing it.

use crate::base::geometry::{Rigid, face_normal};
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;

/// Decrease of ω_t per metre from the best distance, equation (4).
const FALL_PER_M: f64 = 0.2;
/// α of equation (5).
const ALPHA: f64 = 0.5;

/// Equation (4): ω_t = 1 − |t_z − z_opt| · 0.2, cut at 0. Metres.
pub fn distance_weight(t_z: f64, z_opt: f64) -> f64 {
    (1.0 - (t_z - z_opt).abs() * FALL_PER_M).max(0.0)
}

/// Equation (5): ω_R = max(n_c · n_f, 0)^α with α = 0.5, from the cosine n_c · n_f.
pub fn facing_weight(cosine: f64) -> f64 {
    cosine.clamp(0.0, 1.0).powf(ALPHA)
}

/// ω = ω_t · ω_R of a pose (metres); `z_opt`: best distance, metres (0.5 in the paper).
pub fn sample_weight(sensor_from_head: &Rigid, z_opt: f64) -> f64 {
    let t = sensor_from_head.translation.vector;
    let length = t.norm();
    if length.is_nan() || length < 1e-3 {
        return 0.0;
    }
    let cosine = f64::from(face_normal(sensor_from_head).dot(&(-t / length)));
    distance_weight(f64::from(t.z), z_opt) * facing_weight(cosine)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::geometry::rotation_from_yaw_pitch_roll;
    use nalgebra::Translation3;

    fn pose(z: f32, yaw_deg: f32) -> Rigid {
        Rigid::from_parts(
            Translation3::new(0.0, 0.0, z),
            rotation_from_yaw_pitch_roll(yaw_deg.to_radians(), 0.0, 0.0),
        )
    }

    #[test]
    fn equation_4() {
        for (z, expected) in [
            (0.5, 1.0),
            (1.0, 0.9),
            (0.4, 0.98),
            (2.0, 0.7),
            (5.5, 0.0),
            (9.0, 0.0),
        ] {
            assert!((distance_weight(z, 0.5) - expected).abs() < 1e-12, "{z} m");
        }
    }

    #[test]
    fn equation_5() {
        for (cosine, expected) in [
            (1.0, 1.0),
            (0.25, 0.5),
            (0.81, 0.9),
            (0.0, 0.0),
            (-0.7, 0.0),
        ] {
            assert!((facing_weight(cosine) - expected).abs() < 1e-12, "{cosine}");
        }
    }

    #[test]
    fn both_together() {
        assert!((sample_weight(&pose(0.5, 0.0), 0.5) - 1.0).abs() < 1e-6);
        // cos 60° = 0.5: 0.9 · √0.5.
        assert!((sample_weight(&pose(1.0, 60.0), 0.5) - 0.9 * 0.5f64.sqrt()).abs() < 1e-6);
        assert!(sample_weight(&pose(0.5, 120.0), 0.5).abs() < 1e-9);
        // 28° at 2 m.
        assert!((sample_weight(&pose(2.0, 28.0), 0.5) - 0.658).abs() < 1e-3);
    }

    #[test]
    fn a_face_at_the_edge_that_looks_at_the_camera_faces_it() {
        // At the left edge, turned towards the camera: 30° to the image right, so the nose leaves −x: negative yaw.
        let pose = Rigid::from_parts(
            Translation3::new(-0.5 * 0.577_350_3, 0.0, 0.5),
            rotation_from_yaw_pitch_roll(-30f32.to_radians(), 0.0, 0.0),
        );
        assert!((sample_weight(&pose, 0.5) - 1.0).abs() < 1e-6);
    }

    #[test]
    fn degenerate_poses_weigh_nothing() {
        assert_eq!(sample_weight(&pose(0.0, 0.0), 0.5), 0.0);
        assert_eq!(sample_weight(&pose(f32::NAN, 0.0), 0.5), 0.0);
    }

    #[test]
    fn a_face_within_a_millimetre_weighs_nothing() {
        // 1 - 0.2 * 0.499 for its distance.
        assert!((sample_weight(&pose(1e-3, 0.0), 0.5) - 0.9002).abs() < 1e-6);
        assert_eq!(sample_weight(&pose(1e-3_f32.next_down(), 0.0), 0.5), 0.0);
    }
}
