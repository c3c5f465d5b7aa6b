//! Figures against truth: rendered people through the whole pipeline, landmarks against their bars, the paper's experiments.

pub(crate) mod acted;
pub mod figures;
pub mod head_scenes;
pub mod landmark_accuracy;
pub mod sessions;
