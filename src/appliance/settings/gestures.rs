//! The tables `[[gesture]]`: names, presets and checks across keys.

use toml::de::DeTable;

use super::sections::Settings;
use mien_outputs::gesture::{Gesture, PRESETS};
use mien_stages::base::capacity::GESTURES;

/// An error: expected and found value.
type Refusal = (String, String);

/// Adds a gesture with the name in `table`, preset if it has one of the known names.
pub(super) fn add_named(table: &DeTable<'_>, settings: &mut Settings) -> Result<(), Refusal> {
    let all = &mut settings.outputs.gestures;
    if all.len() == GESTURES {
        return Err((format!("at most {GESTURES} gestures"), "more".to_owned()));
    }
    let name = table.get("name").and_then(|name| name.get_ref().as_str());
    let name = name.filter(|name| all.iter().all(|other| other.name != **name));
    let expected = || "a gesture with a name that no other gesture has".to_owned();
    let name = name.ok_or_else(|| (expected(), "none".to_owned()))?;
    all.push(Gesture::named(name));
    Ok(())
}

/// Checks the last gesture as a whole.
pub(super) fn check_last(settings: &Settings) -> Result<(), Refusal> {
    let gesture = settings.outputs.gestures.last();
    let gesture = gesture.expect("it was added before");
    let (name, on, off) = (&gesture.name, gesture.on, gesture.off);
    if gesture.of.is_empty() {
        let presets = PRESETS.map(|preset| preset.0).join(", ");
        let expected = format!("gesture.of, or one of the names {presets}");
        return Err((expected, name.clone()));
    }
    if off >= on {
        let expected = format!("off of the gesture {name} to be below its on, {on}");
        return Err((expected, off.to_string()));
    }
    Ok(())
}
