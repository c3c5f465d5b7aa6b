//! Training of the face model, one step per file.
//!
//! `shape` samples a population of 3D faces and takes its principal components; `points` fits them to annotated
//! portraits; `samples` cuts head windows with disturbed starts; `cascade` learns the update matrices by ridge regression
//! where the previous stage really ends; `confidence` learns what a fitted face looks like; `evaluate` measures people who
//! were not trained on. All of it is seeded.

pub mod dataset;
pub mod points;
pub mod render;
pub mod shape;
pub mod standard_head;
