//! Pose of the face within the head that depth sees: a constant of the person, averaged slowly.
//!
//! Depth alone determines the face's axes badly, because foreheads and chins slope differently; the image determines them, but its
//! estimate changes with pose and expression. The mean is where the next fit starts; a frame's difference from it tells how far the
//! head pose is off. Radians, and metres in the head frame. No allocation.

use crate::base::frames::{Head, HeadFromFace, Motion};
use crate::base::geometry::{Rigid, Rotation, Vector, yaw_pitch_roll};

/// Time over which the rotation is averaged, seconds: a shorter mean makes the pose wander.
const TURN_TIME_S: f32 = 40.0;
/// Rotation of a new face within its head above which the head pose must be wrong, radians.
const MISALIGNED_RAD: f32 = 0.14;
/// The same of its shift, metres.
const MISALIGNED_M: f32 = 0.015;
/// Time with all of the face visible after which its pose in the head is known, seconds.
const KNOWN_S: f32 = 3.0;
/// Time that a mean from partly hidden faces counts for once all of the face is visible, seconds.
const PARTIAL_S: f32 = 1.0;
/// Decay per lost frame, for a face that was seen before.
const DECAY_KNOWN: f32 = 0.98;
/// Decay per lost frame, for a face that was only searched.
const DECAY_NEW: f32 = 0.5;
/// Middle of a face in the head frame, the pivot of its rotation, metres.
const MIDDLE: Vector = Vector::new(0.0, 0.03, 0.02);
/// Other positions at which a new face is searched, one per frame: x and y of the head frame, metres.
const SEARCH_OFFSETS_M: [[f32; 2]; 6] = [
    [0.0, 0.0],
    [0.0, 0.03],
    [0.03, 0.015],
    [-0.03, 0.015],
    [0.0, -0.03],
    [0.0, 0.055],
];

/// Rotation and shift of an upright face within a head that was found tilted or displaced.
fn upright_start(sensor_from_head: &Rotation, offset: usize) -> (Rotation, Vector) {
    let (_, _, roll) = yaw_pitch_roll(sensor_from_head);
    let turn = Rotation::from_axis_angle(&Vector::z_axis(), -roll);
    let [x, y] = SEARCH_OFFSETS_M[offset];
    (turn, MIDDLE + turn * (Vector::new(x, y, 0.0) - MIDDLE))
}

/// Pose of one person's face within the head.
#[derive(Clone, Debug)]
pub struct FaceInHead {
    /// Mean rotation from the head to the face.
    turn: Rotation,
    /// Seconds averaged.
    turned_s: f32,
    /// Seconds averaged with all of the face visible.
    whole_s: f32,
    /// Whether a part of the face was hidden in the last fit.
    pub(super) is_partial: bool,
    /// Mean position of the face's origin, across the line of sight only.
    shift: Vector,
    /// Difference of the last fit from the head pose, given the mean: `sensor_from_head * image_residual` is the head pose according to
    /// the image. `None` before the first fit.
    image_residual: Option<Motion<Head, Head>>,
    /// Index of the next position to search for a new face; continues from person to person.
    next_offset: usize,
}

impl Default for FaceInHead {
    fn default() -> Self {
        Self {
            turn: Rotation::identity(),
            turned_s: 0.0,
            whole_s: 0.0,
            is_partial: false,
            shift: Vector::zeros(),
            image_residual: None,
            next_offset: 0,
        }
    }
}

impl FaceInHead {
    /// The mean pose, from which a fit starts.
    pub fn pose(&self) -> HeadFromFace {
        HeadFromFace::from_parts(self.shift, self.turn)
    }

    /// Its rotation alone.
    pub(super) fn rotation(&self) -> HeadFromFace {
        HeadFromFace::from_parts(Vector::zeros(), self.turn)
    }

    /// See the field.
    pub(super) fn image_residual(&self) -> Option<Motion<Head, Head>> {
        self.image_residual
    }

    /// Starts at the next position of an upright face: hair tilts the depth pose of a newly found head; most people sit upright.
    pub fn search(&mut self, sensor_from_head: &Rotation) {
        (self.turn, self.shift) = upright_start(sensor_from_head, self.next_offset);
        self.next_offset = (self.next_offset + 1) % SEARCH_OFFSETS_M.len();
    }

    /// Averages a fit that ended `moved` from its start, a frame of `step_s` seconds; `share` is the frame's share in the mean shift.
    /// A partly hidden face (`is_partial`) turns the fit by some degrees, so it changes the mean only for a person not seen otherwise.
    pub fn update(&mut self, moved: &Rigid, step_s: f32, share: f32, is_partial: bool) {
        self.is_partial = is_partial;
        // Larger values are errors of the depth pose.
        let usual = HeadFromFace::assume_frames(Rigid::new(
            self.shift.cap_magnitude(MISALIGNED_M),
            self.turn.scaled_axis().cap_magnitude(MISALIGNED_RAD),
        ));
        let seen = HeadFromFace::assume_frames(*self.pose() * moved);
        self.image_residual = Some(seen * usual.inverse());
        if is_partial && self.whole_s >= KNOWN_S {
            return;
        }
        if !is_partial {
            if self.whole_s == 0.0 {
                self.turned_s = self.turned_s.min(PARTIAL_S);
            }
            self.whole_s += step_s;
        }
        self.shift += self.turn * moved.translation.vector * share;
        self.turned_s = (self.turned_s + step_s).min(TURN_TIME_S);
        let share = (step_s / self.turned_s.max(step_s)).clamp(0.0, 1.0);
        self.turn *= Rotation::from_scaled_axis(moved.rotation.scaled_axis() * share);
    }

    /// A frame without a face. The mean may be wrong and decays to the head pose alone; not at once, because most faces are lost by
    /// looking down.
    pub fn decay(&mut self, is_known: bool) {
        let kept = if is_known { DECAY_KNOWN } else { DECAY_NEW };
        self.turn = Rotation::from_scaled_axis(self.turn.scaled_axis() * kept);
        self.turned_s *= kept;
        self.shift *= kept;
    }

    /// Takes the pose if it is so far off that the head pose must be wrong; the next fit then starts from the corrected pose alone.
    pub(super) fn take_misalignment(&mut self) -> Option<HeadFromFace> {
        let off = self.turn.angle() > MISALIGNED_RAD || self.shift.norm() > MISALIGNED_M;
        let head_from_face = self.pose();
        off.then(|| {
            self.reset();
            head_from_face
        })
    }

    /// Forgets the person.
    pub fn reset(&mut self) {
        (self.turn, self.turned_s, self.whole_s) = (Rotation::identity(), 0.0, 0.0);
        self.shift = Vector::zeros();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::geometry::{Point, rotation_from_yaw_pitch_roll};

    fn moved(turn: Rotation, aside: Vector) -> Rigid {
        Rigid::from_parts(aside.into(), turn)
    }

    #[test]
    fn the_rotation_is_a_running_mean() {
        // Gains of a plain mean: 1, 1/2, 1/3.
        let mut face = FaceInHead::default();
        let turn = Rotation::new(Vector::new(0.03, -0.12, 0.05));
        let more = Rotation::new(Vector::new(0.02, 0.01, -0.06));
        face.update(&moved(turn, Vector::zeros()), 0.1, 1.0, false);
        assert!(face.rotation().rotation.angle_to(&turn) < 1e-3);
        face.update(&moved(more, Vector::zeros()), 0.1, 1.0, false);
        let half = turn * Rotation::new(more.scaled_axis() * 0.5);
        assert!(face.rotation().rotation.angle_to(&half) < 1e-3);
        // From forty seconds on a second is a fortieth.
        for _ in 0..400 {
            face.update(&Rigid::identity(), 0.1, 1.0, false);
        }
        face.update(&moved(more, Vector::zeros()), 1.0, 1.0, false);
        let last = half * Rotation::new(more.scaled_axis() / 40.0);
        assert!(face.rotation().rotation.angle_to(&last) < 1e-3);
    }

    #[test]
    fn a_shift_is_in_the_axes_of_the_head() {
        let aside = Vector::new(0.004, -0.007, 0.0);
        let mut face = FaceInHead::default();
        face.update(&moved(Rotation::identity(), aside), 0.1, 1.0, false);
        assert!((face.shift - aside).norm() < 1e-6);
        // In a head that is turned to its face, the face's axes are turned against the head's.
        let mut turned = FaceInHead::default();
        let turn = Rotation::new(Vector::new(0.0, 0.1, 0.0));
        turned.update(&moved(turn, Vector::zeros()), 0.1, 1.0, false);
        turned.update(&moved(Rotation::identity(), aside), 0.1, 0.5, false);
        assert!((turned.shift - turn * aside * 0.5).norm() < 1e-6);
    }

    #[test]
    fn it_decays_with_every_lost_frame() {
        let turn = Rotation::new(Vector::new(0.0, 0.12, 0.0));
        for (is_known, kept) in [(true, 0.98), (false, 0.5)] {
            let mut face = FaceInHead::default();
            face.update(&moved(turn, Vector::new(0.01, 0.0, 0.0)), 0.1, 1.0, false);
            face.decay(is_known);
            assert!((face.rotation().rotation.angle() - 0.12 * kept).abs() < 1e-4);
            assert!((face.shift.x - 0.01 * kept).abs() < 1e-7);
            assert!((face.turned_s - 0.1 * kept).abs() < 1e-6);
            face.reset();
            assert!(face.rotation().rotation.angle() < 1e-6 && face.shift.norm() < 1e-9);
            assert!(face.turned_s == 0.0);
        }
    }

    #[test]
    fn a_gross_misalignment_is_taken_once() {
        for (turn, aside_m, is_wrong) in [
            (0.13, 0.0, false),
            (0.15, 0.0, true),
            (0.0, 0.014, false),
            (0.0, 0.016, true),
        ] {
            let turn = Rotation::new(Vector::new(0.0, turn, 0.0));
            let mut face = FaceInHead::default();
            face.update(
                &moved(turn, Vector::new(aside_m, 0.0, 0.0)),
                0.1,
                1.0,
                false,
            );
            let before = face.pose();
            let found = face.take_misalignment();
            assert_eq!(found.is_some(), is_wrong, "{aside_m}");
            if let Some(head_from_face) = found {
                assert!(head_from_face.rotation.angle_to(&before.rotation) < 1e-6);
                assert!((head_from_face.translation.vector.x - aside_m).abs() < 1e-7);
                assert!(face.take_misalignment().is_none());
            }
        }
    }

    #[test]
    fn the_residual_is_what_the_mean_does_not_explain() {
        let turn = Rotation::new(Vector::new(0.05, 0.1, -0.03));
        let mut face = FaceInHead::default();
        face.update(&moved(turn, Vector::new(0.01, 0.002, 0.0)), 0.1, 1.0, false);
        // The first fit has no mean to be compared with: all of it is residual.
        let first = face.image_residual().expect("a fit");
        assert!(first.rotation.angle_to(&turn) < 1e-5);
        assert!((first.translation.vector.x - 0.01).abs() < 1e-6);
        // A fit that ends where it starts leaves nothing.
        face.update(&Rigid::identity(), 0.1, 1.0, false);
        let next = face.image_residual().expect("a fit");
        assert!(next.rotation.angle() < 1e-3 && next.translation.vector.norm() < 1e-5);
    }

    #[test]
    fn a_new_face_is_searched_upright_at_each_offset() {
        let head = rotation_from_yaw_pitch_roll(0.2, -0.1, 0.4);
        let mut face = FaceInHead::default();
        for [x, y] in SEARCH_OFFSETS_M {
            face.search(&head);
            let (turn, shift) = (face.turn, face.shift);
            let (_, _, roll) = yaw_pitch_roll(&(head * turn));
            assert!(roll.abs() < 0.05, "{roll}");
            // The middle of the face turns about itself and moves by the offset, in the axes of the upright face.
            let middle = turn * Point::from(MIDDLE) + shift;
            let moved = turn.inverse() * (middle - Point::from(MIDDLE));
            assert!((moved - Vector::new(x, y, 0.0)).norm() < 1e-6, "{moved}");
        }
        assert_eq!(face.next_offset, 0);
    }
}
