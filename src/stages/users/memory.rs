//! People who left, remembered in memory for a while so that they can be recognised: the features of their head and face, and
//! their learned ranges.
//!
//! At most [`capacity::REMEMBERED`](crate::base::capacity::REMEMBERED) people; when full, the one gone longest is dropped.
//! Neither pictures nor clouds are kept; [`super::saved`] keeps them across a restart.

use crate::base::capacity::{REMEMBERED, USERS};
use crate::base::prelude::*;
use crate::base::time::Timestamp;
use crate::expression::saved::Learned;
use crate::users::likeness::Likeness;

/// A person who left.
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
    /// How long they had been gone before this run, seconds; 0 for people seen in it.
    pub before_s: f64,
}

impl Gone {
    /// How long they have been gone, seconds.
    pub fn away_s(&self, now: Timestamp) -> f64 {
        now.seconds_since(self.last_seen).max(0.0) + self.before_s
    }
}

/// People who left, longest gone first.
#[derive(Debug)]
pub struct Memory {
    /// On the heap, with room for all from the start: a copy by value would enlarge the stack for good.
    gone: Vec<Gone>,
}

impl Default for Memory {
    fn default() -> Self {
        let gone = Vec::with_capacity(REMEMBERED);
        Self { gone }
    }
}

impl Memory {
    /// Remembers a person who left; only the last one of each slot.
    pub fn keep(&mut self, gone: Gone) {
        self.forget_slot(gone.slot);
        if self.gone.len() == REMEMBERED {
            self.gone.remove(0);
        }
        self.gone.push(gone);
    }

    /// Forgets people gone for more than `most_s` seconds.
    pub fn forget_older(&mut self, now: Timestamp, most_s: f64) {
        self.gone
            .retain(|gone| now >= gone.last_seen && gone.away_s(now) <= most_s);
    }

    /// Everybody has been gone for so much longer, seconds.
    pub fn age(&mut self, seconds: f64) {
        self.gone
            .iter_mut()
            .for_each(|gone| gone.before_s += seconds);
    }

    /// Forgets the last person of a slot.
    pub fn forget_slot(&mut self, slot: usize) {
        self.gone.retain(|gone| gone.slot != slot);
    }

    /// All, longest gone first.
    pub fn gone(&self) -> &[Gone] {
        &self.gone
    }

    /// Takes out the one that was recognised.
    pub fn take(&mut self, slot: usize) -> Option<Gone> {
        let at = self.gone.iter().position(|gone| gone.slot == slot)?;
        Some(self.gone.remove(at))
    }

    /// The free slot for a new person: one that belongs to nobody remembered, else that of the person gone longest.
    pub fn slot_for_newcomer(&self, free: &[bool; USERS]) -> Option<usize> {
        let owner = |slot: usize| self.gone.iter().position(|gone| gone.slot == slot);
        (0..USERS)
            .filter(|&slot| free[slot])
            .min_by_key(|&slot| owner(slot).map_or(0, |age| age + 1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::capacity::LEARNT_MEASURES;
    use crate::expression::range::Range;
    use crate::pose::signature::Signature;
    use crate::users::likeness::FaceLengths;

    fn gone(slot: usize, left_s: u64) -> Gone {
        let mut words = core::iter::once("0").chain(core::iter::repeat("-"));
        Gone {
            slot,
            likeness: Likeness {
                head: Signature::read(&mut words).expect("a head of which nothing was seen"),
                face: FaceLengths::default(),
            },
            learned: Learned {
                eye_distance_m: 0.037,
                ranges: [Range::default(); LEARNT_MEASURES],
                features: heapless::Vec::new(),
                readings: heapless::Vec::new(),
            },
            last_seen: Timestamp::from_us(left_s * 1_000_000),
            before_s: 0.0,
        }
    }

    fn slots(memory: &Memory) -> Vec<usize> {
        memory.gone().iter().map(|gone| gone.slot).collect()
    }

    #[test]
    fn of_a_slot_the_last_is_remembered_and_who_is_gone_too_long_is_forgotten() {
        let now = |s: u64| Timestamp::from_us(s * 1_000_000);
        let mut memory = Memory::default();
        for (slot, left) in [(0, 10), (1, 20), (0, 30)] {
            memory.keep(gone(slot, left));
        }
        assert_eq!(slots(&memory), [1, 0]);
        memory.forget_older(now(80), 60.0);
        assert_eq!(slots(&memory), [1, 0]);
        memory.forget_older(now(81), 60.0);
        assert_eq!(slots(&memory), [0]);
        // A clock that went back tells nothing.
        memory.forget_older(now(29), 60.0);
        assert!(slots(&memory).is_empty());
        memory.keep(gone(3, 30));
        memory.age(31.0);
        memory.forget_older(now(60), 60.0);
        assert!(slots(&memory).is_empty(), "61 s, of which nobody saw 31");
        // Time before this run counts.
        let mut before = gone(2, 0);
        before.before_s = 50.0;
        assert!((before.away_s(now(5)) - 55.0).abs() < 1e-9);
        memory.keep(before);
        memory.forget_older(now(11), 60.0);
        assert!(slots(&memory).is_empty());
    }

    #[test]
    fn who_is_recognised_is_taken_out_and_a_newcomer_has_the_slot_least_missed() {
        let mut memory = Memory::default();
        assert_eq!(memory.slot_for_newcomer(&[false; USERS]), None);
        assert_eq!(
            memory.slot_for_newcomer(&[false, true, true, false]),
            Some(1)
        );
        for (slot, left) in [(1, 10), (0, 20), (3, 30)] {
            memory.keep(gone(slot, left));
        }
        // Nobody remembered had 2; without it, 1 is gone longest.
        assert_eq!(memory.slot_for_newcomer(&[true; USERS]), Some(2));
        assert_eq!(
            memory.slot_for_newcomer(&[true, true, false, true]),
            Some(1)
        );
        assert_eq!(
            memory.slot_for_newcomer(&[true, false, false, true]),
            Some(0)
        );
        let taken = memory.take(0).map(|gone| gone.slot);
        assert_eq!((taken, slots(&memory)), (Some(0), vec![1, 3]));
        assert!(memory.take(0).is_none());
        memory.forget_slot(1);
        assert_eq!(slots(&memory), [3]);
    }

    #[test]
    fn when_full_the_one_gone_longest_makes_room() {
        let mut memory = Memory::default();
        for slot in 0..=REMEMBERED {
            memory.keep(gone(slot, slot as u64));
        }
        assert_eq!(slots(&memory), (1..=REMEMBERED).collect::<Vec<_>>());
    }

    #[test]
    fn who_leaves_in_this_very_moment_is_remembered_and_who_left_after_it_is_not() {
        let mut memory = Memory::default();
        memory.keep(gone(0, 5));
        memory.keep(gone(1, 6));
        memory.forget_older(Timestamp::from_us(5_000_000), 0.0);
        assert_eq!(slots(&memory), [0]);
    }
}
