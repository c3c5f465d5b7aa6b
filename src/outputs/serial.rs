//! Serial line in one of three styles. `text`: a line of numbers per frame, for serial monitors, microcontrollers and scripts.
//! `plot`: `AU25:0,AU12L:34` per frame, for the Arduino plotter. `cobs`: binary frames (`serial/cobs.rs`). The style `text`:
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
//! If the line is too slow (`serial/budget.rs`), the rate is lowered; to keep `min_rate_hz`, units are omitted. This is decided at
//! start-up and logged once.
//!
//! A line carries one face: the first user seen until lost, then the next. A separate thread writes to the port, so that a slow or
//! stuck port blocks nothing. Only the newest frame is queued; replaced ones are counted. The thread enforces the baud rate itself,
//! because some ports (USB, pseudo-terminals) accept more than the line carries. A missing port is not an error: it is reopened
//! after 0.5 s, 1 s, … at most 5 s, under the system's stable name for it, if there is one. `tcp:host:port` is a serial server;
//! there the system buffers unread data, so frames are replaced only once its buffers are full. The [`Encoder`] also works without
//! an operating system. Memory: four buffers of 2 kB.

mod budget;
mod cobs;
mod encoder;
mod line;
#[cfg(feature = "std")]
mod port;
#[cfg(feature = "studio")]
pub mod receiver;
mod settings;

pub use encoder::Encoder;
pub use line::Line;
#[cfg(feature = "std")]
pub use port::Serial;
#[cfg(feature = "std")]
pub use port::{STABLE_NAMES, stable_name};
pub use settings::{Settings, Style};
