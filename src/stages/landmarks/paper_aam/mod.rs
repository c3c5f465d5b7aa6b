//! The paper's own landmark method (`landmarks.method = "paper"`): a 3D active appearance model (section 1.2, equations 1, 2).
//!
//! The 2D shape is the projection, at the head pose, of a 3D shape `S0 + Σ p_i S_i` from non-rigid structure from motion;
//! appearance is `A0 + Σ λ_i A_i`. The fit ([`solver`]) minimises the difference between the image inside the shape and the
//! appearance (Matthews and Baker, *Active appearance models revisited*, IJCV 2004; Xiao, Baker, Matthews, Kanade, *Real-time
//! combined 2D+3D active appearance models*, CVPR 2004), starting from the depth pose and regularised by it. 2D and 3D share
//! their shape parameters. How a face sits in its head is a constant of the person: after the first frames the picture moves the
//! face little from there. How far lips and eye corners stand out is read from depth: no frontal picture shows it.
//!
//! Works in the head window ([`super::window`]), window pixels, radians, standard deviations; grey values are compared
//! relative to their surroundings ([`grey`]). One step costs pixels x parameters x modes ≈ 6 M operations; some scratch is
//! allocated per frame, unlike the default method. Limitation: a mouth that is open when a person is first seen may be taken
//! for a closed one until it closes. Degenerate: a flat window, a pose outside the picture or an implausibly large residual
//! gives `None`.

mod grey;
mod model;
mod solver;
pub mod warp;

pub use model::{MOST_APPEARANCE_MODES, MOST_HEAD_MODES, PaperAam};
pub use solver::{AamFit, Expected, Solver};
#[cfg(feature = "studio")]
pub use {grey::normalised, solver::sample};

use super::points::Landmarks;
use super::refine;
use super::view::View;
use super::window::{Placement, Region, WINDOW, sensor_picture};
use crate::base::capacity::{LANDMARKS, PIXELS};
use crate::base::frames::{HeadFromFace, SensorFromHead};
use crate::base::geometry::{Point, Vector};
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;
use crate::camera::Camera;
use crate::face_model::refinement::place_of;
use crate::face_model::scheme::{
    INNER_EYE_CORNERS, LOWER_LIP, NOSE_LINE, OUTER_EYE_CORNERS, UPPER_LIP,
};
use crate::face_model::{ModelError, VIEW_PARAMETERS};
use crate::pose::HeadPose;

/// Spread of a known person's face about where it usually is, as a share of a stranger's; frames that the mean is taken over.
const KNOWN_SPREAD: f32 = 0.125;
const USUAL_FRAMES: u16 = 600;
/// What the model leaves of a person starts from nothing, as if seen over so many frames before.
const STRANGE_FRAMES: f32 = 30.0;
/// Least confidence of a frame that teaches it, and share of the face seen: who walks in is blurred and from the side.
const TEACHING_CONFIDENCE: f32 = 0.8;
const TEACHING_SEEN: f32 = 0.8;
/// After so many of them the fit of a face that came in from the side starts cold once more; what it leaves counts from then on.
const RESTARTED: u16 = 20;

/// Confidence of the face below which it is lost, 0…1.
const MIN_CONFIDENCE: f32 = 0.3;
/// Most iterations from a cold start, and from the last frame's shape.
const COLD_STEPS: usize = 20;
const WARM_STEPS: usize = 8;

/// Fits the landmarks of one face, frame by frame, by the paper's method.
pub struct PaperAamFitter {
    solver: Solver,
    window: Vec<f32>,
    /// The last frame's fit, and the view of its depth pose.
    last: Option<(AamFit, View)>,
    /// How far this person's face usually is from the depth pose, and over how many frames that was seen.
    usual: [f32; VIEW_PARAMETERS],
    seen: u16,
    /// How much nearer the base of their nose and their inner and outer eye corners usually are than the model's, metres.
    bone: [f32; 3],
    /// Whether they were first seen from the side.
    guessed: bool,
    landmarks: Landmarks,
}

impl PaperAamFitter {
    /// A fitter without history.
    ///
    /// # Errors
    /// If the bytes are not such a model.
    pub fn new(bytes: &[u8]) -> Result<Self, ModelError> {
        Ok(Self {
            solver: Solver::new(PaperAam::parse(bytes)?),
            window: vec![0.0; WINDOW * WINDOW],
            last: None,
            usual: [0.0; VIEW_PARAMETERS],
            seen: 0,
            bone: [0.0; 3],
            guessed: false,
            landmarks: Landmarks::default(),
        })
    }

    /// Forgets the person: the next frame starts cold.
    pub fn reset(&mut self) {
        self.last = None;
        (self.usual, self.seen) = ([0.0; VIEW_PARAMETERS], 0);
        self.bone = [0.0; 3];
        self.guessed = false;
        self.solver.usual_left.fill(0.0);
    }

    /// Fits one frame; `None` if there is no face to be found at the pose.
    pub fn fit(
        &mut self,
        luma: &[u8; PIXELS],
        depth: &[u16; PIXELS],
        camera: &Camera,
        pose: &HeadPose,
    ) -> Option<&Landmarks> {
        let Some(placement) = Placement::of_pose(camera, &pose.sensor_from_head) else {
            self.last = None;
            return None;
        };
        placement.resample(&sensor_picture(luma), &Region::WHOLE, &mut self.window);
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
            self.landmarks.pixels[i] = placement.picture_pixel(fit.shape[i]);
        }
        self.landmarks.head = self.solver.head(&fit);
        self.learn_usual(&fit, &start);
        self.stand_out(&fit, &start, depth, camera, &pose.sensor_from_head);
        self.landmarks.point_confidence = fit.point_confidence;
        self.landmarks.confidence = fit.confidence;
        // What a stranger was taken for from the side would stay.
        self.guessed |= self.seen == 0 && fit.seen < TEACHING_SEEN;
        let restarts = self.seen == RESTARTED && core::mem::take(&mut self.guessed);
        self.last = (!restarts).then_some((fit, start));
        Some(&self.landmarks)
    }

    /// Where depth expects the face.
    fn expected(&self, depth: &View) -> Expected {
        let known = f32::from(self.seen);
        Expected {
            view: depth.moved(&self.usual),
            spread: KNOWN_SPREAD.hypot((1.0 + known).recip()),
        }
    }

    /// Learns how the face sits in the head.
    fn learn_usual(&mut self, fit: &AamFit, start: &View) {
        if fit.confidence < TEACHING_CONFIDENCE || fit.seen < TEACHING_SEEN {
            return;
        }
        self.seen = (self.seen + 1).min(USUAL_FRAMES);
        if self.seen > RESTARTED {
            let frames = f32::from(self.seen - RESTARTED) + STRANGE_FRAMES;
            self.solver.learn(1.0 / frames);
        }
        for (usual, off) in self.usual.iter_mut().zip(fit.view.step_from(start)) {
            *usual += (off - *usual) / f32::from(self.seen);
        }
    }

    /// Eye corners stand out as far as depth usually shows, being on bone; lips as far as it shows now, less the deviation of the
    /// nose above them from its usual, which is the pose's error.
    fn stand_out(
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
        let nearer = refine::nearer(head, size, depth, camera, &face);
        // Along the line of sight, so that the picture's points stay where they are.
        let sight = face.rotation.inverse() * (face * Point::origin()).coords;
        // Each as a whole: their points' distances stay the picture's.
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
            for by in points.iter().map(|&i| nearer[place_of(i)]) {
                if by.is_finite() {
                    (sum, count) = (sum + by, count + 1.0);
                }
            }
            let seen = (count > 0.0).then(|| sum / count);
            let by = if let Some(usual) = self.bone.get_mut(part) {
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
