//! The 68 landmarks of a face, the result of every fitter.

use super::eyes::Eyes;
use crate::base::capacity::LANDMARKS;
use crate::base::defaults;
use crate::base::frames::SensorFromFace;
use crate::base::geometry::Point;
use crate::camera::Camera;
use crate::face_model::refinement;

defaults! {
    /// The 68 points of one face in one frame; before the first fit at the origin with confidence 0.
    #[derive(Clone, Debug)]
    pub struct Landmarks {
        /// Landmarks in the face's frame, metres, at the face's own size.
        pub head: [Point; LANDMARKS] = [Point::origin(); LANDMARKS],
        /// Landmarks in colour pixels; pixel centres are integers.
        pub pixels: [[f32; 2]; LANDMARKS] = [[0.0; 2]; LANDMARKS],
        /// Confidence of each point, 0…1.
        pub point_confidence: [f32; LANDMARKS] = [0.0; LANDMARKS],
        /// Confidence of the face, 0…1.
        pub confidence: f32 = 0.0,
        /// Puff of the right and the left cheek, measured by depth: about 0 to 1, plus a constant of the person.
        pub cheeks: [f32; refinement::PUFFS] = [0.0; refinement::PUFFS],
        /// Share of the mouth's points behind an object (a hand, a cup), 0…1.
        pub mouth_hidden: f32 = 0.0,
        /// Eye patches; `None` if the eyes are not visible.
        pub eyes: Option<Eyes> = None,
    }
}

impl Landmarks {
    /// An unoccluded face with full confidence; `head` in the face's frame, metres.
    pub fn certain(head: [Point; LANDMARKS]) -> Self {
        Self {
            head,
            point_confidence: [1.0; LANDMARKS],
            confidence: 1.0,
            ..Self::default()
        }
    }

    /// Reprojects the points at another pose: updates `pixels`.
    pub fn reproject(&mut self, sensor_from_face: &SensorFromFace, camera: &Camera) {
        self.pixels = self
            .head
            .map(|point| camera.colour_pixel(&(sensor_from_face * point)));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::geometry::Rigid;

    #[test]
    fn a_certain_face_is_fully_trusted_and_lies_where_the_camera_sees_it() {
        let mut face = Landmarks::certain([Point::new(0.02, 0.01, 0.0); LANDMARKS]);
        assert_eq!(face.confidence, 1.0);
        assert_eq!(face.point_confidence, [1.0; LANDMARKS]);
        let camera = Camera::default();
        let pose = SensorFromFace::assume_frames(Rigid::translation(0.1, 0.0, 0.8));
        face.reproject(&pose, &camera);
        let expected = camera.colour_pixel(&Point::new(0.12, 0.01, 0.8));
        assert_eq!(face.pixels, [expected; LANDMARKS]);
    }
}
