//! Values of keys: from TOML, each checked, and to TOML.

use toml::de::{DeInteger, DeValue};

use super::toml_words::{describe, float, toml_string};
use mien_stages::base::settings::Kind;

/// The allowed values in words, and the current value as TOML.
pub(super) fn as_toml(kind: &Kind<'_>) -> (String, String) {
    match kind {
        Kind::Number(number, [min, max], unit) => {
            let span = format!("{min} to {max} {unit}");
            (span.trim_end().into(), format!("{number:?}"))
        }
        Kind::Bool(value) => ("true or false".into(), value.to_string()),
        Kind::Text(value, form, _) => ((*form).into(), toml_string(value)),
        Kind::Texts(value, form, ..) => ((*form).into(), toml_strings(value)),
        Kind::Choice(present, names, _) => {
            let all: Vec<String> = names.iter().map(|name| format!("{name:?}")).collect();
            (all.join(" or "), toml_string(names[*present]))
        }
    }
}

/// A single string as a TOML string, otherwise an array.
fn toml_strings(texts: &[String]) -> String {
    match texts {
        [text] => toml_string(text),
        _ => {
            let all: Vec<String> = texts.iter().map(|text| toml_string(text)).collect();
            format!("[{}]", all.join(", "))
        }
    }
}

/// The strings of a TOML string or array of strings.
fn texts<'a>(value: &'a DeValue<'_>) -> Option<Vec<&'a str>> {
    match (value.as_str(), value.as_array()) {
        (Some(text), _) => Some(vec![text]),
        (_, Some(all)) => all.iter().map(|text| text.get_ref().as_str()).collect(),
        _ => None,
    }
}

/// Stores a value if it is valid.
///
/// # Errors
/// Expected and found value.
pub(super) fn assign(
    slot: Kind<'_>,
    path: &str,
    value: &DeValue<'_>,
) -> Result<(), (String, String)> {
    let (allowed, _) = as_toml(&slot);
    let expected = match slot {
        Kind::Number(ref slot, ..) if slot.is_whole() => {
            format!("{path} as a whole number from {allowed}")
        }
        Kind::Number(..) => format!("{path} from {allowed}"),
        _ => format!("{path} to be {allowed}"),
    };
    let stored = match slot {
        Kind::Number(slot, [min, max], _) => float(value)
            .filter(|_| value.as_integer().is_some() || !slot.is_whole())
            .filter(|number| (f64::from(min)..=f64::from(max)).contains(number))
            .map(|number| slot.set(number)),
        Kind::Bool(slot) => value.as_bool().map(|value| *slot = value),
        Kind::Text(slot, _, valid) => value
            .as_str()
            .filter(|text| valid(text))
            .map(|text| text.clone_into(slot)),
        Kind::Texts(slot, _, valid, [least, most]) => texts(value)
            .filter(|texts| {
                (least..=most).contains(&texts.len()) && texts.iter().all(|text| valid(text))
            })
            .map(|texts| *slot = texts.into_iter().map(str::to_owned).collect()),
        // A name that is a number may stand without quotes.
        Kind::Choice(_, names, set) => value
            .as_str()
            .or_else(|| value.as_integer().map(DeInteger::as_str))
            .and_then(|text| names.iter().position(|name| *name == text))
            .map(set),
    };
    stored.ok_or_else(|| (expected, describe(value)))
}
