//! Training of the face model, and evaluation against truth.
//!
//! ```text
//! train      the face model; units: readings and priors of units
//! fit        landmarks of still images
//! evaluate   figures against truth
//! nrsfm      3D shapes from 2D tracks
//! ```

#[macro_use(println, eprintln)]
extern crate mien_workbench;

pub mod evaluate;
pub mod fit;
pub mod frame_time;
pub mod nrsfm;
pub mod train;
pub mod units;

#[cfg(test)]
#[allow(dead_code, reason = "each crate uses some of it")]
#[path = "../../tests/common/data.rs"]
pub(crate) mod data;
#[cfg(test)]
#[allow(dead_code, reason = "each crate uses some of it")]
#[path = "../../tests/common/golden.rs"]
pub(crate) mod golden;
#[cfg(test)]
#[allow(dead_code, reason = "each crate uses some of it")]
#[path = "../../tests/common/hold.rs"]
mod hold;
