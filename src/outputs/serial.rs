//! Serial line, in one of three styles. `text`: one line of whole numbers per frame that any serial monitor, microcontroller
//! or script reads. `plot`: `AU25:0,AU12L:34` per frame, as the Arduino plotter draws it. `cobs`: binary frames (see
//! `serial/cobs.rs`). The style `text`:
//!
//! ```text
//! $AU,<number>,<t_ms>,<state>,<confidence 0…99>,<weights 0…100>*HH      per frame; `full` instead of 100
//! $AUP,<number>,<x>,<y>,<z mm>,<yaw>,<pitch>,<roll, tenths of a degree>*HH   per frame, if wanted
//! !<gesture> <1 or 0>, !<gesture>/<slot> <1 or 0>                       on change and every 2 s
//! $AUH,1,<schema>,<names of the units>*HH                               on opening and every 5 s
//! ```
//! `HH` is the XOR of all bytes between `$` and `*` as two upper-case hexadecimal digits (as in NMEA 0183); lines end in
//! CR LF. Receivers should ignore lines with a wrong checksum, and may therefore join at any time.
//!
//! If the line is too slow for everything (see `serial/budget.rs`), the rate is lowered; below `min_rate_hz` units are left
//! out. This is decided at start-up and logged once.
//!
//! A line carries one face: the first user seen until lost, then whoever comes next. A separate thread feeds the port, so
//! that a slow or stuck one blocks nothing. One frame is queued, the newest; those it replaces are counted. The thread
//! enforces the baud rate itself, because some ports (USB, pseudo-terminals) accept more than the line carries. A missing
//! port is not an error: it is reopened after 0.5 s, 1 s, … at most 5 s, under the system's stable name for it, if there is
//! one. `tcp:host:port` is a port behind a socket, such as a serial server; there the system buffers what a stuck reader has
//! not read, so the newest frame wins only once those buffers are full.
//! An [`Encoder`] makes the bytes; it also works without an operating system. Memory: four buffers of 2 kB.

mod budget;
mod cobs;
mod encoder;
mod line;
#[cfg(feature = "std")]
mod port;
mod settings;

pub use encoder::Encoder;
pub use line::Line;
#[cfg(feature = "std")]
pub use port::Serial;
#[cfg(feature = "std")]
pub use port::{STABLE_NAMES, stable_name};
pub use settings::{Settings, Style};
