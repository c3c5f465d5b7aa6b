//! What a face model holds, part by part.

use alloc::borrow::Cow;
use alloc::sync::Arc;

use crate::base::capacity::LANDMARKS;
use crate::base::geometry::{Point, Vector};
use crate::base::prelude::*;
use crate::base::vectors::wide;

use super::refinement::Refinement;
use super::sizes::FACE_SIGNS;

/// 3D shape of faces: mean and modes of variation, head frame, metres.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ShapeModel {
    /// Mean shape, 68 points.
    pub mean: Vec<Point>,
    /// Orthonormal modes: x, y, z of 68 directions each, in one row that a processor can add at once.
    pub modes: Vec<[f32; 3 * LANDMARKS]>,
    /// Standard deviation along each mode, metres, falling.
    pub deviations: Vec<f32>,
}

impl ShapeModel {
    /// Shape for coefficients in standard deviations; coefficients beyond the modes are ignored.
    pub fn shape(&self, coefficients: &[f32], out: &mut [Point; LANDMARKS]) {
        let mut sum = [0.0; 3 * LANDMARKS];
        for (sum, point) in sum.as_chunks_mut::<3>().0.iter_mut().zip(&self.mean) {
            *sum = point.coords.into();
        }
        wide(
            #[inline(always)]
            || {
                let modes = self.modes.iter().zip(&self.deviations);
                for ((mode, deviation), b) in modes.zip(coefficients) {
                    let b = b * deviation;
                    for (sum, along) in sum.iter_mut().zip(mode) {
                        *sum += along * b;
                    }
                }
            },
        );
        for (point, sum) in out.iter_mut().zip(sum.as_chunks::<3>().0) {
            *point = Point::from(*sum);
        }
    }

    /// Coefficients (standard deviations) of the nearest shape of the model.
    pub fn coefficients(&self, shape: &[Point; LANDMARKS], out: &mut [f32]) {
        for ((mode, deviation), b) in self.modes.iter().zip(&self.deviations).zip(out) {
            let directions = mode.as_chunks::<3>().0.iter();
            let along: f32 = directions
                .zip(shape.iter().zip(&self.mean))
                .map(|(direction, (point, mean))| Vector::from(*direction).dot(&(point - mean)))
                .sum();
            *b = along / deviation.max(1e-9);
        }
    }
}

/// One stage of a cascade: a linear map from what the picture shows around the landmarks to an update of the view and of
/// the first shape coefficients; an early stage need not move them all.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CascadeStage {
    /// Distance of neighbouring cells of a patch, window pixels.
    pub cell_px: f32,
    /// Mean features, [`super::sizes::FEATURES`] values.
    pub mean: Vec<f32>,
    /// Update matrix, one row of [`super::sizes::FEATURES`] per parameter that is moved, in units of `scales`.
    pub weights: Cow<'static, [i8]>,
    /// Size of one step of `weights`, per row and landmark.
    pub scales: Vec<f32>,
    /// Columns for what is known beside the picture: the way from the start in the view parameters, then the shape
    /// coefficients; one row of as many columns as there are rows, per row.
    pub prior: Vec<f32>,
    /// Update at the mean features.
    pub bias: Vec<f32>,
}

/// How well a fit is believed: linear discriminants over the last stage's features.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ConfidenceModel {
    /// Distance of neighbouring cells of a patch, window pixels.
    pub cell_px: f32,
    /// Mean features, [`super::sizes::FEATURES`] values.
    pub mean: Vec<f32>,
    /// Direction per landmark in feature space, [`super::sizes::FEATURES`] values.
    pub weights: Vec<f32>,
    /// Logistic slopes on the signs of each landmark ([`crate::landmarks::cascade::landmark_signs`]): 68 × 4.
    pub landmark: Vec<f32>,
    /// Logistic slopes on the signs of the whole face ([`crate::landmarks::cascade::face_signs`]).
    pub face: [f32; FACE_SIGNS],
}

/// All that is learnt offline, read once; the big parts are shared by the fitters of all users.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FaceModel {
    /// Checksum of the file: names the model in logs and reports.
    pub id: u32,
    /// Where the model comes from: data sets, their licences, the training command.
    pub provenance: String,
    /// 3D shape.
    pub shape: ShapeModel,
    /// Stages from the start, the pose from depth and the mean shape: coarse patches, the first shape modes.
    pub cold: Arc<[CascadeStage]>,
    /// Stages that finish the fit: finer patches, all shape modes.
    pub warm: Arc<[CascadeStage]>,
    /// Confidence.
    pub confidence: Arc<ConfidenceModel>,
    /// What depth adds to a fit; models without are used as they are.
    pub refinement: Option<Arc<Refinement>>,
    /// The anchor of the pose stage: points of a generic head with outward unit normals, head frame, metres.
    pub standard_head: Vec<(Point, Vector)>,
    /// The paper's own active appearance model, as its module writes it; empty if the model has none.
    pub paper_aam: Cow<'static, [u8]>,
}
