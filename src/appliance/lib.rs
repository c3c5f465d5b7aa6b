//! The program `mien`: pipeline for all people, command line, settings, service and status.

pub mod bench;
pub mod cli;
pub mod devices;
pub mod doctor;
mod levels;
pub mod log;
pub mod memory;
mod pipe;
pub mod pipeline;
pub mod run;
pub mod send_test;
pub mod service;
pub mod service_manager;
pub mod settings;
mod signals;
pub mod source;
pub mod status;
mod terminal;

#[cfg(test)]
#[allow(dead_code, reason = "each crate uses some of it")]
#[path = "../../tests/common/data.rs"]
mod data;
#[cfg(test)]
#[allow(dead_code, reason = "each crate uses some of it")]
#[path = "../../tests/common/hold.rs"]
mod hold;
#[cfg(test)]
#[path = "../../tests/common/toy_face.rs"]
mod toy_face;
