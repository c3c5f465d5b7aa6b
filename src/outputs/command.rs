//! Commands that a receiver sends: for the learning of a user, or for a gesture.

use mien_stages::base::capacity::{GESTURES, USERS};

/// A command from a receiver.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Command {
    /// Discard everything learned about the user in this slot.
    Forget(usize),
    /// Stop (`true`) or resume (`false`) learning for the user in this slot.
    Freeze(usize, bool),
    /// Use the current face of the user in this slot as the neutral face.
    Neutral(usize),
    /// Set the upper level of the gesture with this index, in hundredths.
    Level(usize, u16),
    /// Set the hold time of the gesture with this index, in hundredths of a second.
    Hold(usize, u16),
    /// Find level and hold time of the gesture with this index from five repetitions (`true`), or stop that (`false`).
    Teach(usize, bool),
    /// Return to the level and hold time that the gesture with this index had before.
    Undo(usize),
}

impl core::fmt::Display for Command {
    /// The command as the end of a sentence "receiver asked to …".
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let decimal = |hundredths| f32::from(hundredths) / 100.0;
        match *self {
            Self::Forget(slot) => write!(f, "forget person {}", slot + 1),
            Self::Freeze(slot, true) => write!(f, "freeze learning for person {}", slot + 1),
            Self::Freeze(slot, false) => write!(f, "resume learning for person {}", slot + 1),
            Self::Neutral(slot) => write!(f, "set the neutral face of person {}", slot + 1),
            Self::Level(gesture, level) => {
                write!(
                    f,
                    "set the level of gesture {gesture} to {:.2}",
                    decimal(level)
                )
            }
            Self::Hold(gesture, time) => {
                write!(
                    f,
                    "set the hold time of gesture {gesture} to {:.2} s",
                    decimal(time)
                )
            }
            Self::Teach(gesture, true) => write!(f, "set up gesture {gesture}"),
            Self::Teach(gesture, false) => write!(f, "stop setting up gesture {gesture}"),
            Self::Undo(gesture) => write!(f, "undo the last change of gesture {gesture}"),
        }
    }
}

impl Command {
    /// The command called `what` for a user's slot or the index of a gesture, with the number that some take. `None` if there is no
    /// such command, slot or index.
    pub fn named(what: &str, index: usize, number: Option<u16>) -> Option<Self> {
        let command = match (what, number) {
            ("forget", None) => Self::Forget(index),
            ("neutral", None) => Self::Neutral(index),
            ("freeze", Some(on @ 0..=1)) => Self::Freeze(index, on == 1),
            ("level", Some(hundredths)) => Self::Level(index, hundredths),
            ("hold", Some(hundredths)) => Self::Hold(index, hundredths),
            ("teach", Some(on @ 0..=1)) => Self::Teach(index, on == 1),
            ("undo", None) => Self::Undo(index),
            _ => return None,
        };
        let count = if command.is_of_gesture() {
            GESTURES
        } else {
            USERS
        };
        (index < count).then_some(command)
    }

    /// Name, index and number, from which [`Self::named`] returns this command.
    pub fn parts(self) -> (&'static str, usize, Option<u16>) {
        match self {
            Self::Forget(slot) => ("forget", slot, None),
            Self::Neutral(slot) => ("neutral", slot, None),
            Self::Freeze(slot, on) => ("freeze", slot, Some(on.into())),
            Self::Level(gesture, level) => ("level", gesture, Some(level)),
            Self::Hold(gesture, time) => ("hold", gesture, Some(time)),
            Self::Teach(gesture, on) => ("teach", gesture, Some(on.into())),
            Self::Undo(gesture) => ("undo", gesture, None),
        }
    }

    /// Whether it changes a gesture.
    pub fn is_of_gesture(self) -> bool {
        use Command::{Hold, Level, Teach, Undo};
        matches!(self, Level(..) | Hold(..) | Teach(..) | Undo(_))
    }

    /// As [`Self::named`], with index and number as text.
    #[cfg(any(feature = "studio", feature = "wires"))]
    pub fn from_words<'a>(what: &str, mut words: impl Iterator<Item = &'a str>) -> Option<Self> {
        let index = words.next()?.parse().ok()?;
        let number = words.next().map(|word| word.parse().ok());
        let is_all = words.next().is_none();
        Self::named(what, index, number.map_or(Some(None), |n| n.map(Some))?).filter(|_| is_all)
    }
}
