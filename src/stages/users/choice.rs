//! Selects the user of single-person outputs: VMC, VRChat, FaceOSC, serial, and the live line.
//!
//! The selected user stays until gone, or until another has been better by a margin for some time, so that two people in similar
//! positions do not alternate. Metres, seconds. Memory: a few numbers.

use crate::base::geometry::Point;
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;
use crate::base::time::Timestamp;

/// Selection criterion.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Policy {
    /// The person present longest; never switches while they are present.
    #[default]
    First,
    /// The person nearest to the sensor.
    Nearest,
    /// The person nearest to the optical axis.
    Central,
}

/// Least advantage of another user for a switch, metres.
const MARGIN_M: f32 = 0.12;
/// Time for which the advantage must last, seconds.
const SWITCH_AFTER_S: f64 = 0.7;

/// A user who may be selected.
#[derive(Clone, Copy, Debug)]
pub struct Candidate {
    /// Slot.
    pub slot: usize,
    /// Time of arrival.
    pub since: Timestamp,
    /// Position of the head, sensor frame, metres.
    pub place: Point,
}

/// The selection and its state.
#[derive(Clone, Debug, Default)]
pub struct Choice {
    policy: Policy,
    shown: Option<usize>,
    /// The user with an advantage, and since when.
    rival: Option<(usize, Timestamp)>,
}

impl Choice {
    /// Nobody is selected yet.
    pub fn new(policy: Policy) -> Self {
        Self {
            policy,
            ..Self::default()
        }
    }

    /// Slot of the selected user; a lost user stays selected until another is present.
    pub fn shown(&self) -> Option<usize> {
        self.shown
    }

    /// Takes over another selection's user.
    pub fn adopt(&mut self, other: &Self) {
        self.shown = other.shown;
    }

    /// Updates the selection from everyone present.
    pub fn update(&mut self, present: &[Candidate], at: Timestamp) {
        let merit = |one: &Candidate| match self.policy {
            Policy::First => one.since.as_us() as f64 * 1e-6,
            Policy::Nearest => f64::from(one.place.coords.norm()),
            Policy::Central => f64::from(one.place.x.hypot(one.place.y)),
        };
        let Some(best) = present.iter().min_by(|a, b| merit(a).total_cmp(&merit(b))) else {
            self.rival = None;
            return;
        };
        let shown = present.iter().find(|one| Some(one.slot) == self.shown);
        if shown.is_none() {
            self.shown = Some(best.slot);
        }
        let margin = f64::from(MARGIN_M);
        let better = shown.is_some_and(|shown| merit(best) < merit(shown) - margin);
        let same = self.rival.filter(|rival| rival.0 == best.slot);
        let rival = same.unwrap_or((best.slot, at));
        self.rival = Some(rival).filter(|_| better && self.policy != Policy::First);
        if let Some((slot, since)) = self.rival
            && at.seconds_since(since) >= SWITCH_AFTER_S
        {
            (self.shown, self.rival) = (Some(slot), None);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn time_ms(ms: u64) -> Timestamp {
        Timestamp::from_us(ms * 1000)
    }

    fn one(slot: usize, since_ms: u64, x: f32, z: f32) -> Candidate {
        Candidate {
            slot,
            since: time_ms(since_ms),
            place: Point::new(x, 0.0, z),
        }
    }

    #[test]
    fn each_policy_selects_its_user() {
        let there = [
            one(0, 20, 0.3, 0.9),
            one(1, 10, -0.2, 1.2),
            one(2, 30, 0.0, 1.5),
        ];
        for (policy, slot) in [
            (Policy::First, 1),
            (Policy::Nearest, 0),
            (Policy::Central, 2),
        ] {
            let mut choice = Choice::new(policy);
            choice.update(&there, time_ms(40));
            assert_eq!(choice.shown(), Some(slot), "{policy:?}");
        }
    }

    #[test]
    fn switches_after_a_lasting_advantage_and_keeps_a_lost_user() {
        let mut choice = Choice::new(Policy::Nearest);
        choice.update(&[one(0, 0, 0.0, 0.9)], time_ms(0));
        let mut shown = Vec::new();
        for ms in (100..1500).step_by(100) {
            // The other leans forward for a moment at 300 ms, and for good from 600 ms.
            let z = if ms == 300 || ms >= 600 { 0.7 } else { 1.0 };
            choice.update(&[one(0, 0, 0.0, 0.9), one(1, 50, 0.2, z)], time_ms(ms));
            shown.push((ms, choice.shown()));
        }
        let first = shown.iter().find(|(_, shown)| *shown == Some(1));
        assert_eq!(first.map(|(ms, _)| *ms), Some(1300));
        choice.update(&[], time_ms(2000));
        assert_eq!(choice.shown(), Some(1));
        choice.update(&[one(3, 2000, 0.0, 1.0)], time_ms(2033));
        assert_eq!(choice.shown(), Some(3));
    }
}
