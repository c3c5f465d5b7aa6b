//! Servers for pages and programs: JSON over WebSocket (`websocket`) and a page to watch and command the box (`page`), each
//! with its own thread and port (`server`). Of all input only the page's commands reach the pipeline. No client can block it,
//! because connections and their buffers are bounded. Requests ([`http`]) are also those of the workstation's server.

#[cfg(feature = "wires")]
mod frames;
pub mod http;
#[cfg(feature = "wires")]
pub mod page;
#[cfg(feature = "wires")]
mod server;
#[cfg(feature = "wires")]
pub mod websocket;

#[cfg(all(fuzzing, feature = "wires"))]
pub use frames::fuzz;
