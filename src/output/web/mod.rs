//! Servers for pages and programs: JSON over WebSocket ([`websocket`]), OSCQuery over HTTP ([`oscquery`]) and a page to read
//! and command the box ([`page`]), each with a thread and a port of its own ([`server`]). Of what comes in only the page's
//! commands reach the pipeline, and nobody who connects can hold it up: connections, what is read of each and what waits to
//! be written are bounded.

mod handshake;
pub mod oscquery;
pub mod page;
mod server;
pub mod websocket;
