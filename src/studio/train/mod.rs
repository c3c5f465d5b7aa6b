//! Training of the face model, one step per file.

pub mod standard_head;
