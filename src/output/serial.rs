//! Serial line, in one of three styles. `text`: one line of whole numbers per frame that any serial monitor, microcontroller
//! or script reads. `plot`: `AU25:0,AU12L:34` per frame, as the Arduino plotter draws it. `cobs`: binary frames (see
//! `serial/cobs.rs`). The style `text`:
//!
//! ```text
//! $AU,<number>,<t_ms>,<state>,<confidence 0…99>,<weights 0…100>*HH      per frame; `full` instead of 100
//! $AUP,<number>,<x>,<y>,<z mm>,<yaw>,<pitch>,<roll, tenths of a degree>*HH   per frame, if wanted
//! $AUH,1,<schema>,<names of the units>*HH                               on opening and every 5 s
//! ```
//! `HH` is the XOR of all bytes between `$` and `*`, two upper-case hexadecimal digits (the rule of NMEA 0183); lines end in
//! CR LF. A line that does not check is to be ignored, so a receiver may join at any time.
//!
//! What the line cannot carry is planned at the start (see `serial/budget.rs`): the rate is lowered, below `min_rate_hz`
//! units are left out, and the log says so once.
//!
//! A line has one face: the first user seen is followed until lost, then whoever comes next. A thread of its own feeds the
//! port, so that a slow or stuck one holds up nothing: one frame waits, the newest; those it replaces are counted. The
//! thread keeps to the baud rate itself, because some ports (USB, pseudo-terminals) take more than the line does. A port
//! that is absent or unplugged is a state: it is tried again after 0.5 s, 1 s, … at most 5 s, for as long as it takes, under
//! the stable name the system has for it, if it has one. `tcp:host:port` is a port behind a socket, as of a serial server;
//! there the system keeps what a stuck reader has not read, so the newest frame wins only once that is full.
//! What is written is made by an [`Encoder`], which a line without a system around it may use by itself.
//! Memory: four buffers of 2 kB.

mod budget;
mod cobs;
mod encoder;
mod frame;
mod line;
#[cfg(feature = "std")]
mod port;
#[cfg(feature = "studio")]
mod receive;
#[cfg(feature = "std")]
mod sender;
mod settings;

pub use encoder::Encoder;
pub use line::Line;
#[cfg(feature = "std")]
pub use port::PortState;
#[cfg(feature = "studio")]
pub use receive::Receiver;
#[cfg(feature = "std")]
pub use sender::Serial;
pub use settings::{Settings, Style};
