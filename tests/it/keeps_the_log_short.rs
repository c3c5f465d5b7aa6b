//! What happens over and over cannot fill the log: every line of the programs passes the limiter of `appliance/log.rs`, but for
//! those named here. How it limits is tested beside it; neighbours that try are in `tests/flood`.

use crate::keeps_its_modules_apart::{Module, files, name, without_tests};

/// Modules whose lines are not limited, and why.
const EXEMPT: [(&str, &str); 1] = [(
    "appliance::send_test",
    "a person on a terminal asked for a line a unit; it reads nothing from outside and ends",
)];

/// Files that write to standard error otherwise, and why.
const BESIDE: [(&str, &str); 2] = [
    (
        "appliance::log",
        "the limiter itself, and `say`: the one line with which a program ends",
    ),
    (
        "appliance::signals",
        "asks whether it is a terminal, writes nothing",
    ),
];

/// The firmware's files, without their tests.
fn firmware() -> impl Iterator<Item = (Module, String)> {
    let files = files().into_iter();
    files
        .filter(|(module, _)| {
            let workstation = ["workbench", "linear", "baking", "training", "studio"];
            module
                .first()
                .is_none_or(|name| !workstation.contains(&name.as_str()))
        })
        .map(|(module, text)| (module, without_tests(&text).to_owned()))
}

#[test]
fn the_lines_exempt_from_the_limiter_are_those_with_a_reason() {
    let files: Vec<_> = firmware().collect();
    let of = |wanted: &str| {
        let (_, text) = files
            .iter()
            .find(|(module, _)| name(module) == wanted)
            .unwrap_or_else(|| panic!("no file {wanted}"));
        text
    };
    let (_, list) = of("appliance::log").split_once("UNBOUNDED: ").unwrap();
    let (list, _) = list
        .split_once(';')
        .and_then(|(_, rest)| rest.split_once(';'))
        .unwrap();
    let listed: Vec<&str> = list.split('"').skip(1).step_by(2).collect();
    let exempt = EXEMPT.map(|(module, _)| format!("mien_{module}"));
    assert_eq!(listed, exempt);
    for (module, _) in EXEMPT {
        assert!(of(module).contains("tracing::"), "{module} writes no line");
    }
}

#[test]
fn no_line_goes_around_the_limiter() {
    let mut lines = 0;
    for (module, text) in firmware() {
        let module = name(&module);
        for level in ["error", "warn", "info", "debug", "trace"] {
            for call in text.split(&format!("tracing::{level}!(")).skip(1) {
                lines += 1;
                // A target of its own could be an exempt one's.
                assert!(!call.trim_start().starts_with("target:"), "{module}");
            }
        }
        let beside = ["eprint", "stderr()", "set_global_default", "event!("];
        let beside = beside.into_iter().find(|word| text.contains(word));
        let known = BESIDE.iter().any(|(known, _)| *known == module);
        assert!(beside.is_none() || known, "{module}: {beside:?}");
    }
    assert!(lines > 40, "{lines} lines found");
}
