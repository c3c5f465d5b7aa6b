//! What a gesture is: its keys in the configuration, and the gestures with built-in settings.

use super::teaching::{HIGH, HIGH_OF_GAZE, Lesson, Levels};
use crate::view::{is_name, is_unit};
use mien_stages::base::prelude::*;
use mien_stages::base::settings::keyed;

/// Least and greatest upper level.
pub const LEVELS: [f32; 2] = [0.01, 8.0];

/// Whose expression counts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Person {
    /// The person that single-person outputs show.
    #[default]
    Shown,
    /// Anybody: the gesture is on while at least one person makes it.
    Any,
    /// Each person separately.
    Each,
}

/// How a key is pressed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Press {
    /// Down and up again at once, because a key held down repeats.
    #[default]
    Tap,
    /// Down while the gesture is on.
    Hold,
}

keyed! {
    /// One gesture.
    pub struct Gesture {
        /// Name of the gesture.
        name: String = String::new() => Text("at most 24 letters, digits and signs such as _ or -", is_topic_part),
        /// Expression that switches it.
        of: String = String::new() => Text(
            "a sum of units, such as \"AU12L + AU12R - AU26\", or sums joined by &, of which the smallest counts",
            is_sum
        ),
        /// Level of that expression at which it goes on.
        on: f32 = 0.7 => number(LEVELS[0], LEVELS[1], ""),
        /// Lowest level that the set-up by five repetitions may find, unless on is lower: speech and glances reach almost as far.
        on_min: f32 = 0.35 => number(0.0, LEVELS[1], ""),
        /// Level below which it goes off.
        off: f32 = 0.4 => number(0.0, 8.0, ""),
        /// How long the level must be kept before it goes on.
        hold_s: f32 = 0.2 => seconds(),
        /// Time within which 45 % of the expression's rise must come; 0 = any.
        rise_s: f32 = 0.0 => seconds(),
        /// Shortest time from going off to going on again.
        pause_s: f32 = 0.3 => seconds(),
        /// Whose expression counts: that of the person in single-person outputs, anybody's, or each person's separately.
        person: Person = Person::default() =>
            choice(&[("shown", Person::Shown), ("any", Person::Any), ("each", Person::Each)]),
        /// Whether it goes on while the person speaks or laughs.
        speaking: bool = false => Bool(),
        /// Largest sideways angle between the face and the line from it to the sensor.
        turned_deg: f32 = 30.0 => number(1.0, 90.0, "degrees"),
        /// Key that it presses; empty = none.
        key: String = String::new() =>
            Text("a key such as \"space\", \"a\", \"page_down\", \"mouse_left\", or empty", is_key),
        /// Whether the key is tapped once, or held down while the gesture is on.
        press: Press = Press::default() => choice(&[("tap", Press::Tap), ("hold", Press::Hold)]),
    }
}

/// Longest sum, bytes; enough for every unit once.
const SUM_MAX: usize = 512;

/// Whether a text is a sum of units, or several joined by `&`.
fn is_sum(text: &str) -> bool {
    text.len() <= SUM_MAX && Gesture::sums(text).flatten().all(|(_, unit)| is_unit(unit))
}

/// Whether the key exists; a build without key output accepts any name.
fn is_key(name: &str) -> bool {
    #[cfg(feature = "wires")]
    let is_known = crate::key_codes::is_key;
    #[cfg(not(feature = "wires"))]
    let is_known = is_name;
    name.is_empty() || is_known(name)
}

/// Whether the text is valid as a gesture's name, which is part of topics, addresses and column names.
fn is_topic_part(name: &str) -> bool {
    is_name(name) && !name.contains(['!', '+', '"', '\\'])
}

/// Gestures with built-in settings: name, sums, on, on_min, off, rise and hold time in seconds, largest sideways angle in degrees.
/// Reasons for the values: the gaze stays on its target when the head turns; a mouth seen from the side looks pursed; many real smiles
/// raise the upper lip (AU10) and hardly move the corners, but a wrinkled nose (AU9) raises it too, and pursed lips (AU18) move the
/// corners; in speech the jaw moves; yawns, laughter and drowsy lids rise slowly; the lids follow eyes that look down. The values of
/// `on_min` are just above what speech, glances and the other gestures reached for the hold time.
#[rustfmt::skip]
pub const PRESETS: [(&str, &str, [f32; 6]); 10] = [
    ("smile", "AU12L + AU12R + AU10L + AU10R - AU9L - AU9R - AU18 - AU26", [0.13, 0.1, 0.08, 0.25, 0.5, 40.0]),
    ("brows", "AU1L + AU1R + AU2L + AU2R", [1.3, 0.9, 0.9, 0.0, 0.15, 40.0]),
    ("mouth_open", "AU26", [0.32, 0.28, 0.2, 0.25, 0.7, 40.0]),
    ("wink_left", "AU43L - AU43R", [0.7, 0.32, 0.35, 0.0, 0.2, 30.0]),
    ("wink_right", "AU43R - AU43L", [0.7, 0.32, 0.35, 0.0, 0.2, 30.0]),
    ("blink_long", "AU43L & AU43R", [0.4, 0.3, 0.25, 0.15, 0.5, 40.0]),
    ("look_left", "AU61", [0.7, 0.6, 0.45, 0.0, 0.9, 12.0]),
    ("look_right", "AU62", [0.7, 0.6, 0.45, 0.0, 0.9, 12.0]),
    ("look_up", "AU63", [0.6, 0.36, 0.36, 0.0, 0.4, 12.0]),
    ("kiss", "AU18", [0.6, 0.3, 0.4, 0.0, 0.2, 30.0]),
];

impl Gesture {
    /// The preset of this name; for any other name a gesture without a sum.
    pub fn named(name: &str) -> Self {
        let mut gesture = Self {
            name: name.into(),
            ..Self::default()
        };
        let preset = PRESETS.iter().find(|preset| preset.0 == name);
        if let Some(&(_, sum, [on, on_min, off, rise_s, hold_s, turned_deg])) = preset {
            gesture.of = sum.into();
            (gesture.on, gesture.off, gesture.turned_deg) = (on, off, turned_deg);
            (gesture.rise_s, gesture.hold_s, gesture.on_min) = (rise_s, hold_s, on_min);
        }
        gesture
    }

    /// Its levels.
    pub fn levels(&self) -> Levels {
        Levels {
            on: self.on,
            off: self.off,
            hold_s: self.hold_s,
            rise_s: self.rise_s,
        }
    }

    pub(super) fn lesson(&self, configured: Levels) -> Lesson {
        let mut units = Self::sums(&self.of).flatten().map(|(_, unit)| unit);
        let high = units.find_map(|unit| match unit {
            "AU61" | "AU62" => Some(HIGH_OF_GAZE[0]),
            "AU63" | "AU64" => Some(HIGH_OF_GAZE[1]),
            _ => None,
        });
        let high = high.unwrap_or(HIGH);
        Lesson::new(configured, self.on_min, high)
    }

    /// Sign and unit of each term, for each sum; unit names are not checked.
    pub fn sums(text: &str) -> impl Iterator<Item = impl Iterator<Item = (f32, &str)>> {
        text.split('&').map(Self::terms)
    }

    /// Index among `units` and sign of each term, for each sum; units that are not measured are omitted.
    pub fn indexed(&self, units: &[&str]) -> Vec<Vec<(usize, f32)>> {
        let index = |(sign, unit)| Some((units.iter().position(|name| *name == unit)?, sign));
        let sums = Self::sums(&self.of).map(|terms| terms.filter_map(index).collect());
        sums.collect()
    }

    fn terms(sum: &str) -> impl Iterator<Item = (f32, &str)> {
        let signs = sum.matches(['+', '-']);
        let signs = signs.map(|sign| if sign == "-" { -1.0 } else { 1.0 });
        let signs = core::iter::once(1.0).chain(signs);
        signs.zip(sum.split(['+', '-']).map(str::trim))
    }
}
