//! Bad input gives one sentence and the contract's exit code, never a panic.

use std::path::Path;
use std::process::{Command, Output};

use crate::common::program;
use crate::common::whole_run::has_wires;

fn mien(words: &[&str]) -> Output {
    Command::new(program())
        .args(words)
        .output()
        .expect("mien starts")
}

/// Runs `mien`, expects the exit code, and returns its one line on standard error.
fn sentence(words: &[&str], code: i32) -> String {
    let output = mien(words);
    let text = String::from_utf8(output.stderr).expect("UTF-8");
    assert_eq!(output.status.code(), Some(code), "{words:?}: {text}");
    assert!(!text.contains("panicked"), "{text}");
    assert_eq!(
        text.lines().count(),
        1,
        "{words:?}: one sentence, not: {text}"
    );
    text
}

fn file(folder: &Path, name: &str, content: impl AsRef<[u8]>) -> String {
    let path = folder.join(name);
    std::fs::write(&path, content).expect("temporary file");
    path.to_str().expect("UTF-8").to_owned()
}

#[test]
fn a_configuration_with_an_unknown_key_or_a_value_out_of_range_is_placed_and_explained() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let unknown = file(folder.path(), "unknown.toml", "[users]\nhold = 1\n");
    let text = sentence(&["check-config", &unknown], 2);
    assert!(
        text.contains("unknown.toml:2:1: expected one of the keys most, single, hold_s")
            && text.contains("found hold"),
        "{text}"
    );
    let range = file(folder.path(), "range.toml", "[users]\nhold_s = 60\n");
    let text = sentence(
        &[
            "run",
            "--config",
            &range,
            "--source",
            "simulated",
            "--frames",
            "1",
        ],
        2,
    );
    assert!(
        text.contains("range.toml:2:10: expected users.hold_s from 0 to 10 s, found 60"),
        "{text}"
    );
    let broken = file(folder.path(), "broken.toml", "[users\n");
    assert!(sentence(&["print-config", "--config", &broken], 2).contains("broken.toml:1:"));
    assert!(sentence(&["check-config", "no-such-file.toml"], 2).contains("cannot be read"));
}

#[test]
fn what_is_printed_is_accepted() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let printed = mien(&["print-config"]);
    assert!(printed.status.success());
    // What this build cannot do is said beside it.
    let said = String::from_utf8_lossy(&printed.stderr);
    assert_eq!(said.contains("built without"), !has_wires(), "{said}");
    assert_eq!(said.contains("mqtt"), !has_wires(), "{said}");
    let copy = file(folder.path(), "copy.toml", printed.stdout);
    let checked = mien(&["check-config", &copy]);
    assert_eq!(
        checked.status.code(),
        Some(0),
        "{}",
        String::from_utf8_lossy(&checked.stderr)
    );
}

#[test]
fn wrong_words_are_usage_errors() {
    assert!(sentence(&["fly"], 64).contains("unknown command"));
    assert!(sentence(&["run", "--frames", "many"], 64).contains("many"));
}

#[test]
fn a_model_that_is_damaged_truncated_or_of_another_version_is_refused() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let shipped = include_bytes!("../../config/face.model").to_vec();
    let run = |path: &str| {
        sentence(
            &[
                "run",
                "--source",
                "simulated",
                "--frames",
                "1",
                "--model",
                path,
            ],
            1,
        )
    };
    let mut flipped = shipped.clone();
    let middle = flipped.len() / 2;
    flipped[middle] ^= 0x10;
    let text = run(&file(folder.path(), "flipped.model", flipped));
    assert!(
        text.contains("flipped.model") && text.contains("checksum"),
        "{text}"
    );
    let text = run(&file(
        folder.path(),
        "short.model",
        &shipped[..shipped.len() / 3],
    ));
    assert!(text.contains("short.model"), "{text}");
    let mut other = shipped.clone();
    other[8] = other[8].wrapping_add(41);
    let text = run(&file(folder.path(), "other.model", other));
    assert!(text.contains("version"), "{text}");
    assert!(run(&file(folder.path(), "text.model", "not a model")).contains("text.model"));
    assert!(run(&folder.path().join("none.model").to_string_lossy()).contains("none.model"));
}

#[test]
fn a_source_that_is_no_recording_is_refused() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let path = folder.path().to_str().expect("UTF-8");
    assert!(sentence(&["run", "--source", path], 1).contains("INDEX.txt"));
    assert!(sentence(&["run", "--source", "simulated:circus"], 1).contains("circus"));
}

#[cfg(feature = "studio")]
#[test]
fn the_workstation_names_the_bad_file_too_and_leaves_nothing_behind() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let mut flipped = include_bytes!("../../config/face.model").to_vec();
    flipped[300_000] ^= 0x10;
    let model = file(folder.path(), "flipped.model", flipped);
    let tracks = file(folder.path(), "uneven.csv", "1,2,3\n4,5\n");
    let no_run = file(folder.path(), "no_run.csv", "a,b\n1,2\n");
    let out = folder.path().join("out.png").to_string_lossy().into_owned();
    let cases: [(&[&str], &str, &str); 3] = [
        (&["inspect", &model], "flipped.model", "checksum"),
        (&["inspect", &no_run], "no_run.csv", "column frame"),
        (&["nrsfm", "--tracks", &tracks], "uneven.csv", "found 2"),
    ];
    for (words, name, found) in cases {
        let output = Command::new(env!("CARGO_BIN_EXE_mien-studio"))
            .args(words)
            .args(["--out", &out])
            .output()
            .expect("mien-studio starts");
        let text = String::from_utf8(output.stderr).expect("UTF-8");
        assert_eq!(output.status.code(), Some(1), "{words:?}: {text}");
        assert!(text.contains(name) && text.contains(found), "{text}");
        assert_eq!(
            text.lines().count(),
            1,
            "{words:?}: one sentence, not: {text}"
        );
        assert!(!Path::new(&out).exists());
    }
}
