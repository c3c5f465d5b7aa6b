//! mien: facial expression from a Kinect v1, as FACS action-unit weights.
//!
//! ```text
//! sensor ──► segment ──► pose ──► landmarks ──► expression ──────────────► output
//! frame      head cloud  sensor_   68 points    measures → samples →       CSV, serial, OSC
//! (depth,    per user    from_head in head      ranges → unit weights
//!  luma, t)                        frame
//!                      face_model (read at start-up) ◄── studio/train (shape, appearance, NRSFM)
//! ```
//!
//! Dependencies point left and down only: a stage uses [`geometry`], [`capacity`], [`time`] and the output types of the
//! stages to its left. Never a stage to its right, never [`settings`], never [`pipeline`]. [`studio`] may use everything
//! and nothing uses it; it exists only with the feature `studio`.
//!
//! Inside: metres, radians, seconds or [`time::Timestamp`]. Anything else only at a border, with the unit in the name
//! (`_mm`, `_deg`, `_px`, `_us`).

pub mod capacity;
pub mod checksum;
pub mod geometry;
pub mod time;
pub mod vectors;

pub mod sensor;

pub mod segment;

pub mod pose;

pub mod face_model;

pub mod landmarks;

pub mod expression;

pub mod users;

pub mod output;

pub mod bench;
pub mod budget;
pub mod cli;
pub mod devices;
pub mod doctor;
mod few;
mod follower;
mod live;
pub mod log;
pub mod memory;
pub mod pipeline;
pub mod send_test;
pub mod service;
pub mod service_manager;
pub mod settings;
pub mod status;
mod wires;

#[cfg(feature = "studio")]
pub mod studio;
