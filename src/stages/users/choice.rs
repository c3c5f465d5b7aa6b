//! Which user a single-person output shows: VMC, VRChat, FaceOSC, serial, and the live line.
//!
//! The user shown stays until gone, or until another has been clearly better by the policy's measure for a while, so that two
//! people in similar positions do not alternate. Metres, seconds. Memory: a few numbers.

use crate::base::geometry::Point;
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;
use crate::base::time::Timestamp;

/// Which person is preferred.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Policy {
    /// Who came first; never changed while they are there.
    #[default]
    First,
    /// The person nearest to the sensor.
    Nearest,
    /// The person nearest to the middle of the picture.
    Central,
}

/// Another user must be better by this much, metres,
const MARGIN_M: f32 = 0.12;
/// for so long, seconds.
const PATIENCE_S: f64 = 0.7;

/// A user who may be shown.
#[derive(Clone, Copy, Debug)]
pub struct Candidate {
    /// Their slot.
    pub slot: usize,
    /// When they came.
    pub since: Timestamp,
    /// Where their head is, sensor frame.
    pub place: Point,
}

/// The choice and its past.
#[derive(Clone, Debug, Default)]
pub struct Choice {
    policy: Policy,
    shown: Option<usize>,
    /// The user who has been better, and since when.
    rival: Option<(usize, Timestamp)>,
}

impl Choice {
    /// Nobody is shown yet.
    pub fn new(policy: Policy) -> Self {
        Self {
            policy,
            ..Self::default()
        }
    }

    /// The slot of the user shown; also a lost one, until another is there.
    pub fn shown(&self) -> Option<usize> {
        self.shown
    }

    /// Continues from another choice.
    pub fn adopt(&mut self, other: &Self) {
        self.shown = other.shown;
    }

    /// Updates the choice with everyone present now.
    pub fn update(&mut self, there: &[Candidate], at: Timestamp) {
        let merit = |one: &Candidate| match self.policy {
            Policy::First => one.since.as_us() as f64 * 1e-6,
            Policy::Nearest => f64::from(one.place.coords.norm()),
            Policy::Central => f64::from(one.place.x.hypot(one.place.y)),
        };
        let Some(best) = there.iter().min_by(|a, b| merit(a).total_cmp(&merit(b))) else {
            self.rival = None;
            return;
        };
        let shown = there.iter().find(|one| Some(one.slot) == self.shown);
        if shown.is_none() {
            self.shown = Some(best.slot);
        }
        let margin = f64::from(MARGIN_M);
        let better = shown.is_some_and(|shown| merit(best) < merit(shown) - margin);
        let same = self.rival.filter(|rival| rival.0 == best.slot);
        let rival = same.unwrap_or((best.slot, at));
        self.rival = Some(rival).filter(|_| better && self.policy != Policy::First);
        if let Some((slot, since)) = self.rival
            && at.seconds_since(since) >= PATIENCE_S
        {
            (self.shown, self.rival) = (Some(slot), None);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(ms: u64) -> Timestamp {
        Timestamp::from_us(ms * 1000)
    }

    fn one(slot: usize, since_ms: u64, x: f32, z: f32) -> Candidate {
        Candidate {
            slot,
            since: at(since_ms),
            place: Point::new(x, 0.0, z),
        }
    }

    #[test]
    fn each_policy_shows_whom_it_says() {
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
            choice.update(&there, at(40));
            assert_eq!(choice.shown(), Some(slot), "{policy:?}");
        }
    }

    #[test]
    fn a_better_one_must_stay_better_and_a_lost_one_is_kept_until_another_is_there() {
        let mut choice = Choice::new(Policy::Nearest);
        choice.update(&[one(0, 0, 0.0, 0.9)], at(0));
        let mut shown = Vec::new();
        for ms in (100..1500).step_by(100) {
            // The other leans forward for a moment at 300 ms, and for good from 600 ms.
            let z = if ms == 300 || ms >= 600 { 0.7 } else { 1.0 };
            choice.update(&[one(0, 0, 0.0, 0.9), one(1, 50, 0.2, z)], at(ms));
            shown.push((ms, choice.shown()));
        }
        let first = shown.iter().find(|(_, shown)| *shown == Some(1));
        assert_eq!(first.map(|(ms, _)| *ms), Some(1300));
        choice.update(&[], at(2000));
        assert_eq!(choice.shown(), Some(1));
        choice.update(&[one(3, 2000, 0.0, 1.0)], at(2033));
        assert_eq!(choice.shown(), Some(3));
    }
}
