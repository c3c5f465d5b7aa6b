//! The shipped configuration is what the program does without one.

use std::path::Path;

use mien::appliance::settings::Settings;

#[test]
fn the_shipped_file_equals_the_defaults_key_by_key() {
    let shipped = include_str!("../../config/mien.toml");
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

/// The values a key has in the unit's file, in their order.
fn unit(key: &str) -> Vec<&'static str> {
    let text = include_str!("../../systemd/mien.service");
    let value = |line: &'static str| line.strip_prefix(key)?.strip_prefix('=');
    text.lines().filter_map(value).collect()
}

#[test]
fn the_unit_backs_off_keeps_its_files_to_itself_and_reaches_local_targets() {
    // Learned ranges are nobody else's; the status files say themselves that they are for all.
    assert_eq!(unit("UMask"), ["0077"]);
    // Nothing that can be written can be run.
    assert_eq!(unit("NoExecPaths"), ["/"]);
    assert!(unit("ExecPaths")[0].starts_with("/usr"));
    // It comes back soon; Debian 12's systemd warns of the keys of growing delays, so the program itself waits.
    assert_eq!(unit("RestartSec"), ["2"]);
    assert!(unit("RestartSteps").is_empty() && unit("RestartMaxDelaySec").is_empty());
    for network in ["localhost", "link-local", "192.168.0.0/16", "fc00::/7"] {
        assert!(unit("IPAddressAllow").contains(&network), "{network}");
    }
}
