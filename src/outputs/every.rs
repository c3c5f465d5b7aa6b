//! A schedule by capture time.

use mien_stages::base::time::Timestamp;

/// Schedules a repeated message by capture time.
#[derive(Default)]
pub(super) struct Every {
    last: Option<Timestamp>,
}

impl Every {
    /// Whether `period_s` seconds have passed since it was last due, or time has gone backwards because the source changed.
    pub(super) fn due(&mut self, now: Timestamp, period_s: f64) -> bool {
        let is_over = |last| now < last || now.seconds_since(last) >= period_s;
        let due = self.last.is_none_or(is_over);
        if due {
            self.last = Some(now);
        }
        due
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_repeated_is_due_at_once_and_then_in_its_period() {
        let mut every = Every::default();
        let mut is_due = |us: u64| every.due(Timestamp::from_us(us), 1.0);
        let due: Vec<u64> = (0..100).filter(|i| is_due(i * 33_333)).collect();
        assert_eq!(due, [0, 31, 62, 93]);
        assert!(is_due(5), "another source starts from 0");
    }
}
