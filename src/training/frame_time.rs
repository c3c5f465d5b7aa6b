//! Capture times of a Kinect's frames.

use mien_sensors::kinect::picture_clock::{FRAME_TICKS, timestamp_from_ticks};
use mien_stages::base::time::Timestamp;

/// Time of frame `number` of a sensor without losses.
pub fn frame_time(number: usize) -> Timestamp {
    timestamp_from_ticks(number as i64 * FRAME_TICKS)
}
