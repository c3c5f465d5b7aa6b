//! How large the parts of a model are, or may be.

use crate::base::capacity::LANDMARKS;

/// Most shape modes a model may have.
pub const MAX_MODES: usize = 48;
/// Parameters of the view: log scale, rotation vector (3), shift (2).
pub const VIEW_PARAMETERS: usize = 6;
/// Most parameters a stage updates.
pub const MAX_PARAMETERS: usize = VIEW_PARAMETERS + MAX_MODES;
/// Orientations of the gradient that are told apart.
pub const ORIENTATIONS: usize = 8;
/// Cells along one side of a patch.
pub const PATCH_CELLS: usize = 4;
/// Values of one patch: cells × orientations.
pub const PATCH: usize = PATCH_CELLS * PATCH_CELLS * ORIENTATIONS;
/// Values of all patches of a face.
pub const FEATURES: usize = LANDMARKS * PATCH;
/// Numbers that a landmark's confidence follows from.
pub const LANDMARK_SIGNS: usize = 4;
/// Numbers that the face's confidence follows from.
pub const FACE_SIGNS: usize = 7;
/// The first of them, which models have had from the beginning.
pub const FIRST_FACE_SIGNS: usize = 4;
/// Most stages of one schedule.
pub const MAX_STAGES: usize = 8;
