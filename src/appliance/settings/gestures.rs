//! The tables `[[gesture]]`.

use std::fmt::Write as _;
use std::ops::Range;

use toml::Spanned;
use toml::de::DeValue;

use super::toml_words::{describe, float, toml_string};
use super::units::is_unit;
use crate::base::capacity::GESTURES;
use crate::base::nearest_word::hint;
use crate::output::gesture::{ENABLED, Gesture, PRESETS, Person, Press};
use crate::output::is_name;

/// What the tables are called.
pub(super) const SECTION: &str = "gesture";

/// Keys besides the name, which comes first.
const KEYS: [&str; 10] = [
    "of",
    "on",
    "off",
    "hold_s",
    "pause_s",
    "person",
    "speaking",
    "turned_deg",
    "key",
    "press",
];

/// An error: where, what was expected, what was found.
type Refusal = (Option<Range<usize>>, String, String);

/// Reads all tables.
pub(super) fn read(value: &Spanned<DeValue<'_>>) -> Result<Vec<Gesture>, Refusal> {
    if !ENABLED {
        let expected = "a build with --features gestures, or the package".to_owned();
        return Err((None, expected, "[[gesture]]".to_owned()));
    }
    let tables = value.get_ref().as_array();
    let tables = tables.filter(|all| all.iter().all(|one| one.get_ref().is_table()));
    let Some(tables) = tables else {
        let expected = "tables [[gesture]]".to_owned();
        return Err((Some(value.span()), expected, describe(value.get_ref())));
    };
    if tables.len() > GESTURES {
        let expected = format!("at most {GESTURES} gestures");
        return Err((None, expected, tables.len().to_string()));
    }
    let mut all: Vec<Gesture> = Vec::new();
    for table in tables {
        let gesture = gesture(table)?;
        if all.iter().any(|other| other.name == gesture.name) {
            let expected = "a name that no other gesture has".to_owned();
            return Err((Some(table.span()), expected, gesture.name));
        }
        all.push(gesture);
    }
    Ok(all)
}

fn gesture(table: &Spanned<DeValue<'_>>) -> Result<Gesture, Refusal> {
    let keys = table.get_ref().as_table().expect("checked by the caller");
    let refuse = |value: &Spanned<DeValue<'_>>, key: &str, expected: &str| {
        let expected = format!("gesture.{key} {expected}");
        (Some(value.span()), expected, describe(value.get_ref()))
    };
    let Some(name) = keys.get("name") else {
        let expected = "a gesture with a name".to_owned();
        return Err((Some(table.span()), expected, "none".to_owned()));
    };
    let mut gesture = match name.get_ref().as_str().filter(|name| is_name(name)) {
        Some(name) => Gesture::named(name),
        None => return Err(refuse(name, "name", NAME)),
    };
    for (key, value) in keys {
        let name: &str = key.get_ref();
        let text = value.get_ref().as_str();
        let number = |from: f32, to: f32| {
            let number = float(value.get_ref()).map(|number| number as f32);
            let expected = format!("from {from} to {to}");
            match number.filter(|number| (from..=to).contains(number)) {
                Some(number) => Ok(number),
                None => Err(refuse(value, name, &expected)),
            }
        };
        match name {
            "name" => {}
            "of" => match text.filter(|of| is_sum(of)) {
                Some(of) => of.clone_into(&mut gesture.of),
                None => return Err(refuse(value, name, SUM)),
            },
            "on" => gesture.on = number(0.01, 8.0)?,
            "off" => gesture.off = number(0.0, 8.0)?,
            "hold_s" => gesture.hold_s = number(0.0, 60.0)?,
            "pause_s" => gesture.pause_s = number(0.0, 3600.0)?,
            "turned_deg" => gesture.turned_deg = number(1.0, 90.0)?,
            "speaking" => match value.get_ref().as_bool() {
                Some(speaking) => gesture.speaking = speaking,
                None => return Err(refuse(value, name, "to be true or false")),
            },
            "person" => match Person::NAMES.iter().find(|known| Some(known.0) == text) {
                Some(&(_, person)) => gesture.person = person,
                None => return Err(refuse(value, name, "to be \"shown\", \"any\" or \"each\"")),
            },
            "key" => match text.filter(|key| key.is_empty() || is_key(key)) {
                Some(key) => key.clone_into(&mut gesture.key),
                None => return Err(refuse(value, name, KEY)),
            },
            "press" => match Press::NAMES.iter().find(|known| Some(known.0) == text) {
                Some(&(_, press)) => gesture.press = press,
                None => return Err(refuse(value, name, "to be \"tap\" or \"hold\"")),
            },
            unknown => {
                let expected = format!("one of the keys name, {} in [[gesture]]", KEYS.join(", "));
                let found = format!("{unknown}{}", hint(unknown, KEYS));
                return Err((Some(key.span()), expected, found));
            }
        }
    }
    if gesture.of.is_empty() {
        let presets: Vec<&str> = PRESETS.iter().map(|preset| preset.0).collect();
        let expected = format!("gesture.of, or one of the names {}", presets.join(", "));
        return Err((Some(name.span()), expected, gesture.name));
    }
    if gesture.off >= gesture.on {
        let at = keys.get("off").or_else(|| keys.get("on")).unwrap_or(name);
        let expected = format!("gesture.off below gesture.on, which is {}", gesture.on);
        return Err((Some(at.span()), expected, gesture.off.to_string()));
    }
    Ok(gesture)
}

const NAME: &str = "of at most 24 letters, digits and signs such as _ or -";
const SUM: &str = "to be units added and subtracted, like \"AU12L + AU12R\"";
const KEY: &str =
    "to be a key such as \"space\", \"enter\", \"a\", \"page_down\", \"mouse_left\", or empty";

fn is_sum(of: &str) -> bool {
    Gesture::terms(of).is_some_and(|terms| terms.iter().all(|(unit, _)| is_unit(unit)))
}

/// Whether there is such a key; a build that presses none believes any.
fn is_key(name: &str) -> bool {
    #[cfg(feature = "gestures")]
    let is_key = crate::output::keys::is_key(name);
    #[cfg(not(feature = "gestures"))]
    let is_key = is_name(name);
    is_key
}

/// The tables, after what they mean.
pub(super) fn print(all: &[Gesture], text: &mut String) {
    text.push_str(ABOUT);
    for gesture in all {
        let Gesture {
            on,
            off,
            hold_s,
            pause_s,
            speaking,
            turned_deg,
            ..
        } = gesture;
        let [name, of, key] =
            [&gesture.name, &gesture.of, &gesture.key].map(|text| toml_string(text));
        let person = Person::NAMES.iter().find(|known| known.1 == gesture.person);
        let person = person.map_or("", |known| known.0);
        let press = Press::NAMES.iter().find(|known| known.1 == gesture.press);
        let press = press.map_or("", |known| known.0);
        let _ = write!(
            text,
            "\n[[gesture]]\nname = {name}\nof = {of}\non = {on:?}\noff = {off:?}\nhold_s = {hold_s:?}\n\
             pause_s = {pause_s:?}\nperson = \"{person}\"\nspeaking = {speaking}\nturned_deg = {turned_deg:?}\nkey = {key}\n\
             press = \"{press}\"\n"
        );
    }
}

const ABOUT: &str = "
# Expressions that switch something, see docs/gestures.md. At most 16, each with a name; smile, brows, mouth_open, wink_left,
# wink_right, blink_long, look_left, look_right, look_up and kiss need no more.
#   of          units added and subtracted
#   on, off     the sum at which it goes on, and below which it goes off
#   hold_s      how long the sum must stay there (0 to 60 s)
#   pause_s     least time from an off to the next on (0 to 3600 s)
#   person      \"shown\", \"any\" or \"each\"
#   speaking    whether it may go on while the person speaks (true or false)
#   turned_deg  largest angle between face and line of sight (1 to 90 degrees)
#   key         key or mouse button to press, or empty
#   press       \"tap\" or \"hold\" while it is on
# [[gesture]]
# name = \"smile\"
# key = \"space\"
";
