//! What a page shows of a gesture: its levels, its set-up and how often it went on.

use super::teaching::{Levels, SetUpState};
use crate::osc::packet::Argument;
#[cfg(feature = "studio")]
use mien_stages::base::capacity::GESTURES;

/// Levels of a gesture, how it is being set up, and how often it went on.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SetUpFacts {
    /// Index among the gestures.
    pub index: usize,
    /// State of the set-up.
    pub state: SetUpState,
    /// Repetitions seen.
    pub seen: usize,
    /// The present levels.
    pub levels: Levels,
    /// Whether there is a change that can be undone.
    pub can_undo: bool,
    /// Activations in the last 24 hours.
    pub count: u32,
    /// Time for which anybody was tracked in the last 24 hours, seconds.
    pub tracked_s: u32,
}

/// Fields of a JSON object.
impl core::fmt::Display for SetUpFacts {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let Levels {
            on,
            off,
            hold_s,
            rise_s,
        } = self.levels;
        write!(
            f,
            "\"index\":{},\"state\":\"{}\",",
            self.index,
            self.state.name()
        )?;
        write!(f, "\"seen\":{},\"on\":{on:.3},\"off\":{off:.3},", self.seen)?;
        write!(f, "\"hold_s\":{hold_s:.2},\"rise_s\":{rise_s:.2},")?;
        write!(
            f,
            "\"can_undo\":{},\"count\":{},",
            self.can_undo, self.count
        )?;
        write!(f, "\"tracked_s\":{}", self.tracked_s)
    }
}

impl SetUpFacts {
    /// The arguments of the OSC message.
    pub fn to_osc(&self) -> [Argument<'static>; 10] {
        use Argument::{Float, Int};
        let [index, state, seen] =
            [self.index, self.state as usize, self.seen].map(|n| Int(n as i32));
        let [count, tracked_s] = [self.count, self.tracked_s].map(|n| Int(n as i32));
        let levels = &self.levels;
        let [on, off] = [levels.on, levels.off].map(Float);
        let [hold_s, rise_s] = [levels.hold_s, levels.rise_s].map(Float);
        let can_undo = Int(self.can_undo.into());
        [
            index, state, seen, on, off, hold_s, rise_s, can_undo, count, tracked_s,
        ]
    }

    /// From the arguments of an OSC message; `None` if they are not those of [`Self::to_osc`].
    #[cfg(feature = "studio")]
    pub fn from_osc(arguments: &[Argument<'_>]) -> Option<Self> {
        use Argument::{Float, Int};
        let &[
            Int(index),
            Int(state),
            Int(seen),
            Float(on),
            Float(off),
            Float(hold_s),
            Float(rise_s),
            Int(can_undo),
            Int(count),
            Int(tracked_s),
        ] = arguments
        else {
            return None;
        };
        let is_finite = [on, off, hold_s, rise_s].into_iter().all(f32::is_finite);
        let [state, seen, index] = [state, seen, index].map(usize::try_from);
        Some(Self {
            index: index.ok().filter(|&index| index < GESTURES && is_finite)?,
            state: *SetUpState::ALL.get(state.ok()?)?,
            seen: seen.ok()?,
            levels: Levels {
                on,
                off,
                hold_s,
                rise_s,
            },
            can_undo: can_undo != 0,
            count: count.try_into().ok()?,
            tracked_s: tracked_s.try_into().ok()?,
        })
    }
}

/// Message to outputs: the facts of a gesture changed, or are repeated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SetUp<'a> {
    /// Name of the gesture.
    pub name: &'a str,
    /// Its facts.
    pub facts: SetUpFacts,
}
