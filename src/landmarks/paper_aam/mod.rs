//! The paper's own landmark method (`landmarks.method = "paper"`): a 3D active appearance model (section 1.2, equations 1, 2).
//!
//! 2D shape `s = s0 + Σ p_i s_i` (plus four similarity modes) and appearance `A0 + Σ λ_i A_i` are fitted to the picture by
//! simultaneous inverse compositional steps (Matthews and Baker, *Active appearance models revisited*, IJCV 2004; Baker,
//! Gross, Matthews 2003), together with the reprojection error of a 3D shape from non-rigid structure from motion (Xiao,
//! Baker, Matthews, Kanade, *Real-time combined 2D+3D active appearance models*, CVPR 2004). As the paper says the two
//! alternate: given the 2D shape, the 3D shape and view that explain it best, held near the depth head pose; given those,
//! one step of the 2D fit pulled towards their projection. The depth pose also gives the start.
//!
//! Works in the head window ([`super::window`]), window pixels, radians, standard deviations; grey values are brought to zero
//! mean and unit variance in the face. One step costs pixels x parameters² ≈ 10 M operations; some scratch is allocated per
//! frame, unlike the default method. Known limitation: grey values generalise badly across people; this is the
//! reference, the default is [`super::cascade`]. Degenerate: a flat window, a pose outside the picture, a shape that folds or
//! a residual that is not believed gives `None`.

mod model;
mod solver;
pub mod warp;

pub use model::{
    MOST_APPEARANCE_MODES, MOST_HEAD_MODES, MOST_SHAPE_MODES, PaperAam, PaperAamError,
};
#[cfg(feature = "studio")]
pub(crate) use solver::sample;
pub use solver::{AamFit, Solver, similarity_modes};

use super::window::{Placement, Region, WINDOW, sensor_picture};
use super::{Landmarks, empty_landmarks};
use crate::capacity::{LANDMARKS, PIXELS};
use crate::pose::HeadPose;
#[cfg(not(feature = "std"))]
use crate::prelude::*;
use crate::sensor::camera::Camera;
use crate::time::Timestamp;

/// Settings of the method.
#[derive(Clone, Copy, Debug)]
pub struct PaperAamSettings {
    /// Confidence of the face below which it is lost, 0…1.
    pub min_confidence: f32,
    /// Most steps from a cold start.
    pub cold_steps: usize,
    /// Most steps from the last frame's shape.
    pub warm_steps: usize,
}

impl Default for PaperAamSettings {
    fn default() -> Self {
        Self {
            min_confidence: 0.3,
            cold_steps: 20,
            warm_steps: 8,
        }
    }
}

/// Fits the landmarks of one face, frame by frame, by the paper's method.
pub struct PaperAamFitter {
    settings: PaperAamSettings,
    solver: Solver,
    window: Vec<f32>,
    last: Option<AamFit>,
    landmarks: Landmarks,
}

impl PaperAamFitter {
    /// A fitter without history.
    ///
    /// # Errors
    /// The bytes are no such model.
    pub fn new(settings: PaperAamSettings, bytes: &[u8]) -> Result<Self, PaperAamError> {
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
        let warm = self.last.take().map(|last| {
            let first = self.solver.warm(&last, &start);
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
        self.last = Some(fit);
        Some(&self.landmarks)
    }
}
