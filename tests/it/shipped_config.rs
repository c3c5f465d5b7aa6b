//! The shipped configuration is what the program does without one.

use std::path::Path;

use mien_appliance::settings::Settings;

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

/// Rust files below a folder.
fn sources(folder: &Path, all: &mut Vec<std::path::PathBuf>) {
    for entry in std::fs::read_dir(folder).expect("a folder").flatten() {
        match entry.path() {
            path if path.is_dir() => sources(&path, all),
            path if path.extension().is_some_and(|ending| ending == "rs") => all.push(path),
            _ => {}
        }
    }
}

#[test]
fn what_security_md_counts_is_so() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let told = include_str!("../../SECURITY.md");
    let mut all = Vec::new();
    sources(&root.join("src"), &mut all);
    all.sort();
    let allows = |path: &std::path::PathBuf| {
        std::fs::read_to_string(path).is_ok_and(|text| text.contains("unsafe_code,"))
    };
    all.retain(allows);
    let names = all
        .iter()
        .map(|path| path.strip_prefix(root).expect("below it"));
    let names: Vec<String> = names.map(|path| format!("`{}`", path.display())).collect();
    let words = [
        "no", "one", "two", "three", "four", "five", "six", "seven", "eight",
    ];
    let unsafe_files = format!(
        "confined to {} files ({})",
        words[all.len()],
        names.join(", ")
    );
    assert!(told.contains(&unsafe_files), "expected: {unsafe_files}");
    let commands = include_str!("../../src/outputs/osc/commands.rs");
    let commands = commands.matches("//! | `/face/cmd/").count();
    assert!(
        told.contains(&format!("| {} commands, none", words[commands])),
        "{commands} commands"
    );
    // What goes out without being asked for.
    let defaults = Settings::default();
    assert_eq!(defaults.outputs.osc.targets, ["127.0.0.1:9130"]);
    assert!(defaults.outputs.osc.listen.starts_with("127.0.0.1:"));
    assert!(
        !defaults.outputs.osc.levels && !defaults.outputs.osc.ranges && !defaults.status_ranges
    );
    let others = [
        defaults.outputs.vmc.enabled,
        defaults.outputs.vrchat.enabled,
        defaults.outputs.faceosc.enabled,
        defaults.outputs.live_link.enabled,
        defaults.outputs.websocket.enabled,
        defaults.outputs.page.enabled,
        defaults.outputs.mqtt.enabled,
        !defaults.outputs.serial.port.is_empty(),
    ];
    assert_eq!(others, [false; 8]);
    // The package changes nothing of that.
    assert!(!include_str!("../../systemd/deb/build").contains("255.255.255.255"));
}
