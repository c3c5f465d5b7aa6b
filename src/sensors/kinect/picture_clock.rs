//! Converts the camera's wrapping 60 MHz counter to capture time.

use core::time::Duration;

use super::packet::{TICKS_PER_PICTURE, TICKS_PER_SECOND};
use mien_stages::base::time::Timestamp;

/// Ticks of the 60 MHz counter between pictures at 30 Hz.
pub const FRAME_TICKS: i64 = TICKS_PER_PICTURE as i64;

/// Capture time of unwrapped 60 MHz ticks since the first depth picture, rounded down to whole microseconds. Every source uses this
/// function, so that a run and its replay have identical times.
pub fn timestamp_from_ticks(ticks: i64) -> Timestamp {
    Timestamp::from_us(ticks.max(0).unsigned_abs() / 60)
}

/// Capture time of depth pictures since the first one, continued across wraps of the counter and restarts of the camera.
#[derive(Clone, Debug, Default)]
pub struct PictureClock {
    last: Option<u32>,
    /// Unwrapped ticks since the first picture.
    ticks: u64,
}

impl PictureClock {
    /// Capture time of the picture stamped `ticks`. Requires less than 71 s since the last picture, or a call of [`Self::restart`].
    pub fn stamp(&mut self, ticks: u32) -> Timestamp {
        if let Some(last) = self.last {
            self.ticks += u64::from(ticks.wrapping_sub(last));
        }
        self.last = Some(ticks);
        timestamp_from_ticks(self.ticks.cast_signed())
    }

    /// The camera's counter has restarted: the next picture is dated `pause` after the last one.
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
