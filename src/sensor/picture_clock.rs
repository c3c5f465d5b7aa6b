//! The camera's wrapping 60 MHz counter to a running picture number and a time.

use core::time::Duration;

use super::packet::{TICKS_PER_PICTURE, TICKS_PER_SECOND};
use super::timestamp_from_ticks;
use crate::time::Timestamp;

/// Numbers the depth pictures and tells their time since the first. Both go on across a restart of the camera.
#[derive(Clone, Debug, Default)]
pub struct PictureClock {
    last: Option<u32>,
    index: u64,
    /// Since the first picture.
    ticks: u64,
}

impl PictureClock {
    /// Number and time of the picture stamped `ticks`. Pictures that did not come are counted by the time that passed.
    pub fn stamp(&mut self, ticks: u32) -> (u64, Timestamp) {
        if let Some(last) = self.last {
            let passed = ticks.wrapping_sub(last);
            self.advance(u64::from(passed));
        }
        self.last = Some(ticks);
        (self.index, timestamp_from_ticks(self.ticks.cast_signed()))
    }

    /// The camera's counter can no longer be trusted: the next picture comes `pause` after the last one.
    pub fn restart(&mut self, pause: Duration) {
        if self.last.take().is_some() {
            let ticks = pause.as_nanos() * u128::from(TICKS_PER_SECOND) / 1_000_000_000;
            self.advance(u64::try_from(ticks).unwrap_or(u64::MAX >> 8));
        }
    }

    fn advance(&mut self, ticks: u64) {
        let picture = u64::from(TICKS_PER_PICTURE);
        self.index += ((ticks + picture / 2) / picture).max(1);
        self.ticks += ticks;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_across_the_wrap_and_across_losses_and_restarts() {
        let mut clock = PictureClock::default();
        let start = u32::MAX - 3 * TICKS_PER_PICTURE;
        for number in [0u32, 1, 2, 3, 4, 5, 9, 10] {
            let jitter = number % 2 * 1000;
            let ticks = start.wrapping_add(number * TICKS_PER_PICTURE + jitter);
            let (index, at) = clock.stamp(ticks);
            assert_eq!(index, u64::from(number));
            let expected = (number * TICKS_PER_PICTURE + jitter) / 60;
            assert_eq!(at.as_us(), u64::from(expected));
        }
        clock.restart(Duration::from_secs(100));
        let (index, at) = clock.stamp(17);
        assert_eq!((index, at.as_us()), (3010, 100_333_333));
    }
}
