//! The program `mien`: command line and settings, the service that runs the pipeline, and its status.

pub mod bench;
pub mod cli;
pub mod devices;
pub mod doctor;
pub mod log;
pub mod memory;
mod pipe;
pub mod run;
pub mod send_test;
pub mod service;
pub mod service_manager;
pub mod settings;
mod signals;
pub mod source;
pub mod status;
mod terminal;
pub mod wires;
