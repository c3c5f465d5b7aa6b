//! Training of the face model, one step per file.
