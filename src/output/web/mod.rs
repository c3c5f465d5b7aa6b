//! Servers for pages and programs: JSON over WebSocket ([`websocket`]) and OSCQuery over HTTP ([`oscquery`]), each with its
//! own thread and port ([`server`]). Nothing received reaches the pipeline, and no client can block it: connections and
//! their read and write buffers are bounded.

mod handshake;
pub mod oscquery;
mod server;
pub mod websocket;

#[cfg(fuzzing)]
pub use server::fuzz;
