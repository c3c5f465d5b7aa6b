//! Conversion between TOML values and text.

use toml::de::DeValue;

use mien_stages::base::json::Quoted;

/// A TOML basic string, with control characters escaped.
pub(super) fn toml_string(text: &str) -> String {
    Quoted(text).to_string()
}

/// A TOML value as text, for messages.
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

fn integer(number: &toml::de::DeInteger<'_>) -> Option<i64> {
    i64::from_str_radix(&number.as_str().replace('_', ""), number.radix()).ok()
}

/// A TOML number, integer or float.
pub(super) fn float(value: &DeValue<'_>) -> Option<f64> {
    match value {
        DeValue::Float(number) => number.as_str().replace('_', "").parse().ok(),
        DeValue::Integer(number) => integer(number).map(|number| number as f64),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_string_reads_back() {
        let all: String = (0..0x3000).filter_map(char::from_u32).collect();
        let table: toml::Table = format!("text = {}", toml_string(&all)).parse().unwrap();
        assert_eq!(table["text"].as_str(), Some(all.as_str()));
    }
}
