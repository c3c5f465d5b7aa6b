//! The simulated sensor: a scene with known truth, drawn as raw frames.
