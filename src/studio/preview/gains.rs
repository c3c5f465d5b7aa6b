//! Saves gains tried on the page into their configuration file, leaving all else in it unchanged.

use std::path::Path;

use toml_edit::{DocumentMut, InlineTable, Item, Table, Value};

use mien_appliance::settings::Settings;
use mien_workbench::{atomic_write, text_files};

/// Multiplies the gains in a configuration by those of a query, `AU26=1.5&AU12L=0.8`, and writes it; returns a
/// message.
///
/// # Errors
/// If the file or the result is no valid configuration; nothing is written then.
pub(super) fn save(path: &Path, query: &str) -> Result<String, String> {
    let pairs = query.split('&').filter_map(|pair| pair.split_once('='));
    let factors = pairs.map(|(unit, factor)| Some((unit, factor.parse::<f64>().ok()?)));
    let factors: Option<Vec<(&str, f64)>> = factors.collect();
    let factors = factors.filter(|some| !some.is_empty());
    let factors = factors.ok_or("expected units with their gains, found none")?;
    let name = path.display();
    let text = text_files::read(path).map_err(|error| format!("cannot read {name}: {error}"))?;
    let text = multiplied(&text, &factors)?;
    Settings::parse(&text, path).map_err(|error| format!("{error}; nothing was changed"))?;
    atomic_write::write(path, text).map_err(|error| format!("cannot write {name}: {error}"))?;
    let next = "reload mien for it to take effect";
    Ok(format!("saved in {name}; {next}"))
}

/// The text of a configuration with its gains multiplied.
fn multiplied(text: &str, factors: &[(&str, f64)]) -> Result<String, String> {
    let mut file: DocumentMut = text.parse().map_err(|error| format!("{error}"))?;
    let units = file.entry("units").or_insert(Item::Table(Table::new()));
    let expected = "expected a section [units] in the configuration, found something else";
    let units = units.as_table_like_mut().ok_or(expected)?;
    for &(unit, factor) in factors {
        let rounded = |gain: f64| (gain * 1000.0).round() / 1000.0;
        match units.get_mut(unit).map(Item::as_table_like_mut) {
            None => {
                let mut one = InlineTable::new();
                one.insert("gain", Value::from(rounded(factor)));
                units.insert(unit, Item::Value(Value::InlineTable(one)));
            }
            Some(None) => {
                return Err(format!("expected units.{unit} to be a table with a gain"));
            }
            Some(Some(one)) => {
                let number = |item: &Item| {
                    let whole = item.as_integer().map(|whole| whole as f64);
                    item.as_float().or(whole)
                };
                let before = one.get("gain").map_or(Some(1.0), number);
                let before = before.ok_or(format!("expected units.{unit}.gain to be a number"))?;
                one.insert("gain", Item::Value(Value::from(rounded(before * factor))));
            }
        }
    }
    Ok(file.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    const FILE: &str = "# The box in room 3.\n[osc]\nenabled = true   # always\n\n[units]\n# The jaw of our rig opens wide.\nAU26 = { name = \"jaw\", gain = 2 }\nAU12L.gain = 1.5\n\n[log]\nlevel = \"warn\"\n";

    fn saved(query: &str) -> (Result<String, String>, String) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("mien.toml");
        std::fs::write(&path, FILE).unwrap();
        let said = save(&path, query);
        (said, std::fs::read_to_string(&path).unwrap())
    }

    #[test]
    fn gains_are_multiplied_and_all_else_stays() {
        let (said, text) = saved("AU26=0.75&AU12L=2&AU9R=1.2");
        assert!(said.unwrap().contains("reload mien"));
        let expected = FILE.replace("gain = 2 ", "gain = 1.5 ").replace(
            "AU12L.gain = 1.5",
            "AU12L.gain = 3.0\nAU9R = { gain = 1.2 }",
        );
        assert_eq!(text, expected);
        let settings = Settings::parse(&text, Path::new("x")).unwrap();
        let gain = |unit: &str| {
            let mut views = settings.outputs.units.iter();
            views.find(|view| view.unit == unit).unwrap().gain
        };
        assert_eq!([gain("AU26"), gain("AU12L"), gain("AU9R")], [1.5, 3.0, 1.2]);
    }

    #[test]
    fn a_file_without_the_section_gets_it() {
        let text = multiplied("[osc]\nenabled = true\n", &[("AU26", 1.5)]).unwrap();
        assert_eq!(
            text,
            "[osc]\nenabled = true\n\n[units]\nAU26 = { gain = 1.5 }\n"
        );
    }

    #[test]
    fn an_invalid_configuration_is_not_written() {
        for (query, part) in [
            ("AU26=1000", "from 0 to 10"),
            ("AU999=2", "nothing was changed"),
            ("AU26=much", "found none"),
            ("", "found none"),
        ] {
            let (said, text) = saved(query);
            let said = said.unwrap_err();
            assert!(said.contains(part), "{query}: {said}");
            assert_eq!(text, FILE, "{query}");
        }
        assert!(
            save(Path::new("/nowhere/mien.toml"), "AU26=2")
                .unwrap_err()
                .starts_with("cannot read")
        );
    }
}
