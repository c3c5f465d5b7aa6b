//! Figures against truth: rendered people through the whole pipeline, landmarks against their bars, the paper's experiments.
//!
//! ```text
//! acted              what each weight should be while a drawn head acts
//! sessions           people never trained on act before the simulated sensor: pose, points, weights
//! head_scenes        one and several heads, hands, rooms: pose, ids, loss, time
//! landmark_accuracy  the face model alone, under every condition and on photographs
//! figures            the paper's figures, drawn again
//! ```

/// What `mien-studio evaluate --help` says beyond the usage.
pub const OPTIONS: &str = "  --data       folder of the data sets; default MIEN_DATA of the environment, else ../shared/data
  --model      face model; default: the one built in
  --config     configuration; default: the one built in
  --people     at most this many of the split; default all
  --seconds    length of a session; default 45
  --split      whose sessions: test (never looked at while building), dev (for choosing settings), train; default test
  --seed       of everything random; default 77
  --landmarks  the face model alone: every condition on drawn and on real faces; sessions of 5 s
  --heads      scenes of 10 s with one and with several heads, hands and rooms, 4 people; --rows chooses some
  --wild       people with hair, clothes and accessories before a sensor with realistic faults, 20 s; --pictures writes
               three pictures of each into a folder
  --figures    the figures of docs/paper.md into a folder; --rows chooses some
";

pub(crate) mod acted;
pub mod figures;
pub mod head_scenes;
pub mod landmark_accuracy;
pub mod sessions;
