//! Sizes and limits of a model.

use crate::base::capacity::LANDMARKS;

/// Most shape modes.
pub const MAX_MODES: usize = 48;
/// Number of view parameters: log scale, rotation vector (3), shift (2).
pub const VIEW_PARAMETERS: usize = 6;
/// Most parameters updated by a stage.
pub const MAX_PARAMETERS: usize = VIEW_PARAMETERS + MAX_MODES;
/// Bins of gradient orientation.
pub const ORIENTATIONS: usize = 8;
/// Cells along one side of the template of a face.
pub const TEMPLATE_CELLS: usize = 10;
/// Cells along one side of a patch.
pub const PATCH_CELLS: usize = 4;
/// Values of one patch: cells × orientations.
pub const PATCH: usize = PATCH_CELLS * PATCH_CELLS * ORIENTATIONS;
/// Values of all patches of a face.
pub const FEATURES: usize = LANDMARKS * PATCH;
/// Number of inputs of a landmark's confidence.
pub const LANDMARK_INPUTS: usize = 4;
/// Number of inputs of the face's confidence.
pub const FACE_INPUTS: usize = 7;
/// Most stages of one schedule.
pub const MAX_STAGES: usize = 8;
