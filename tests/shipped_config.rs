//! The shipped configuration is what the programme does without one.

use std::path::Path;

use mien::settings::Settings;

#[test]
fn the_shipped_file_equals_the_defaults_key_by_key() {
    let shipped = include_str!("../config/mien.toml");
    assert_eq!(
        shipped,
        Settings::default().to_toml(),
        "remake it: mien print-config > config/mien.toml"
    );
    assert_eq!(
        Settings::parse(shipped, Path::new("config/mien.toml")),
        Ok(Settings::default())
    );
}
