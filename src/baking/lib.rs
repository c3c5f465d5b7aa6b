//! Heads and their blendshapes.
//!
//! ```text
//! bake    a neutral head and 68 points become a head with blendshapes
//! heads   heads to draw, with the photographs of people; the standard head
//! ```

#[macro_use(println)]
extern crate mien_workbench;

pub mod bake;
pub mod heads;

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
