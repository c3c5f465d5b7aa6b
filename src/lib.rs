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
//!
//! Without the feature `std` the library is what needs no files, clocks, sockets or ports: packets to pictures, the stages,
//! users, and the outputs up to their bytes. It then wants a memory allocator and nothing else of its platform.

#![cfg_attr(not(feature = "std"), no_std)]

extern crate alloc;

#[cfg(not(feature = "std"))]
mod prelude;

pub mod capacity;
pub mod checksum;
pub mod geometry;
pub mod shared;
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

#[cfg(feature = "std")]
pub mod bench;
#[cfg(feature = "std")]
mod bounded;
pub mod budget;
#[cfg(feature = "std")]
pub mod cli;
#[cfg(feature = "std")]
pub mod devices;
#[cfg(feature = "std")]
pub mod doctor;
#[cfg(feature = "std")]
mod few;
#[cfg(feature = "std")]
mod follower;
#[cfg(all(test, feature = "std"))]
mod golden;
#[cfg(feature = "std")]
mod live;
#[cfg(feature = "std")]
pub mod log;
#[cfg(feature = "std")]
pub mod memory;
#[cfg(feature = "std")]
mod pipe;
#[cfg(feature = "std")]
pub mod pipeline;
#[cfg(feature = "std")]
pub mod send_test;
#[cfg(feature = "std")]
pub mod service;
#[cfg(feature = "std")]
pub mod service_manager;
#[cfg(feature = "std")]
pub mod settings;
#[cfg(feature = "std")]
pub mod status;
#[cfg(feature = "std")]
mod wires;

#[cfg(feature = "studio")]
pub mod studio;
