//! The paper's own landmark method (`landmarks.method = "paper"`): a 3D active appearance model (section 1.2, equations 1, 2).
//!
//! The 2D shape is the projection, at the head pose, of a 3D shape `S0 + Σ p_i S_i` from non-rigid structure from motion;
//! appearance is `A0 + Σ λ_i A_i`. The fit ([`solver`]) minimises the difference between the image inside the shape and the
//! appearance (Matthews and Baker, *Active appearance models revisited*, IJCV 2004; Xiao, Baker, Matthews, Kanade, *Real-time
//! combined 2D+3D active appearance models*, CVPR 2004), starting from the depth pose and regularised by it. 2D and 3D share
//! their shape parameters.
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
pub use solver::{AamFit, Solver};
#[cfg(feature = "studio")]
pub(crate) use {grey::normalised, solver::sample};

use super::points::{Landmarks, empty_landmarks};
use super::view::View;
use super::window::{Placement, Region, WINDOW, sensor_picture};
use crate::base::capacity::{LANDMARKS, PIXELS};
use crate::base::defaults;
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;
use crate::base::time::Timestamp;
use crate::face_model::ModelError;
use crate::pose::HeadPose;
use crate::sensor::camera::Camera;

defaults! {
    /// Settings of the method.
    #[derive(Clone, Copy, Debug)]
    pub struct PaperAamSettings {
        /// Confidence of the face below which it is lost, 0…1.
        pub min_confidence: f32 = 0.3,
        /// Most iterations from a cold start.
        pub cold_steps: usize = 20,
        /// Most iterations from the last frame's shape.
        pub warm_steps: usize = 8,
    }
}

/// Fits the landmarks of one face, frame by frame, by the paper's method.
pub struct PaperAamFitter {
    settings: PaperAamSettings,
    solver: Solver,
    window: Vec<f32>,
    /// The last frame's fit, and the view of its depth pose.
    last: Option<(AamFit, View)>,
    landmarks: Landmarks,
}

impl PaperAamFitter {
    /// A fitter without history.
    ///
    /// # Errors
    /// If the bytes are not such a model.
    pub fn new(settings: PaperAamSettings, bytes: &[u8]) -> Result<Self, ModelError> {
        Ok(Self {
            settings,
            solver: Solver::new(PaperAam::parse(bytes)?),
            window: vec![0.0; WINDOW * WINDOW],
            last: None,
            landmarks: empty_landmarks(),
        })
    }

    /// Forgets the person: the next frame starts cold.
    pub fn reset(&mut self) {
        self.last = None;
    }

    /// Fits one frame; `None` if there is no face to be found at the pose.
    pub fn fit(
        &mut self,
        luma: &[u8; PIXELS],
        camera: &Camera,
        pose: &HeadPose,
        _at: Timestamp,
    ) -> Option<&Landmarks> {
        let Some(placement) = Placement::of_pose(camera, &pose.sensor_from_head) else {
            self.last = None;
            return None;
        };
        placement.resample(&sensor_picture(luma), &Region::WHOLE, &mut self.window);
        let start = placement.start;
        let believed = |fit: &AamFit| fit.confidence >= self.settings.min_confidence;
        let warm = self.last.take().map(|(last, depth)| {
            let first = self.solver.warm(&last, &depth, &start);
            self.solver
                .run(&self.window, first, &start, self.settings.warm_steps)
        });
        let fit = match warm {
            Some(fit) if believed(&fit) => fit,
            _ => {
                let first = self.solver.cold(&start);
                self.solver
                    .run(&self.window, first, &start, self.settings.cold_steps)
            }
        };
        if !believed(&fit) {
            return None;
        }
        for i in 0..LANDMARKS {
            self.landmarks.pixels[i] = placement.picture_pixel(fit.shape[i]);
        }
        self.landmarks.head = self.solver.head(&fit);
        self.landmarks.point_confidence = fit.point_confidence;
        self.landmarks.confidence = fit.confidence;
        self.last = Some((fit, start));
        Some(&self.landmarks)
    }
}
