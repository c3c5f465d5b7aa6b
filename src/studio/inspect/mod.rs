//! `mien-studio inspect`: a recording, a run's CSV, a face model, a mesh or remembered people, as one HTML
//! page or one PNG sheet.
//!
//! ```text
//! command ─► what the path is:  recording
//!                               run, model, mesh, ranges
//!            each draws on a canvas and fills an album ─► HTML page (page) or PNG sheet
//! ```

pub mod album;
pub mod canvas;
mod command;
mod depth_colours;
mod mesh;
mod model;
mod page;
mod ranges;
mod recording;
mod run;

pub use command::{album, inspect};
pub(in crate::studio) use depth_colours::DepthColours;
pub(in crate::studio) use recording::colour_picture;
