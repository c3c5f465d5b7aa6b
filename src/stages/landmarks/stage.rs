//! The landmark stage: the configured method behind one interface.

use super::fit::{LandmarkFitter, Scratch, Settings};
use super::paper_aam::PaperAamFitter;
use super::points::Landmarks;
use crate::base::capacity::PIXELS;
use crate::base::frames::SensorFromHead;
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;
use crate::base::time::Timestamp;
use crate::camera::Camera;
use crate::face_model::FaceModel;
use crate::pose::{FaceInHead, HeadPose};

/// Landmark method.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Method {
    /// Cascade of regressions on gradient-orientation patches.
    #[default]
    Cascade,
    /// The paper's 2D+3D active appearance model.
    Paper,
}

/// Settings of the stage.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StageSettings {
    /// The method.
    pub method: Method,
    /// Settings of the cascade.
    pub cascade: Settings,
}

/// Why the stage cannot be created.
#[derive(Debug, thiserror::Error)]
pub enum LandmarkError {
    /// The face model has no active appearance model.
    #[error(
        "landmarks.method is \"paper\", but the face model holds no active appearance model; train one with mien-studio train, or set \"cascade\""
    )]
    NoPaperModel,
    /// The face model's active appearance model is invalid.
    #[error(transparent)]
    Paper(#[from] crate::face_model::ModelError),
}

/// The stage.
pub enum LandmarkStage {
    /// [`Method::Cascade`].
    Cascade(Box<LandmarkFitter>),
    /// [`Method::Paper`].
    Paper(Box<PaperAamFitter>),
}

impl LandmarkStage {
    /// Prepares the chosen method; all memory is allocated here.
    ///
    /// # Errors
    /// If the model lacks what the method needs.
    pub fn new(settings: StageSettings, model: &FaceModel) -> Result<Self, LandmarkError> {
        match settings.method {
            Method::Cascade => Ok(Self::Cascade(Box::new(LandmarkFitter::new(
                settings.cascade,
                model,
            )))),
            Method::Paper if model.paper_aam.is_empty() => Err(LandmarkError::NoPaperModel),
            Method::Paper => {
                let fitter = PaperAamFitter::new(&model.paper_aam)?;
                Ok(Self::Paper(Box::new(fitter)))
            }
        }
    }

    /// Fits one frame of grey and raw depth at a head pose; `None` if no face is found there.
    pub fn fit(
        &mut self,
        scratch: &mut Scratch,
        luma: &[u8; PIXELS],
        depth: &[u16; PIXELS],
        camera: &Camera,
        pose: &HeadPose,
        face: &mut FaceInHead,
        at: Timestamp,
    ) -> Option<&Landmarks> {
        match self {
            Self::Cascade(fitter) => fitter.fit(scratch, luma, depth, camera, pose, face, at),
            Self::Paper(fitter) => fitter.fit(luma, depth, camera, pose),
        }
    }

    /// The default method, which can search an image for a face; `None` with the paper's.
    pub fn cascade(&self) -> Option<&LandmarkFitter> {
        match self {
            Self::Cascade(fitter) => Some(fitter),
            Self::Paper(_) => None,
        }
    }

    /// The same, to fit without depth.
    pub fn cascade_mut(&mut self) -> Option<&mut LandmarkFitter> {
        match self {
            Self::Cascade(fitter) => Some(fitter),
            Self::Paper(_) => None,
        }
    }

    /// See [`LandmarkFitter::search_face`]; `None` with the paper's method.
    pub fn search_face(
        &self,
        scratch: &mut Scratch,
        luma: &[u8; PIXELS],
        camera: &Camera,
        guess: &SensorFromHead,
    ) -> Option<(f32, SensorFromHead)> {
        self.cascade()?.search_face(scratch, luma, camera, guess)
    }

    /// Forgets the person.
    pub fn reset(&mut self) {
        match self {
            Self::Cascade(fitter) => fitter.reset(),
            Self::Paper(fitter) => fitter.reset(),
        }
    }
}
