//! People who left, to be known when they come back: what their head and face are known by and the ranges learned, for a
//! while, in memory.
//!
//! At most [`capacity::REMEMBERED`](crate::capacity::REMEMBERED) people; when full, the one gone longest is dropped. Neither
//! pictures nor clouds are kept; [`super::saved`] takes them over a restart.

use crate::capacity::{REMEMBERED, USERS};
use crate::expression::saved::Learned;
use crate::time::Timestamp;
use crate::users::likeness::Likeness;

/// One who left.
#[derive(Clone, Debug)]
pub struct Gone {
    /// The slot they had.
    pub slot: usize,
    /// Their head and face.
    pub likeness: Likeness,
    /// Their ranges.
    pub learned: Learned,
    /// When they were seen last, or the start of this run.
    pub last_seen: Timestamp,
    /// How long they had been gone before this run, seconds; 0 for who was seen in it.
    pub before_s: f64,
}

impl Gone {
    /// How long they have been gone, seconds.
    #[must_use]
    pub fn away_s(&self, now: Timestamp) -> f64 {
        now.seconds_since(self.last_seen).max(0.0) + self.before_s
    }
}

/// Those who left, longest gone first.
#[derive(Clone, Debug, Default)]
pub struct Memory {
    gone: heapless::Vec<Gone, REMEMBERED>,
}

impl Memory {
    /// Remembers one who left; of a slot only the last.
    pub fn keep(&mut self, gone: Gone) {
        self.forget_slot(gone.slot);
        if self.gone.is_full() {
            self.gone.remove(0);
        }
        // Not full: just seen to.
        let _ = self.gone.push(gone);
    }

    /// Forgets who has been gone for more than `most_s` seconds.
    pub fn forget_older(&mut self, now: Timestamp, most_s: f64) {
        self.gone
            .retain(|gone| now >= gone.last_seen && gone.away_s(now) <= most_s);
    }

    /// Forgets who had a slot last.
    pub fn forget_slot(&mut self, slot: usize) {
        self.gone.retain(|gone| gone.slot != slot);
    }

    /// All, longest gone first.
    #[must_use]
    pub fn gone(&self) -> &[Gone] {
        &self.gone
    }

    /// Takes out the one that was recognised.
    pub fn take(&mut self, slot: usize) -> Option<Gone> {
        let at = self.gone.iter().position(|gone| gone.slot == slot)?;
        Some(self.gone.remove(at))
    }

    /// The slot for somebody new among the free ones: one that nobody remembered had, else that of the one gone longest.
    #[must_use]
    pub fn slot_for_newcomer(&self, free: &[bool; USERS]) -> Option<usize> {
        let owner = |slot: usize| self.gone.iter().position(|gone| gone.slot == slot);
        (0..USERS)
            .filter(|&slot| free[slot])
            .min_by_key(|&slot| owner(slot).map_or(0, |age| age + 1))
    }
}
