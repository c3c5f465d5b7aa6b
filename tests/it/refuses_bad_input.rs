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
    is_one_sentence(&text);
    text
}

fn is_one_sentence(text: &str) {
    assert_eq!(text.lines().count(), 1, "one sentence, not: {text}");
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
    let expected = "unknown.toml:2:1: expected one of the keys most, single, hold_s";
    assert!(text.contains(expected), "{text}");
    assert!(text.contains("found hold"), "{text}");
    let range = file(folder.path(), "range.toml", "[users]\nhold_s = 60\n");
    let words = format!("run --config {range} --source simulated --frames 1");
    let words: Vec<&str> = words.split(' ').collect();
    let text = sentence(&words, 2);
    let expected = "range.toml:2:10: expected users.hold_s from 0 to 10 s, found 60";
    assert!(text.contains(expected), "{text}");
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
    let said = String::from_utf8_lossy(&checked.stderr);
    assert_eq!(checked.status.code(), Some(0), "{said}");
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
        let words = "run --source simulated --frames 1 --model";
        let words: Vec<&str> = words.split(' ').chain([path]).collect();
        sentence(&words, 1)
    };
    let mut flipped = shipped.clone();
    let middle = flipped.len() / 2;
    flipped[middle] ^= 0x10;
    let text = run(&file(folder.path(), "flipped.model", flipped));
    assert!(text.contains("flipped.model"), "{text}");
    assert!(text.contains("checksum"), "{text}");
    let short = &shipped[..shipped.len() / 3];
    let text = run(&file(folder.path(), "short.model", short));
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
        let mut command = Command::new(env!("CARGO_BIN_EXE_mien-studio"));
        let output = command.args(words).args(["--out", &out]).output();
        let output = output.expect("mien-studio starts");
        let text = String::from_utf8(output.stderr).expect("UTF-8");
        assert_eq!(output.status.code(), Some(1), "{words:?}: {text}");
        assert!(text.contains(name) && text.contains(found), "{text}");
        is_one_sentence(&text);
        assert!(!Path::new(&out).exists());
    }
}

/// How `check-config`, `doctor` and `run` end with a configuration, and what the first says.
fn judged(folder: &Path, text: &str) -> ([Option<i32>; 3], String) {
    let config = file(folder, "judged.toml", text);
    // Where relative paths of files that a run writes lead.
    let mien = |words: &[&str]| {
        let mut command = Command::new(program());
        let command = command.args(words).current_dir(folder);
        command.output().expect("mien starts")
    };
    let checked = mien(&["check-config", &config]);
    let told = String::from_utf8_lossy(&checked.stderr).into_owned();
    let doctor = mien(&["doctor", "--config", &config]);
    let run = ["run", "-q", "--config", &config, "--frames", "1", "--fast"];
    // The source is the configuration's own where that is what is judged.
    let run = match text.contains("source =") {
        true => mien(&run),
        false => mien(&[&run[..], &["--source", "simulated"]].concat()),
    };
    let codes = [checked, doctor, run].map(|output| output.status.code());
    (codes, told)
}

#[test]
fn what_a_run_refuses_is_refused_by_every_check_with_its_place() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let odd = [
        ("[sensor]\nsource = \"simulated:nowhere\"\n", 2, 10),
        ("[sensor]\nsource = \"/no/such/recording\"\n", 2, 10),
        ("[sensor]\nmodel = \"/no/such.model\"\n", 2, 9),
        ("[osc]\nstyle = \"both\"\nprefix = \"/a b\"\n", 3, 10),
        ("[osc]\nprefix = \"/face*\"\n", 2, 10),
        ("[vrchat]\nenabled = true\nprefix = \"a#\"\n", 3, 10),
        ("[serial]\nport = \"/dev/null\"\nunits = [\"AU99\"]\n", 3, 9),
    ];
    // Of wires that not every build has.
    let optional = [
        (
            "[page]\nenabled = true\npassword_file = \"/no/such\"\n",
            3,
            17,
        ),
        (
            "[mqtt]\nenabled = true\npassword_file = \"/no/such\"\n",
            3,
            17,
        ),
        (
            "[mqtt]\nenabled = true\ntls = true\nca_file = \"/no/such\"\n",
            4,
            11,
        ),
        (
            "[websocket]\nenabled = true\nlisten = \"0.0.0.0:9134\"\n[page]\nenabled = true\nlisten = \"127.0.0.1:9134\"\n",
            6,
            10,
        ),
    ];
    let optional = optional.into_iter().filter(|_| has_wires());
    for (text, line, column) in odd.into_iter().chain(optional) {
        let (codes, told) = judged(folder.path(), text);
        assert_eq!(codes, [Some(2); 3], "{text}: {told}");
        let place = format!("judged.toml:{line}:{column}: ");
        assert!(told.contains(&place), "{place} in {told}");
    }
}

#[test]
fn odd_values_of_every_key_are_accepted_by_all_or_by_none() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let values = r#"-1|1e9|true|[]|""|"odd value"|"/no/such""#;
    let shipped = include_str!("../../config/mien.toml");
    let (mut section, mut played) = ("", 0);
    for line in shipped.lines() {
        let name = line.strip_prefix('[');
        section = name
            .and_then(|rest| rest.strip_suffix(']'))
            .unwrap_or(section);
        let Some((key, _)) = line.split_once(" = ").filter(|_| !line.starts_with('#')) else {
            continue;
        };
        for value in values.split('|') {
            let text = format!("[{section}]\n{key} = {value}\n");
            let path = file(folder.path(), "odd.toml", &text);
            if mien_appliance::service::settings(Some(Path::new(&path))).is_err() {
                continue;
            }
            // Accepted: a run with it must start.
            let (codes, told) = judged(folder.path(), &text);
            if !has_wires() && told.contains("was built without it") {
                assert_eq!(codes, [Some(2); 3], "{text}: {told}");
                continue;
            }
            assert_eq!([codes[0], codes[2]], [Some(0); 2], "{text}: {told}");
            assert_ne!(codes[1], Some(2), "{text}");
            played += 1;
        }
    }
    assert!(played > 20, "{played} odd values were accepted");
}

#[test]
fn whole_models_with_odd_numbers_are_refused_or_used() {
    use mien_appliance::pipeline::Pipeline;
    let shipped = mien_stages::face_model::SHIPPED;
    let camera = mien_sensors::kinect::geometry::nominal();
    let settings = mien_appliance::settings::Settings::default().stages;
    let cases: usize = std::env::var("MIEN_MODELS").map_or(60, |n| n.parse().expect("a number"));
    let mut random = fastrand::Rng::with_seed(31);
    let odd = [1e6_f32, -1e3, 0.31, f32::NAN, f32::INFINITY, 1e-30, 0.0];
    let mut used = 0;
    for _ in 0..cases {
        let mut bytes = shipped.to_vec();
        for _ in 0..random.usize(1..4) {
            // Most of a model are weights; its counts, points and scales are at the beginnings of its sections.
            let most = [bytes.len() - 28, 60_000][usize::from(random.bool())];
            let at = 20 + random.usize(..most);
            let place = &mut bytes[at..at + 4];
            match random.u8(..3) {
                0 => place.copy_from_slice(&odd[random.usize(..odd.len())].to_le_bytes()),
                1 => place.copy_from_slice(&random.u32(..).to_le_bytes()),
                _ => place[0] ^= 1 << random.u32(..8),
            }
        }
        let body = bytes.len() - 4;
        let checksum = mien_stages::base::checksum::crc32(&bytes[..body]);
        bytes[body..].copy_from_slice(&checksum.to_le_bytes());
        if let Ok(model) = mien_stages::face_model::FaceModel::read(&bytes)
            && Pipeline::new(&settings, &camera, &model).is_ok()
        {
            used += 1;
        }
    }
    println!("{used} of {cases} were usable");
    assert!((1..cases).contains(&used));
}
