//! The camera's wrapping 60 MHz counter to a running time.

use core::time::Duration;

use super::packet::TICKS_PER_SECOND;
use mien_stages::base::time::Timestamp;

/// Ticks of the 60 MHz counter from picture to picture, at 30 pictures a second.
pub const FRAME_TICKS: i64 = 2_000_000;

/// Capture time of unwrapped 60 MHz ticks since the first depth picture, rounded down to whole microseconds. Every source
/// goes through here, so that a run and its replay agree to the bit.
pub fn timestamp_from_ticks(ticks: i64) -> Timestamp {
    Timestamp::from_us(ticks.max(0).unsigned_abs() / 60)
}

/// Tells the depth pictures' time since the first one. It goes on across the counter's wrap and a restart of the camera.
#[derive(Clone, Debug, Default)]
pub struct PictureClock {
    last: Option<u32>,
    /// Since the first picture.
    ticks: u64,
}

impl PictureClock {
    /// Time of the picture stamped `ticks`. Pictures come less than 71 s apart, or [`Self::restart`] comes between them.
    pub fn stamp(&mut self, ticks: u32) -> Timestamp {
        if let Some(last) = self.last {
            self.ticks += u64::from(ticks.wrapping_sub(last));
        }
        self.last = Some(ticks);
        timestamp_from_ticks(self.ticks.cast_signed())
    }

    /// The camera's counter can no longer be trusted: the next picture comes `pause` after the last one.
    pub fn restart(&mut self, pause: Duration) {
        if self.last.take().is_some() {
            let ticks = pause.as_nanos() * u128::from(TICKS_PER_SECOND) / 1_000_000_000;
            self.ticks += u64::try_from(ticks).unwrap_or(u64::MAX >> 8);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kinect::packet::TICKS_PER_PICTURE;

    #[test]
    fn time_goes_on_across_the_wrap_and_across_losses_and_restarts() {
        let mut clock = PictureClock::default();
        let start = u32::MAX - 3 * TICKS_PER_PICTURE;
        for number in [0u32, 1, 2, 3, 4, 5, 9, 10] {
            let jitter = number % 2 * 1000;
            let at = clock.stamp(start.wrapping_add(number * TICKS_PER_PICTURE + jitter));
            let expected = (number * TICKS_PER_PICTURE + jitter) / 60;
            assert_eq!(at.as_us(), u64::from(expected));
        }
        clock.restart(Duration::from_secs(100));
        assert_eq!(clock.stamp(17).as_us(), 100_333_333);
    }
}
