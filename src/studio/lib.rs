//! The commands of `mien-studio`.
//!
//! ```text
//! cli            the command line, for commands here and in `mien-baking` and `mien-training`
//! record         recording from the sensor or the simulator
//! inspect        files as a page or a sheet of images; chart: curves and text in them
//! preview        a live page of received data
//! place          a page for placing the 68 points on a head
//! animate        a recorded run's weights as animation of a baked head
//! ```

#[macro_use(print, println, eprintln)]
extern crate mien_workbench;

pub mod animate;
pub mod chart;
pub mod cli;
pub mod completions;
pub mod inspect;
pub mod place;
pub mod preview;
pub mod record;

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
