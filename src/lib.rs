//! mien: facial expression from a depth camera, as FACS action-unit weights.
//!
//! ```text
//!                    appliance                                    studio
//!     command line, settings, service, status         train, evaluate, bake, preview
//!                        │                                           │
//!                        ▼                                           │
//!                    pipeline ◄──────────────────────────────────────┤
//!        the stages in order, for every person                       │
//!                        │                                           ▼
//!  sensor ─► segment ─► pose ─► landmarks ─► expression ─► users ─► output      simulator
//!  frame     head       sensor  68 points    measures,     who is   CSV, OSC,   heads, rooms and a
//!  (depth,   clouds     from    in the       ranges,       who      serial      virtual sensor: frames
//!   luma, t)            head    head frame   weights                            as a sensor gives them
//!                                 ▲
//!                            face_model
//!
//!  base: capacities, geometry, time
//! ```
//!
//! Dependencies point down and to the left only, module by module; `tests/it/keeps_its_rooms_apart.rs` enforces it:
//! [`base`], [`sensor`], [`simulator`], [`segment`], [`pose`], [`face_model`], [`landmarks`], [`expression`], [`users`],
//! [`output`], [`pipeline`], [`appliance`], [`studio`]. Within a module files have no circular dependencies. `studio`
//! exists only with the feature `studio`.
//!
//! Units are metres, radians, seconds or [`base::time::Timestamp`]. Others appear only at interfaces, with the unit in the
//! name (`_mm`, `_deg`, `_px`, `_us`).
//!
//! Without the feature `std` the library is limited to what needs no files, clocks, sockets or ports: packets to pictures,
//! the stages, users, and the outputs up to their bytes. It then needs only a memory allocator from its platform.

#![cfg_attr(not(feature = "std"), no_std)]

extern crate alloc;

pub mod base;

pub mod sensor;

#[cfg(feature = "std")]
pub mod simulator;

pub mod segment;

pub mod pose;

pub mod face_model;

pub mod landmarks;

pub mod expression;

pub mod users;

pub mod output;

#[cfg(feature = "std")]
pub mod pipeline;

#[cfg(feature = "std")]
pub mod appliance;

#[cfg(feature = "studio")]
pub mod studio;
