//! The configuration file: TOML to the settings of each stage, every key checked.
//!
//! One table ([`keys`]) lists every key with its comment, unit, range and field in [`Settings`]. Reading, checking, printing
//! and the shipped `config/mien.toml` are derived from it. Errors carry file, line and column.

mod gestures;
mod keys;
mod sections;
mod toml_words;
mod units;
mod values;

pub(crate) use sections::STATUS_PATH;
pub use sections::{SensorSettings, Settings, StateSettings};

use std::fmt::Write as _;
use std::path::Path;

use toml::de::{DeTable, DeValue};

use keys::{GESTURE, Section, UNITS, sections};
use toml_words::describe;

use mien_outputs::gesture::{Gesture, PRESETS};
use mien_stages::base::bounded_read::{self, reason};
use mien_stages::base::nearest_word::hint;
use mien_stages::base::settings::Key;
use values::{as_toml, assign};

/// Largest configuration file, bytes: fifty times the shipped one.
const MAX_FILE_BYTES: usize = 1 << 20;

/// An invalid configuration: file, line, column, expected and found value.
#[derive(Debug, thiserror::Error, PartialEq)]
#[error("{0}")]
pub struct SettingsError(String);

/// A setting that a run would refuse although every key is in its range: section, key (empty for the section as a whole), problem.
pub(super) type Refused = (&'static str, &'static str, String);

impl SettingsError {
    pub(super) fn unreadable(path: &Path, problem: impl std::fmt::Display) -> Self {
        let (path, problem) = (path.display(), reason(problem));
        let advice = "give an existing file or omit --config";
        Self(format!("{path}: cannot be read ({problem}); {advice}"))
    }

    /// A problem at a byte offset of the text of a file; line and column count from 1.
    fn at(path: &Path, text: &str, offset: usize, problem: impl std::fmt::Display) -> Self {
        let (path, before) = (path.display(), &text[..offset.min(text.len())]);
        let line = before.matches('\n').count() + 1;
        let column = before.chars().rev().take_while(|c| *c != '\n').count() + 1;
        Self(format!("{path}:{line}:{column}: {problem}"))
    }
}

/// Reads a configuration file as UTF-8.
fn read_text(path: &Path) -> Result<String, SettingsError> {
    let bytes = bounded_read::read(path, MAX_FILE_BYTES);
    let bytes = bytes.map_err(|error| SettingsError::unreadable(path, error))?;
    String::from_utf8(bytes).map_err(|error| {
        let valid = error.utf8_error().valid_up_to();
        let before = String::from_utf8_lossy(&error.as_bytes()[..valid]);
        let expected = "expected UTF-8 text, found other bytes; save the file as UTF-8";
        SettingsError::at(path, &before, valid, expected)
    })
}

/// Byte offset of the value of a key, else of its section, else of the first gesture, whose settings an output may refuse.
fn offset_of(document: &DeTable<'_>, section: &str, key: &str) -> usize {
    let find = |name: &str| document.iter().find(|(key, _)| key.get_ref() == name);
    let Some((name, value)) = find(section).or_else(|| find(GESTURE)) else {
        return 0;
    };
    let mut keys = value.get_ref().as_table().into_iter().flatten();
    let value = keys.find(|(name, _)| name.get_ref() == key);
    value.map_or(name.span(), |(_, value)| value.span()).start
}

impl Settings {
    /// Reads a file and checks it with `refused`, which returns a setting that a run would refuse.
    ///
    /// # Errors
    /// As [`Settings::parse`], or if the file cannot be read or a setting is refused.
    pub(super) fn read(
        path: &Path,
        refused: fn(&Self) -> Option<Refused>,
    ) -> Result<Self, SettingsError> {
        Self::parse_checked(&read_text(path)?, path, refused)
    }

    /// Parses the text of a file; `path` is for messages only. Keys that are absent keep their defaults.
    ///
    /// ```
    /// use mien_appliance::settings::Settings;
    /// let error = Settings::parse("[users]\nhold_s = 99", "my.toml".as_ref()).unwrap_err();
    /// assert_eq!(error.to_string(), "my.toml:2:10: expected users.hold_s from 0 to 10 s, found 99");
    /// ```
    ///
    /// # Errors
    /// If it is not TOML, has an unknown key, or a value of the wrong type or out of its range.
    pub fn parse(text: &str, path: &Path) -> Result<Self, SettingsError> {
        Self::parse_checked(text, path, |_| None)
    }

    fn parse_checked(
        text: &str,
        path: &Path,
        refused: fn(&Self) -> Option<Refused>,
    ) -> Result<Self, SettingsError> {
        let text = text.strip_prefix('\u{feff}').unwrap_or(text);
        let wrong = |offset: usize, expected: String, found: String| {
            let problem = format_args!("expected {expected}, found {found}");
            SettingsError::at(path, text, offset, problem)
        };
        let document = DeTable::parse(text).map_err(|error| {
            let offset = error.span().map_or(0, |span| span.start);
            let message = error.message().lines().collect::<Vec<_>>().join(", ");
            wrong(offset, "TOML".into(), message)
        })?;
        let mut settings = Self::default();
        for (section, value) in document.get_ref() {
            let name: &str = section.get_ref();
            let start = section.span().start;
            let Some(known) = sections().find(|known| known.name == name) else {
                let names: Vec<&str> = sections().map(|known| known.name).collect();
                let expected = format!("one of the sections {}", names.join(", "));
                let found = format!("{name}{}", hint(name, names));
                return Err(wrong(start, expected, found));
            };
            let tables = match value.get_ref() {
                DeValue::Table(table) if name != GESTURE => Some(vec![table]),
                DeValue::Array(all) if name == GESTURE => {
                    all.iter().map(|table| table.get_ref().as_table()).collect()
                }
                _ => None,
            };
            let Some(tables) = tables else {
                let expected = format!("a section {}", known.header());
                return Err(wrong(start, expected, describe(value.get_ref())));
            };
            for table in tables {
                settings.read_table(&known, table, start, &wrong)?;
            }
        }
        settings.outputs.copy_units();
        match refused(&settings) {
            Some((section, key, problem)) => {
                let offset = offset_of(document.get_ref(), section, key);
                Err(SettingsError::at(path, text, offset, problem))
            }
            None => Ok(settings),
        }
    }

    /// Reads one table of a section that begins at byte `start`.
    fn read_table(
        &mut self,
        known: &Section,
        table: &DeTable<'_>,
        start: usize,
        wrong: &dyn Fn(usize, String, String) -> SettingsError,
    ) -> Result<(), SettingsError> {
        let name = known.name;
        let whole = |(expected, found)| wrong(start, expected, found);
        if name == GESTURE {
            gestures::add_named(table, self).map_err(whole)?;
        }
        for (key, value) in table {
            if name == UNITS {
                let assigned = units::assign(key.get_ref(), value, &mut self.outputs.units);
                assigned.map_err(|(span, expected, found)| {
                    wrong(span.unwrap_or(key.span()).start, expected, found)
                })?;
                continue;
            }
            let mut rows = (known.keys)(self);
            let Some(index) = rows.iter().position(|row| row.name == key.get_ref()) else {
                let names: Vec<&str> = rows.iter().map(|row| row.name).collect();
                let (all, header) = (names.join(", "), known.header());
                let expected = format!("one of the keys {all} in {header}");
                let found = format!("{}{}", key.get_ref(), hint(key.get_ref(), names));
                return Err(wrong(key.span().start, expected, found));
            };
            let row = rows.swap_remove(index);
            let path = format!("{name}.{}", row.name);
            assign(row.kind, &path, value.get_ref())
                .map_err(|(expected, found)| wrong(value.span().start, expected, found))?;
        }
        if name == GESTURE {
            gestures::check_last(self).map_err(whole)?;
        }
        Ok(())
    }

    /// The whole configuration as TOML that [`Settings::parse`] accepts, every key with its comment and range.
    pub fn to_toml(mut self) -> String {
        let mut text = String::from(
            "# Configuration of mien. Every key appears once, with its meaning, range and value.\n\
             # `mien check-config FILE` checks a copy; omitted keys keep the value shown by `mien print-config`.\n",
        );
        // Without gestures, an example is printed as a comment.
        let is_example = self.outputs.gestures.is_empty();
        if is_example {
            self.outputs.gestures.push(Gesture::named(PRESETS[0].0));
        }
        for section in sections() {
            let _ = write!(text, "\n# {}\n", section.about);
            let is_gesture = section.name == GESTURE;
            let mark = if is_gesture && is_example { "# " } else { "" };
            let gestures = self.outputs.gestures.len();
            for _ in 0..if is_gesture { gestures } else { 1 } {
                // The keys refer to the last gesture: rotates each one there.
                if is_gesture {
                    self.outputs.gestures.rotate_left(1);
                }
                let _ = writeln!(text, "{mark}{}", section.header());
                if section.name == UNITS {
                    units::print(&self.outputs.units, &mut text);
                }
                for Key { name, about, kind } in (section.keys)(&mut self) {
                    let (allowed, value) = as_toml(&kind);
                    let _ = write!(text, "# {about} ({allowed})\n{mark}{name} = {value}\n");
                }
            }
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mien_stages::turn::Turn;

    fn parse(text: &str) -> Result<Settings, SettingsError> {
        Settings::parse(text, Path::new("a.toml"))
    }

    fn refused(text: &str) -> String {
        parse(text).expect_err("must be refused").to_string()
    }

    fn reads_back(settings: Settings) {
        assert_eq!(parse(&settings.clone().to_toml()), Ok(settings));
    }

    #[test]
    fn printed_settings_parse_to_the_same() {
        let mut settings = Settings::default();
        settings.stages.users.hold_s = 1.25;
        settings.sensor.source = "simulated:still".into();
        reads_back(settings);
    }

    #[test]
    fn a_choice_of_numbers_needs_no_quotes() {
        let turned =
            |value| parse(&format!("[sensor]\nturned = {value}\n")).map(|it| it.sensor.turned);
        for value in ["90", "\"90\""] {
            assert_eq!(turned(value), Ok(Some(Turn::Quarter)));
        }
        assert_eq!(turned("\"auto\""), Ok(None));
        for value in ["45", "-90", "90.0", "\"left\""] {
            let expected =
                r#"expected sensor.turned to be "auto" or "0" or "90" or "180" or "270""#;
            assert!(turned(value).unwrap_err().to_string().contains(expected));
        }
    }

    #[test]
    fn defaults_are_within_their_own_ranges() {
        reads_back(Settings::default());
    }

    #[test]
    fn an_unknown_key_is_reported_with_position_and_known_keys() {
        let message = refused("[users]\nhold = 1\n");
        assert!(
            message.starts_with("a.toml:2:1: expected one of the keys most, single, hold_s, forget_s, remember_s in [users]"),
            "{message}"
        );
        assert!(
            message.ends_with("found hold (did you mean hold_s?)"),
            "{message}"
        );
    }

    #[test]
    fn an_unknown_section_and_a_bare_value_are_refused() {
        assert!(refused("[user]\n").contains("a.toml:1:2: expected one of the sections sensor,"));
        assert!(refused("users = 3\n").contains("expected a section [users], found 3"));
        for prefix in ["", "a/", "/a", "a b", "a+", "\u{e4}"] {
            let message = refused(&format!("[mqtt]\nprefix = {prefix:?}\n"));
            assert!(
                message.contains("to be at most 64 bytes without spaces"),
                "{message}"
            );
        }
    }

    #[test]
    fn gestures_are_presets_with_overrides() {
        let text = "[[gesture]]\nname = \"smile\"\nkey = \"space\"\nperson = \"any\"\n\
            [[gesture]]\nname = \"frown\"\nof = \"AU4L + AU4R - AU1L\"\non = 1\noff = 0.5\npress = \"hold\"\n";
        let settings = parse(text).unwrap();
        let [smile, frown] = &settings.outputs.gestures[..] else {
            panic!("{:?}", settings.outputs.gestures)
        };
        let preset = Gesture::named("smile");
        assert_eq!((smile.on, &*smile.key), (preset.on, "space"));
        assert_eq!(smile.person, mien_outputs::gesture::Person::Any);
        assert_eq!((frown.on, frown.off), (1.0, 0.5));
        reads_back(settings);
        assert!(refused("[gesture]\nname = \"smile\"\n").contains("a section [[gesture]]"));
        let above = "expected off of the gesture smile to be below its on, 0.13, found 1.5";
        for (words, part) in [
            (
                "of = \"AU26\"",
                "expected a gesture with a name that no other gesture has",
            ),
            (
                "name = \"grin\"",
                "expected gesture.of, or one of the names smile, brows,",
            ),
            ("name = \"smile\"\noff = 1.5", above),
            (
                "name = \"smile\"\nof = \"AU12L +\"",
                "gesture.of to be a sum of units",
            ),
            (
                "name = \"smile\"\nof = \"AU12L AU12R\"",
                "found \"AU12L AU12R\"",
            ),
            (
                "name = \"smile\"\nkey = \"any key\"",
                "gesture.key to be a key such as",
            ),
            (
                "name = \"smile\"\nonn = 1",
                "one of the keys name, of, on, on_min,",
            ),
        ] {
            let message = refused(&format!("[[gesture]]\n{words}\n"));
            assert!(message.contains(part), "{message}");
        }
        let gesture = |name| format!("[[gesture]]\nname = \"{name}\"\nof = \"AU26\"\n");
        assert!(refused(&gesture(1).repeat(2)).contains("a name that no other gesture has"));
        let many: String = (0..17).map(gesture).collect();
        assert!(refused(&many).contains("expected at most 16 gestures"));
    }

    #[test]
    fn units_get_names_and_gains() {
        let text = "[units]\nAU26 = { name = \"jaw\", gain = 1.5 }\nAU23.gain = 2\n";
        // AU23 is not measured.
        assert!(refused(text).contains("a.toml:3:1: expected one of the units AU25, "));
        let text = text.replace("AU23", "AU2L");
        let settings = parse(&text).unwrap();
        let units = settings.outputs.units.iter();
        let units = units.map(|view| (view.unit.as_str(), view.name.as_str(), view.gain));
        assert!(units.eq([("AU26", "jaw", 1.5), ("AU2L", "AU2L", 2.0)]));
        reads_back(settings);
        for (text, part) in [
            (
                "AU26 = 3",
                "expected a table like { name = \"jaw\", gain = 1.2 }, found 3",
            ),
            (
                "AU26 = { gain = -1 }",
                "expected units.AU26.gain from 0 to 10, found -1",
            ),
            ("AU26 = { size = 1 }", "expected name or gain, found size"),
            ("AU26 = { name = \"a b\" }", "found \"a b\""),
            (
                "AU26 = { name = \"AU25\" }",
                "not the name of another unit, found \"AU25\"",
            ),
        ] {
            let message = refused(&format!("[units]\n{text}"));
            assert!(
                message.contains("a.toml:2:") && message.contains(part),
                "{message}"
            );
        }
    }

    #[test]
    fn targets_are_one_or_several() {
        let text = "[osc]\ntarget = [\"a:1\", \"239.0.0.1:2\"]\n[vmc]\ntarget = \"b:3\"\n";
        let settings = parse(text).unwrap();
        assert_eq!(settings.outputs.osc.targets, ["a:1", "239.0.0.1:2"]);
        assert_eq!(settings.outputs.vmc.targets, ["b:3"]);
        reads_back(settings);
        assert!(refused("[osc]\ntarget = []").ends_with("found []"));
        assert!(refused("[osc]\ntarget = [\"a:1\", \"b\"]").ends_with("found [\"a:1\", \"b\"]"));
        assert!(
            refused("[serial]\nunits = [\"AU99\"]").contains("a.toml:2:9: expected serial.units")
        );
    }

    #[test]
    fn type_and_range_are_checked() {
        assert!(refused("[users]\nhold_s = \"long\"").ends_with("found \"long\""));
        assert!(refused("[users]\nhold_s = nan").ends_with("found nan"));
        assert!(
            refused("[log]\nlevel = \"loud\"").contains("expected log.level to be \"error\" or")
        );
        assert!(refused("[users\n").contains("a.toml:1:"));
    }
}
