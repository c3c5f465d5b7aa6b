//! Values of TOML as words, and words as values.

use toml::de::DeValue;

/// A TOML basic string; every value here came from TOML or from a literal, so only these two need an escape.
pub(super) fn toml_string(text: &str) -> String {
    format!("\"{}\"", text.replace('\\', "\\\\").replace('"', "\\\""))
}

pub(super) fn describe(value: &DeValue<'_>) -> String {
    match value {
        DeValue::String(text) => format!("{text:?}"),
        DeValue::Integer(number) => number.as_str().to_owned(),
        DeValue::Float(number) => number.as_str().to_owned(),
        DeValue::Boolean(value) => value.to_string(),
        DeValue::Array(all) => {
            let all: Vec<String> = all.iter().map(|value| describe(value.get_ref())).collect();
            format!("[{}]", all.join(", "))
        }
        other => format!("a value of type {}", other.type_str()),
    }
}

pub(super) fn integer(number: &toml::de::DeInteger<'_>) -> Option<i64> {
    i64::from_str_radix(&number.as_str().replace('_', ""), number.radix()).ok()
}
