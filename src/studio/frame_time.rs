//! When a Kinect's frames are taken.

use crate::base::time::Timestamp;
use crate::sensor::timestamp_from_ticks;

/// Ticks of the sensor's 60 MHz clock in a frame: 30 a second.
const FRAME_TICKS: i64 = 2_000_000;

/// Time of frame `number` of a sensor that loses none.
#[must_use]
pub fn frame_time(number: i64) -> Timestamp {
    timestamp_from_ticks(number * FRAME_TICKS)
}
