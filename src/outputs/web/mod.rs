//! Servers for pages and programs: JSON over WebSocket ([`websocket`]) and a page to watch and command the box ([`page`]), each
//! with its own thread and port ([`server`]). Of all input only the page's commands reach the pipeline. No client can block it,
//! because connections and their buffers are bounded.

mod http;
pub mod page;
mod server;
pub mod websocket;

#[cfg(fuzzing)]
pub use http::fuzz;
