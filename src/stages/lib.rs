//! The stages: from a [`frame::Frame`] to head clouds, poses, landmarks, measures, ranges, unit weights and user identity.
//!
//! ```text
//!  frame, camera ─► segment ─► pose ─► landmarks ─► expression ─► users
//!  depth, luma, t   head       sensor  68 points    measures,     identity
//!                   clouds     from    in the       ranges,
//!                              head    head frame   weights
//!                                       ▲
//!                                  face_model
//!
//!  base: capacities, geometry, time          turn: a sensor on its side
//! ```
//!
//! Dependencies point down and to the left, module by module; `tests/it/keeps_its_modules_apart.rs` enforces it.
//!
//! Units are metres, radians, seconds or [`base::time::Timestamp`]. Others appear only at interfaces, with the unit in the
//! name (`_mm`, `_deg`, `_px`, `_us`).
//!
//! Without the feature `std` the crate needs a memory allocator and nothing else: no files, clocks or threads.

#![cfg_attr(not(feature = "std"), no_std)]

extern crate alloc;

pub mod base;
pub mod camera;
pub mod frame;
pub mod turn;

pub mod segment;

pub mod pose;

pub mod face_model;

pub mod landmarks;

pub mod expression;

pub mod users;

#[cfg(test)]
extern crate self as mien_stages;
#[cfg(test)]
#[path = "../../tests/common/toy_face.rs"]
mod toy_face;
