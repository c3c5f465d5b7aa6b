//! The commands of `mien-studio`.
//!
//! ```text
//! cli            the command line: words to the commands below, and to those of `mien-baking` and `mien-training`
//! record         a recording from the sensor or the simulator
//! inspect        any of our files as a page or a sheet of pictures; chart: curves and words in them
//! preview        a page that shows live what is received
//! place          a page to put the 68 points on a head
//! animate        the weights of a run move a baked head
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
