//! mien: facial expression from a depth camera, as FACS action-unit weights.
//!
//! This package holds the two programs and their tests. The code is in the crates below `src`; each depends only on crates
//! listed above it:
//!
//! ```text
//! mien-stages      frames to poses, landmarks, weights, identities; no_std without the feature std
//! mien-sensors     the Kinect v1, recordings
//! mien-simulator   rendered scenes with acting heads, a virtual Kinect
//! mien-outputs     weights as CSV, OSC, serial frames and others
//! mien-appliance   the program `mien`: pipeline for all people, settings, service, status
//! mien-workbench   files, errors, progress
//! mien-linear      sparse and dense symmetric systems, through faer
//! mien-baking      heads and their blendshapes
//! mien-training    training of the face model, evaluation against ground truth
//! mien-studio      the commands of `mien-studio`
//! ```
