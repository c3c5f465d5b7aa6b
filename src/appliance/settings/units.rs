//! The section `[units]`: keys are units, values their output name and gain.

use std::fmt::Write as _;
use std::ops::Range;

use mien_stages::expression::unit_words;
use toml::Spanned;
use toml::de::DeValue;

use super::toml_words::{describe, toml_string};
use super::values;
use mien_outputs::{UnitView, all_units, is_name};
use mien_stages::base::settings::Kind;

/// Largest gain; larger ones are the receiver's task.
const LARGEST_GAIN: f32 = 10.0;

/// Valid names of units, for messages.
const NAME: &str =
    "at most 24 letters, digits and signs such as _ or -, and not the name of another unit";

/// An error: span in the file, expected and found value.
type Refusal = (Option<Range<usize>>, String, String);

/// Adds the name and gain of `unit`.
pub(super) fn assign(
    unit: &str,
    value: &Spanned<DeValue<'_>>,
    views: &mut Vec<UnitView>,
) -> Result<(), Refusal> {
    let known = all_units();
    if !known.iter().any(|known| known == unit) {
        let expected = format!("one of the units {}", known.join(", "));
        return Err((None, expected, unit.to_owned()));
    }
    let Some(table) = value.get_ref().as_table() else {
        let expected = "a table like { name = \"jaw\", gain = 1.2 }".to_owned();
        return Err((Some(value.span()), expected, describe(value.get_ref())));
    };
    let mut view = UnitView {
        unit: unit.to_owned(),
        name: unit.to_owned(),
        gain: 1.0,
    };
    for (key, value) in table {
        let name = value.get_ref().as_str();
        let is_taken = name.is_some_and(|name| {
            known.iter().any(|known| known == name && known != unit)
                || views.iter().any(|view| view.name == name)
        });
        let kind = match &**key.get_ref() {
            "gain" => Kind::number(&mut view.gain, 0.0, LARGEST_GAIN, ""),
            "name" if is_taken => Kind::Text(&mut view.name, NAME, |_| false),
            "name" => Kind::Text(&mut view.name, NAME, is_name),
            other => return Err((Some(key.span()), "name or gain".into(), other.to_owned())),
        };
        let path = format!("units.{unit}.{}", key.get_ref());
        values::assign(kind, &path, value.get_ref())
            .map_err(|(expected, found)| (Some(value.span()), expected, found))?;
    }
    views.push(view);
    Ok(())
}

/// Appends the lines of the section to `text`.
pub(super) fn print(views: &[UnitView], text: &mut String) {
    let known = all_units();
    text.push_str("# Codes and movements; L and R are the subject's own left and right.\n");
    for words in &unit_words::ALL {
        let is_it = |unit: &&str| unit_words::find(unit).is_some_and(|(found, _)| found == words);
        let codes: Vec<&str> = known.iter().map(String::as_str).filter(is_it).collect();
        if !codes.is_empty() {
            let _ = writeln!(text, "#   {:<16} {}", codes.join(", "), words.does);
        }
    }
    for UnitView { unit, name, gain } in views {
        let name = toml_string(name);
        let _ = writeln!(text, "{unit} = {{ name = {name}, gain = {gain:?} }}");
    }
}
