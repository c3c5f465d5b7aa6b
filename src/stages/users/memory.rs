//! People who left, kept for re-identification: the features of their head and face, and their learned ranges.
//!
//! At most [`capacity::REMEMBERED`](crate::base::capacity::REMEMBERED) people; when full, the one gone longest is dropped.
//! Neither images nor clouds are kept. [`super::saved`] stores the people across restarts.

use crate::base::capacity::{REMEMBERED, USERS};
use crate::base::prelude::*;
use crate::base::time::Timestamp;
use crate::expression::saved::Learned;
use crate::users::likeness::Likeness;

/// A person who left.
#[derive(Clone, Debug)]
pub struct Gone {
    /// Their former slot.
    pub slot: usize,
    /// Features of head and face.
    pub likeness: Likeness,
    /// Learned ranges.
    pub learned: Learned,
    /// Time they were last seen, or the start of this run.
    pub last_seen: Timestamp,
    /// Absence before this run, seconds; 0 for people seen in it.
    pub before_s: f64,
}

impl Gone {
    /// Absence, seconds.
    pub fn away_s(&self, now: Timestamp) -> f64 {
        now.seconds_since(self.last_seen).max(0.0) + self.before_s
    }
}

/// People who left, longest gone first.
#[derive(Debug)]
pub struct Memory {
    /// Heap-allocated with full capacity: a copy by value would enlarge the stack for good.
    gone: Vec<Gone>,
}

impl Default for Memory {
    fn default() -> Self {
        let gone = Vec::with_capacity(REMEMBERED);
        Self { gone }
    }
}

impl Memory {
    /// Remembers a person who left, replacing an earlier one of the slot.
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

    /// Adds to everybody's absence, seconds.
    pub fn age(&mut self, seconds: f64) {
        self.gone
            .iter_mut()
            .for_each(|gone| gone.before_s += seconds);
    }

    /// Forgets the person of a slot.
    pub fn forget_slot(&mut self, slot: usize) {
        self.gone.retain(|gone| gone.slot != slot);
    }

    /// Everybody remembered, longest gone first.
    pub fn gone(&self) -> &[Gone] {
        &self.gone
    }

    /// Removes and returns the person of a slot.
    pub fn take(&mut self, slot: usize) -> Option<Gone> {
        let at = self.gone.iter().position(|gone| gone.slot == slot)?;
        Some(self.gone.remove(at))
    }

    /// The free slot for a new person: one of nobody remembered, else of the person gone longest; `None` if none is free.
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
    fn remembers_the_last_person_of_a_slot_for_a_limited_time() {
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
        // Backward time forgets the person.
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
    fn takes_the_recognised_and_gives_newcomers_the_oldest_slot() {
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
    fn when_full_the_one_gone_longest_is_dropped() {
        let mut memory = Memory::default();
        for slot in 0..=REMEMBERED {
            memory.keep(gone(slot, slot as u64));
        }
        assert_eq!(slots(&memory), (1..=REMEMBERED).collect::<Vec<_>>());
    }

    #[test]
    fn people_last_seen_in_the_future_are_forgotten() {
        let mut memory = Memory::default();
        memory.keep(gone(0, 5));
        memory.keep(gone(1, 6));
        memory.forget_older(Timestamp::from_us(5_000_000), 0.0);
        assert_eq!(slots(&memory), [0]);
    }
}
