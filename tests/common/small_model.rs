//! A small face model for tests that read very many.

use mien_stages::face_model::{self, FaceModel};

/// The shipped shape and every sixteenth point of its head, as a file without the cascade: its weights are not looked at when
/// stages are built.
pub fn small_model() -> Vec<u8> {
    let mut model = FaceModel::shipped();
    (model.cold, model.warm) = (Vec::new().into(), Vec::new().into());
    (model.refinement, model.paper_aam) = (None, Vec::new().into());
    model.standard_head = model.standard_head.into_iter().step_by(16).collect();
    face_model::file::emit(&model)
}
