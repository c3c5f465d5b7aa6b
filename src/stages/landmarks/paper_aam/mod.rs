//! The paper's own landmark method (`landmarks.method = "paper"`): a 3D active appearance model (section 1.2, equations 1, 2).
//!
//! The 2D shape is the projection, at the head pose, of a 3D shape `S0 + Σ p_i S_i` from non-rigid structure from motion;
//! appearance is `A0 + Σ λ_i A_i`. The fit ([`solver`]) minimises the difference between the image inside the shape and the
//! appearance (Matthews and Baker, *Active appearance models revisited*, IJCV 2004; Xiao, Baker, Matthews, Kanade, *Real-time
//! combined 2D+3D active appearance models*, CVPR 2004), starting from the depth pose and regularised by it. 2D and 3D share
//! their shape parameters. The pose of a face within its head is a constant of the person: after the first frames the image
//! moves the face little from there. The protrusion of lips and eye corners is measured by depth, as no frontal image shows it.
//!
//! Works in the head window ([`super::window`]), window pixels, radians, standard deviations; grey values are compared
//! relative to their surroundings ([`grey`]). One step costs pixels × parameters × modes ≈ 6 M operations; unlike the default
//! method it allocates scratch per frame. Limitation: an open mouth of a person first seen may be taken for a closed one until
//! it closes. Degenerate: a flat window, a pose outside the image or an implausibly large residual gives `None`.

mod grey;
mod model;
mod solver;
pub mod warp;

pub use model::{MOST_APPEARANCE_MODES, MOST_HEAD_MODES, PaperAam};
pub use solver::{AamFit, Expected, Solver};
pub use {grey::normalised, solver::sample};

use super::points::Landmarks;
use super::refine;
use super::view::View;
use super::window::{Placement, Region, WINDOW, sensor_image};
use crate::base::capacity::{LANDMARKS, PIXELS};
use crate::base::frames::{HeadFromFace, SensorFromHead};
use crate::base::geometry::{Point, Vector};
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;
use crate::camera::Camera;
use crate::face_model::refinement::site_of;
use crate::face_model::scheme::{
    INNER_EYE_CORNERS, LOWER_LIP, NOSE_LINE, OUTER_EYE_CORNERS, UPPER_LIP,
};
use crate::face_model::{ModelError, VIEW_PARAMETERS};
use crate::pose::HeadPose;

/// Spread of a known person's face about its mean pose within the head, as a share of an unknown person's.
const KNOWN_SPREAD: f32 = 0.125;
/// Most frames of that mean pose.
const MEAN_FRAMES: u16 = 600;
/// Weight of zero in the person's mean residual, frames.
const RESIDUAL_PRIOR_FRAMES: f32 = 30.0;
/// Least confidence of a frame that is learned from: a person walking in is blurred.
const TEACHING_CONFIDENCE: f32 = 0.8;
/// Least visible share of the face in a frame that is learned from: a person walking in is seen from the side.
const TEACHING_SEEN: f32 = 0.8;
/// Learned frames after which the fit of a face first seen from the side restarts cold, and the residual is learned.
const RESTART_AFTER: u16 = 20;

/// Least confidence of a face, 0…1.
const MIN_CONFIDENCE: f32 = 0.3;
/// Most iterations from a cold start.
const COLD_STEPS: usize = 20;
/// Most iterations from the last frame's shape.
const WARM_STEPS: usize = 8;

/// Fits the landmarks of one face, frame by frame, by the paper's method.
pub struct PaperAamFitter {
    solver: Solver,
    window: Vec<f32>,
    /// The last frame's fit, and the view of its depth pose.
    last: Option<(AamFit, View)>,
    /// Mean displacement of this person's face from the depth pose, in [`super::view::UNITS`].
    usual: [f32; VIEW_PARAMETERS],
    /// Frames averaged in `usual`.
    seen: u16,
    /// Mean distance of the nose's base, inner and outer eye corners before the model's, metres.
    bone_offsets: [f32; 3],
    /// Whether the person was first seen from the side.
    first_seen_sideways: bool,
    landmarks: Landmarks,
}

impl PaperAamFitter {
    /// A fitter without history.
    ///
    /// # Errors
    /// As [`PaperAam::parse`].
    pub fn new(bytes: &[u8]) -> Result<Self, ModelError> {
        Ok(Self {
            solver: Solver::new(PaperAam::parse(bytes)?),
            window: vec![0.0; WINDOW * WINDOW],
            last: None,
            usual: [0.0; VIEW_PARAMETERS],
            seen: 0,
            bone_offsets: [0.0; 3],
            first_seen_sideways: false,
            landmarks: Landmarks::default(),
        })
    }

    /// Forgets the person: the next frame starts cold.
    pub fn reset(&mut self) {
        self.last = None;
        (self.usual, self.seen) = ([0.0; VIEW_PARAMETERS], 0);
        self.bone_offsets = [0.0; 3];
        self.first_seen_sideways = false;
        self.solver.usual_residual.fill(0.0);
    }

    /// Fits one frame of grey and raw depth at a head pose; `None` if no face is found there.
    pub fn fit(
        &mut self,
        luma: &[u8; PIXELS],
        depth: &[u16; PIXELS],
        camera: &Camera,
        pose: &HeadPose,
    ) -> Option<&Landmarks> {
        let Some(placement) = Placement::from_pose(camera, &pose.sensor_from_head) else {
            self.last = None;
            return None;
        };
        placement.resample(&sensor_image(luma), &Region::WHOLE, &mut self.window);
        let start = placement.start;
        let believed = |fit: &AamFit| fit.confidence >= MIN_CONFIDENCE;
        let expected = self.expected(&start);
        let warm = self.last.take().map(|(last, depth)| {
            let first = self.solver.warm(&last, &depth, &start);
            self.solver.run(&self.window, first, expected, WARM_STEPS)
        });
        let fit = match warm {
            Some(fit) if believed(&fit) => fit,
            _ => {
                let first = self.solver.cold(&expected.view);
                self.solver.run(&self.window, first, expected, COLD_STEPS)
            }
        };
        if !believed(&fit) {
            return None;
        }
        for i in 0..LANDMARKS {
            self.landmarks.pixels[i] = placement.image_pixel(fit.shape[i]);
        }
        self.landmarks.head = self.solver.head(&fit);
        self.learn_usual(&fit, &start);
        self.correct_protrusion(&fit, &start, depth, camera, &pose.sensor_from_head);
        self.landmarks.point_confidence = fit.point_confidence;
        self.landmarks.confidence = fit.confidence;
        // A wrong first fit from the side would persist.
        self.first_seen_sideways |= self.seen == 0 && fit.seen < TEACHING_SEEN;
        let restarts = self.seen == RESTART_AFTER && core::mem::take(&mut self.first_seen_sideways);
        self.last = (!restarts).then_some((fit, start));
        Some(&self.landmarks)
    }

    /// Expected view of the face, from the view of the depth pose.
    fn expected(&self, depth: &View) -> Expected {
        let known = f32::from(self.seen);
        Expected {
            view: depth.moved(&self.usual),
            spread: KNOWN_SPREAD.hypot((1.0 + known).recip()),
        }
    }

    /// Learns the mean pose of the face within the head, and the residual.
    fn learn_usual(&mut self, fit: &AamFit, start: &View) {
        if fit.confidence < TEACHING_CONFIDENCE || fit.seen < TEACHING_SEEN {
            return;
        }
        self.seen = (self.seen + 1).min(MEAN_FRAMES);
        if self.seen > RESTART_AFTER {
            let frames = f32::from(self.seen - RESTART_AFTER) + RESIDUAL_PRIOR_FRAMES;
            self.solver.learn(1.0 / frames);
        }
        for (usual, off) in self.usual.iter_mut().zip(fit.view.step_from(start)) {
            *usual += (off - *usual) / f32::from(self.seen);
        }
    }

    /// Corrects the protrusion of points by depth: eye corners, which are on bone, by their mean measurement; lips by this frame's, less
    /// the deviation of the nose from its mean, which is the pose's error.
    fn correct_protrusion(
        &mut self,
        fit: &AamFit,
        start: &View,
        depth: &[u16; PIXELS],
        camera: &Camera,
        sensor_from_head: &SensorFromHead,
    ) {
        let back = start.rotation.inverse();
        let [x, y] = [0, 1].map(|k| (fit.view.shift[k] - start.shift[k]) / start.log_scale.exp());
        let head_from_face =
            HeadFromFace::from_parts(back * Vector::new(x, y, 0.0), back * fit.view.rotation);
        let size = (fit.view.log_scale - start.log_scale).exp();
        let head = &mut self.landmarks.head;
        let face = *sensor_from_head * head_from_face;
        let nearer = refine::surface_offsets(head, size, Some(depth), camera, &face);
        // Along the line of sight, so that the projection is unchanged.
        let sight = face.rotation.inverse() * (face * Point::origin()).coords;
        // Each group as a whole, to keep the distances within it.
        let parts: [&[usize]; 5] = [
            &NOSE_LINE,
            &INNER_EYE_CORNERS,
            &OUTER_EYE_CORNERS,
            &UPPER_LIP,
            &LOWER_LIP,
        ];
        let mut error = 0.0;
        for (part, points) in parts.into_iter().enumerate() {
            let (mut sum, mut count) = (0.0, 0.0);
            for by in points.iter().map(|&i| nearer[site_of(i)]) {
                if by.is_finite() {
                    (sum, count) = (sum + by, count + 1.0);
                }
            }
            let seen = (count > 0.0).then(|| sum / count);
            let by = if let Some(usual) = self.bone_offsets.get_mut(part) {
                if let Some(by) = seen {
                    *usual += (by - *usual) / f32::from(self.seen.max(1));
                }
                if part == 0 {
                    error = seen.map_or(0.0, |by| by - *usual);
                    continue;
                }
                *usual
            } else {
                seen.map_or(0.0, |by| by - error)
            };
            for &i in points {
                head[i] -= sight * (by / sight.z);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::geometry::Rigid;
    use crate::face_model::FaceModel;

    #[test]
    fn lips_follow_depth_less_what_the_nose_deviates_from_its_mean() {
        let mut fitter = PaperAamFitter::new(&FaceModel::shipped().paper_aam).expect("a model");
        let camera = Camera::default();
        let pose = SensorFromHead::assume_frames(Rigid::translation(0.0, 0.0, 0.8));
        let start = Placement::from_pose(&camera, &pose).expect("in view").start;
        let fit = fitter.solver.cold(&start);
        let mut lips = |seen: u16, plane_m: f32| {
            let raw = camera.raw_from_m(plane_m).round() as u16;
            let depth: Box<[u16; PIXELS]> = vec![raw; PIXELS].try_into().expect("PIXELS long");
            fitter.landmarks.head = fitter.solver.head(&fit);
            let before = fitter.landmarks.head[UPPER_LIP[0]];
            fitter.seen = seen;
            fitter.correct_protrusion(&fit, &start, &depth, &camera, &pose);
            (
                fitter.landmarks.head[UPPER_LIP[0]].z - before.z,
                camera.depth_m(raw),
            )
        };
        let (first, there) = lips(1, 0.796);
        let (second, nearer) = lips(2, 0.786);
        // All of the face comes nearer; the nose's mean by half of that, and the rest is taken for the pose's error.
        let expected = 0.5 * (nearer - there);
        let moved = second - first;
        assert!((moved - expected).abs() < 5e-4, "{moved} {expected}");
    }
}
