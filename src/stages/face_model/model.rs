//! Parts of a face model.

use alloc::borrow::Cow;
use alloc::sync::Arc;

use crate::base::capacity::LANDMARKS;
use crate::base::geometry::{Point, Vector};
use crate::base::prelude::*;
use crate::base::vectors::with_avx2;

use super::reader::Short;
use super::refinement::Refinement;
use super::sizes::{FACE_INPUTS, PATCH};

/// 3D shape of faces: mean and modes of variation, head frame, metres.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ShapeModel {
    /// Mean shape, 68 points, head frame, metres.
    pub mean: Vec<Point>,
    /// Orthonormal modes: x, y, z of 68 directions each, in one row for vector instructions.
    pub modes: Vec<[f32; 3 * LANDMARKS]>,
    /// Standard deviation along each mode, metres, decreasing.
    pub deviations: Vec<f32>,
}

impl ShapeModel {
    /// Shape (head frame, metres) of coefficients in standard deviations; coefficients beyond the modes are ignored.
    pub fn shape(&self, coefficients: &[f32], out: &mut [Point; LANDMARKS]) {
        let mut sum = [0.0; 3 * LANDMARKS];
        for (sum, point) in sum.as_chunks_mut::<3>().0.iter_mut().zip(&self.mean) {
            *sum = point.coords.into();
        }
        with_avx2(
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

    /// Coefficients, in standard deviations, of the model's nearest shape.
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

/// One stage of a cascade: a linear map from image features around the landmarks to an update of the view and the first shape
/// coefficients; early stages update fewer.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CascadeStage {
    /// Distance of neighbouring cells of a patch, window pixels.
    pub cell_px: f32,
    /// Mean features in units of 1 / [`MEAN_STEPS`], [`super::sizes::FEATURES`] values.
    pub mean: Cow<'static, [u8]>,
    /// Update matrix: one row of [`super::sizes::FEATURES`] weights per updated parameter, two bits each; see [`weight_at`].
    pub levels: Cow<'static, [u8]>,
    /// Unit of the weights, per row and landmark.
    pub scales: Vec<Short>,
    /// Square matrix (as many columns as rows) on the inputs besides the image: displacement of the view from the start, then the
    /// shape coefficients.
    pub prior: Vec<Short>,
    /// Update at the mean features.
    pub bias: Vec<f32>,
}

/// Steps of a mean feature from 0 to 1.
pub const MEAN_STEPS: f32 = 255.0;
/// Weights in a byte.
pub const LEVELS_PER_BYTE: usize = 4;
/// Bytes of the weights of one patch.
pub const PATCH_BYTES: usize = PATCH / LEVELS_PER_BYTE;

/// Weight `k` of a patch, in units of its scale: -3, -1, 1 or 3. Byte `b` has the levels (0 to 3) of the weights `b`, `b` + 32, `b` +
/// 64 and `b` + 96, the first in its lowest bits, so that one shift serves the same bits of neighbouring bytes.
pub fn weight_at(levels: &[u8; PATCH_BYTES], k: usize) -> i32 {
    let level = levels[k % PATCH_BYTES] >> (2 * (k / PATCH_BYTES)) & 3;
    2 * i32::from(level) - 3
}

/// Confidence of a fit: linear discriminants over the last stage's features.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ConfidenceModel {
    /// Distance of neighbouring cells of a patch, window pixels.
    pub cell_px: f32,
    /// Mean features in units of 1 / [`MEAN_STEPS`], [`super::sizes::FEATURES`] values.
    pub mean: Vec<u8>,
    /// Discriminant of each landmark's patch in units of its scale, [`super::sizes::FEATURES`] values in all.
    pub weights: Vec<i8>,
    /// Unit of the weights, per landmark.
    pub scales: Vec<f32>,
    /// Logistic slopes on the inputs of each landmark ([`crate::landmarks::cascade::landmark_inputs`]): 68 × 4.
    pub landmark: Vec<f32>,
    /// Logistic slopes on the inputs of the whole face ([`crate::landmarks::cascade::face_inputs`]).
    pub face: [f32; FACE_INPUTS],
}

/// Everything learnt offline, read once; the large parts are shared by the fitters of all users.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FaceModel {
    /// Checksum of the file: identifies the model in logs and reports.
    pub id: u32,
    /// Data sets, their licences, and the training command.
    pub provenance: String,
    /// 3D shape model.
    pub shape: ShapeModel,
    /// First stages, from the depth pose and the mean shape: coarse patches, the first shape modes.
    pub cold: Arc<[CascadeStage]>,
    /// Last stages: finer patches, all shape modes.
    pub warm: Arc<[CascadeStage]>,
    /// Confidence model.
    pub confidence: Arc<ConfidenceModel>,
    /// Correction of a fit by depth, if the model has one.
    pub refinement: Option<Arc<Refinement>>,
    /// Standard head of the pose stage: points with outward unit normals, head frame, metres.
    pub standard_head: Vec<(Point, Vector)>,
    /// Bytes of the paper's active appearance model ([`crate::landmarks::paper_aam::PaperAam`]); empty if there is none.
    pub paper_aam: Cow<'static, [u8]>,
}
