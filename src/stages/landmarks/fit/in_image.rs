//! Fits with the image alone: of a tracked face, and of a candidate that may be a new one. Both return the pose of the face.

use super::*;

/// The pose of a face at the view `end`, if the pose `expected` has the view `start`; `log_size`: natural logarithm of the face's size
/// relative to the model.
fn pose_in_image(
    expected: &SensorFromFace,
    start: &View,
    log_size: f32,
    end: &View,
) -> SensorFromFace {
    let seen = **expected * view_motion(start, end);
    let before = expected.translation.vector;
    // A face that appears smaller than expected is farther away.
    let farther = (start.log_scale + log_size - end.log_scale).exp();
    let place = seen.translation.vector * farther;
    // A view is relative to the line of sight, which has moved with the face.
    let sight = Rotation::rotation_between(&before, &place).unwrap_or_else(Rotation::identity);
    // Without normalisation, rounding errors would grow from frame to frame.
    SensorFromFace::from_parts(place, Rotation::new_normalize(*(sight * seen.rotation)))
}

impl LandmarkFitter {
    /// Fits one frame near the `expected` pose of the face and corrects that pose by the image alone: rotation and position come from
    /// the fitted view, distance from the size of the face, which is that of the model until depth has shown it. Returns the corrected
    /// pose; `None` if no face is found there. `depth` is the depth map of the frame, if it has one.
    pub fn fit_in_image(
        &mut self,
        scratch: &mut Scratch,
        luma: &[u8; PIXELS],
        depth: Option<&[u16; PIXELS]>,
        camera: &Camera,
        expected: &SensorFromFace,
        at: Timestamp,
    ) -> Option<(&Landmarks, SensorFromFace)> {
        let step_s = self.step_s(at);
        let Some(found) = self.fit_at_pose(scratch, luma, camera, expected, step_s) else {
            self.interrupt();
            return None;
        };
        // The first frame with depth replaces this size.
        let (log_size, _) = *self.log_size.get_or_insert((0.0, 0.0));
        let (placement, fit, _) = &found;
        self.mean_shape.add(&fit.shape, step_s);
        scratch.solver.project(&self.shape, fit);
        let view = self
            .mean_shape
            .view(&self.shape, &fit.view, &scratch.solver.window);
        let seen = pose_in_image(expected, &placement.start, log_size, &view);
        self.accept(luma, depth, camera, &found, &seen, step_s, at);
        Some((&self.landmarks, seen))
    }

    /// Searches for anyone's face near a guessed pose by the image alone; returns its confidence (0 to 1) and pose. Changes no state.
    pub fn search_in_image(
        &self,
        scratch: &mut Scratch,
        luma: &[u8; PIXELS],
        camera: &Camera,
        guess: &SensorFromFace,
    ) -> Option<(f32, SensorFromFace)> {
        self.search(scratch, luma, camera, *guess, |pose, start, end| {
            pose_in_image(&pose, start, 0.0, end)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pose_in_the_image_moves_across_turns_and_recedes_as_seen() {
        let expected = SensorFromFace::from_parts(
            Vector::new(0.0, 0.0, 0.8),
            Rotation::new(Vector::new(0.1, 0.2, 0.0)),
        );
        let start = View {
            log_scale: PIXELS_PER_METRE.ln(),
            rotation: expected.rotation,
            shift: [91.5, 66.0],
            inverse_distance: 1.25,
        };
        // A face a tenth larger than the model that also appears a tenth larger keeps its distance.
        let same = View {
            log_scale: start.log_scale + 0.1,
            ..start
        };
        let seen = pose_in_image(&expected, &start, 0.1, &same);
        assert!(seen.rotation.angle_to(&expected.rotation) < 1e-3);
        assert!((seen.translation.vector - expected.translation.vector).norm() < 1e-6);
        // 0.02 m to the right, as seen at 0.8 m; a tenth smaller, so 0.88 m away; and turned with the line of sight.
        let turn = Rotation::new(Vector::new(0.0, -0.1, 0.0));
        let end = View {
            log_scale: start.log_scale - 1.1f32.ln(),
            rotation: turn * start.rotation,
            shift: [91.5 + 0.02 * PIXELS_PER_METRE, 66.0],
            ..start
        };
        let seen = pose_in_image(&expected, &start, 0.0, &end);
        let place = Vector::new(0.022, 0.0, 0.88);
        assert!((seen.translation.vector - place).norm() < 1e-5);
        let sight = Rotation::new(Vector::new(0.0, 0.025f32.atan(), 0.0));
        let expected = sight * turn * expected.rotation;
        assert!(seen.rotation.angle_to(&expected) < 1e-3);
    }
}
