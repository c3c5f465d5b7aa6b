//! mien: facial expression from a depth camera, as FACS action-unit weights.
//!
//! This package holds the two programs and the tests of both. Their code is in the crates below `src`; each depends only on
//! those above it:
//!
//! ```text
//! mien-stages      frames to poses, landmarks, weights, identities; without the standard library if need be
//! mien-sensors     the Kinect v1, recordings
//! mien-simulator   acting heads in rendered rooms, a virtual Kinect
//! mien-outputs     weights as CSV, OSC, serial frames and others
//! mien-appliance   the stages in order for every person; settings, service, status: all of `mien`
//! mien-workbench   files, errors, progress
//! mien-baking      heads and their blendshapes
//! mien-training    the face model, and figures against truth
//! mien-studio      the commands of `mien-studio`
//! ```
