//! The memory of the live sensor, part by part, added up at compile time: as [`crate::pipeline::budget`] does for the stages.
//! A recording or the simulated sensor uses other buffers instead.
//!
//! | part | bytes | what |
//! | --- | --- | --- |
//! | waiting frames | 2 × 729,600 | in the ring or being unpacked |
//! | pairing | 729,600 | one picture per stream |
//! | assembling | 729,600 | one picture per stream |
//! | transfers | 983,040 | 16 per stream, in flight or landed |
//! | **live sensor** | **3,901,440** | of 8 MiB |

use super::packet::LONGEST;
use super::pairing::RawPair;
use crate::base::capacity::{PACKETS, TRANSFERS, WAITING_FRAMES};

/// Frames between the sensor's thread and the stages.
pub const WAITING: usize = WAITING_FRAMES * RawPair::BYTES;
/// Pictures that wait for their other half, and those that are being assembled.
pub const PICTURES: usize = 2 * RawPair::BYTES;
/// Transfers of both streams.
pub const IN_FLIGHT: usize = 2 * TRANSFERS * PACKETS * LONGEST;
/// The live sensor.
pub const SENSOR: usize = WAITING + PICTURES + IN_FLIGHT;

const _: () = assert!(SENSOR <= 8 << 20, "the sensor exceeds its memory budget");
