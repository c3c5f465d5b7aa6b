//! Evaluation against truth: rendered people through the whole pipeline, landmarks against their bounds, the paper's
//! experiments.
//!
//! ```text
//! acted              true weights of an acting head
//! sessions           people, length and comparison of sessions
//! played, table      people never trained on act before the simulated sensor: pose, points, weights
//! by_person          the same for heads of every age, a row each, and for faces with one weak side
//! head_scenes        one and several heads, hands, rooms: pose, ids, loss
//! landmark_accuracy  the face model alone, under every condition and on photographs
//! paper              the paper's experiments: its own system beside the default
//! ```

pub(crate) mod acted;
pub mod by_person;
pub mod head_scenes;
pub mod landmark_accuracy;
pub mod paper;
mod played;
pub mod sessions;
pub mod table;
#[cfg(test)]
mod tests;
