//! Servers for pages and programs: JSON over WebSocket ([`websocket`]) and OSCQuery over HTTP ([`oscquery`]), each with a
//! thread and a port of its own ([`server`]). Nothing that comes in reaches the pipeline, and nobody who connects can hold it
//! up: connections, what is read of each and what waits to be written are bounded.

mod handshake;
pub mod oscquery;
mod server;
pub mod websocket;

#[cfg(fuzzing)]
pub use server::fuzz;
