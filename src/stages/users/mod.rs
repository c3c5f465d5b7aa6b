//! Identity of users: their states, matching heads to users from frame to frame ([`matching`]), recognising returning people
//! ([`memory`], by the features of [`likeness`]), and the user of single-person outputs ([`choice`]).
//!
//! A user has a slot, 0 to 3, and keeps it until forgotten. The state depends on whether the face is seen in this frame:
//!
//! ```text
//! absent ─seen─► warming ─ready─► tracking ─unseen─► held ─hold_s─► lost ─forget_s─► absent (forgotten)
//!                   ▲______________________seen again______________|
//! ```
//!
//! | seen in this frame | state |
//! | --- | --- |
//! | the face | warming or tracking |
//! | the head alone, its face up to 75 ms ago | unchanged: the points move with the head |
//! | the head alone, its face up to `hold_s` ago | held |
//! | the head alone | posed |
//! | nothing for up to `hold_s` | held |
//! | nothing for longer | lost, and after `forget_s` more absent |
//!
//! Depth detects heads ([`crate::pose`]), with a lower threshold for a tracked one; likewise the colour image detects faces
//! ([`crate::landmarks`]). A head becomes a user once its face is seen. Without colour, or while a known person's face is hidden,
//! depth alone decides, with a higher threshold.

pub mod choice;
pub mod likeness;
pub mod matching;
pub mod memory;
#[cfg(feature = "std")]
pub mod saved;

pub use choice::Policy;

use crate::base::capacity::USERS;
use crate::base::settings::keyed;
use crate::base::time::Timestamp;

/// State of a user.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TrackingState {
    /// Nobody.
    #[default]
    Absent,
    /// Tracked; most ranges are still the population's.
    Warming,
    /// Tracked.
    Tracking,
    /// Briefly lost; the last values are kept.
    Held,
    /// Lost, not yet forgotten.
    Lost,
    /// The head is tracked by depth alone: pose, but no face.
    Posed,
}

impl TrackingState {
    /// All states, in the order of their codes.
    pub const ALL: [Self; 6] = [
        Self::Absent,
        Self::Warming,
        Self::Tracking,
        Self::Held,
        Self::Lost,
        Self::Posed,
    ];

    /// Name in the CSV.
    pub const fn name(self) -> &'static str {
        ["absent", "warming", "tracking", "held", "lost", "posed"][self as usize]
    }

    /// Code in the other outputs.
    pub const fn code(self) -> u8 {
        self as u8
    }

    /// Whether this user's head pose is known.
    pub const fn is_present(self) -> bool {
        self.has_face() || matches!(self, Self::Posed)
    }

    /// Whether this user has landmarks, measures and weights.
    pub const fn has_face(self) -> bool {
        matches!(self, Self::Warming | Self::Tracking | Self::Held)
    }
}

/// Time for which an unseen face on a tracked head still counts as seen, seconds: bridges a missing image or hair before the face
/// for two frames.
const BLINK_S: f64 = 0.075;

/// Tracks the state of one person.
#[derive(Clone, Debug, Default)]
pub struct Presence {
    hold_s: f64,
    forget_s: f64,
    /// Time the head was last tracked, with its face or by depth alone.
    last_seen: Option<Timestamp>,
    /// Time the face was last seen.
    face_seen: Option<Timestamp>,
    /// Whether the ranges were learned then.
    ready: bool,
}

impl Presence {
    /// State of an unseen person. `hold_s`: time for which the last values are kept; `forget_s`: time for which the slot is then kept.
    pub fn new(hold_s: f32, forget_s: f32) -> Self {
        Self {
            hold_s: hold_s.into(),
            forget_s: forget_s.into(),
            ..Self::default()
        }
    }

    /// Takes over another person's state, but keeps `hold_s` and `forget_s`.
    pub fn adopt(&mut self, other: &Self) {
        (self.last_seen, self.face_seen) = (other.last_seen, other.face_seen);
        self.ready = other.ready;
    }

    /// Forgets that anybody was seen.
    pub fn reset(&mut self) {
        (self.last_seen, self.face_seen) = (None, None);
    }

    /// The face was seen in a frame; `ready`: whether its ranges are learned.
    pub fn seen(&mut self, at: Timestamp, ready: bool) -> TrackingState {
        (self.last_seen, self.face_seen) = (Some(at), Some(at));
        self.ready = ready;
        self.with_face()
    }

    fn with_face(&self) -> TrackingState {
        if self.ready {
            TrackingState::Tracking
        } else {
            TrackingState::Warming
        }
    }

    /// The head was tracked in a frame without a face; the face's last values are kept for some time.
    pub fn posed(&mut self, at: Timestamp) -> TrackingState {
        self.last_seen = Some(at);
        let face = self.face_seen.map(|seen| at.seconds_since(seen));
        if face.is_some_and(|gone| gone <= BLINK_S) {
            // For so short a time the face's points move with the head.
            self.with_face()
        } else if face.is_some_and(|gone| gone <= self.hold_s) {
            TrackingState::Held
        } else {
            TrackingState::Posed
        }
    }

    /// Neither head nor face was seen in a frame. On [`TrackingState::Absent`] the person must be forgotten.
    pub fn unseen(&mut self, at: Timestamp) -> TrackingState {
        let Some(last) = self.last_seen else {
            return TrackingState::Absent;
        };
        let gone = at.seconds_since(last);
        if gone <= self.hold_s {
            TrackingState::Held
        } else if gone <= self.hold_s + self.forget_s {
            TrackingState::Lost
        } else {
            self.reset();
            TrackingState::Absent
        }
    }
}

keyed! {
    /// Which people are tracked, and what happens when a face is lost.
    pub struct Settings {
        /// Maximum number of people tracked at once; with 1, everybody who appears gets slot 0.
        most: u32 = USERS as u32 => number(1.0, USERS as f32, ""),
        /// Which person a single-person output sends (vmc, vrchat, faceosc, serial): the first to arrive, the nearest, or the most central.
        single: Policy = Policy::default() =>
            choice(&[("first", Policy::First), ("nearest", Policy::Nearest), ("central", Policy::Central)]),
        /// How long values are held after the face was last seen.
        hold_s: f32 = 0.5 => number(0.0, 10.0, "s"),
        /// How long a lost person then keeps their slot.
        forget_s: f32 = 2.0 => number(0.0, 3600.0, "s"),
        /// How long the ranges and head shape of a person who left are kept; a returning person who is recognised gets ranges and slot back; 0 keeps none.
        remember_s: f32 = 600.0 => number(0.0, 86_400.0, "s"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_short_loss_is_held_then_lost_then_forgotten() {
        let mut presence = Presence::new(0.5, 2.0);
        let at = |ms: u64| Timestamp::from_us(ms * 1000);
        assert_eq!(presence.unseen(at(0)), TrackingState::Absent);
        assert_eq!(presence.seen(at(100), false), TrackingState::Warming);
        assert_eq!(presence.seen(at(200), true), TrackingState::Tracking);
        assert_eq!(presence.unseen(at(600)), TrackingState::Held);
        assert_eq!(presence.unseen(at(800)), TrackingState::Lost);
        assert_eq!(presence.seen(at(900), true), TrackingState::Tracking);
        assert_eq!(presence.unseen(at(3500)), TrackingState::Absent);
        assert_eq!(presence.unseen(at(3600)), TrackingState::Absent);
    }

    #[test]
    fn a_head_without_colour_is_held_then_posed_and_lost_like_any_other() {
        let mut presence = Presence::new(0.5, 2.0);
        let at = |ms: u64| Timestamp::from_us(ms * 1000);
        assert_eq!(presence.posed(at(0)), TrackingState::Posed);
        assert_eq!(presence.seen(at(100), true), TrackingState::Tracking);
        assert_eq!(presence.posed(at(133)), TrackingState::Tracking);
        assert_eq!(presence.posed(at(200)), TrackingState::Held);
        assert_eq!(presence.seen(at(233), true), TrackingState::Tracking);
        assert_eq!(presence.posed(at(600)), TrackingState::Held);
        assert_eq!(presence.posed(at(750)), TrackingState::Posed);
        assert_eq!(presence.unseen(at(783)), TrackingState::Held);
        assert_eq!(presence.unseen(at(1300)), TrackingState::Lost);
        assert_eq!(presence.posed(at(1400)), TrackingState::Posed);
        assert_eq!(presence.unseen(at(4000)), TrackingState::Absent);
    }

    #[test]
    fn codes_and_names_are_fixed() {
        let told = TrackingState::ALL.map(|state| (state.code(), state.name()));
        let names = ["absent", "warming", "tracking", "held", "lost", "posed"];
        assert_eq!(told, core::array::from_fn(|code| (code as u8, names[code])));
    }

    #[test]
    fn adopting_keeps_its_own_times() {
        let at = |ms: u64| Timestamp::from_us(ms * 1000);
        let mut presence = Presence::new(0.5, 2.0);
        presence.seen(at(1000), true);
        assert_eq!(presence.unseen(at(1500)), TrackingState::Held);
        assert_eq!(presence.unseen(at(1501)), TrackingState::Lost);
        assert_eq!(presence.unseen(at(3500)), TrackingState::Lost);
        assert_eq!(presence.unseen(at(3501)), TrackingState::Absent);
        // Not ready when the face was seen last: so it is on a head that is followed on.
        presence.seen(at(4000), false);
        assert_eq!(presence.posed(at(4070)), TrackingState::Warming);
        assert_eq!(presence.posed(at(4080)), TrackingState::Held);
        assert_eq!(presence.posed(at(4500)), TrackingState::Held);
        assert_eq!(presence.posed(at(4501)), TrackingState::Posed);
        // Another pipeline's presence adopts the observations but keeps its own times.
        let mut other = Presence::new(0.1, 2.0);
        other.adopt(&presence);
        assert_eq!(other.unseen(at(4600)), TrackingState::Held);
        assert_eq!(other.unseen(at(4602)), TrackingState::Lost);
    }
}
