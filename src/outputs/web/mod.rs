//! Servers for pages and programs: JSON over WebSocket ([`websocket`]) and a page to watch and command the box ([`page`]), each
//! with its own thread and port ([`server`]). Of what is received only the page's commands reach the pipeline, and no client can
//! block it: connections and their read and write buffers are bounded.

mod http;
pub mod page;
mod server;
pub mod websocket;

#[cfg(fuzzing)]
pub use http::fuzz;
