//! A sum over the last day: the present hour of capture time and the 23 before it. Memory: 200 bytes.

use mien_stages::base::time::Timestamp;

/// Number of hours.
const HOURS: usize = 24;
const HOUR_US: u64 = 3_600_000_000;

/// The sum, hour by hour.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct LastDay {
    hours: [u64; HOURS],
    /// Number of the present hour.
    hour: u64,
}

impl LastDay {
    /// Adds an amount at a time, and drops the hours that are a day old then.
    pub(super) fn add(&mut self, amount: u64, at: Timestamp) {
        let hour = at.as_us() / HOUR_US;
        let passed = hour.saturating_sub(self.hour).min(HOURS as u64);
        for ago in 0..passed {
            self.hours[((hour - ago) % HOURS as u64) as usize] = 0;
        }
        self.hour = hour;
        self.hours[(hour % HOURS as u64) as usize] += amount;
    }

    pub(super) fn sum(&self) -> u64 {
        self.hours.iter().sum()
    }
}
