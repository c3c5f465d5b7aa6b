//! Promise: a standard output that is full or closed ends every command quietly or with one sentence, never with a panic.

use std::fs::File;
use std::path::Path;
use std::process::{Command, Output, Stdio};

use crate::common::mien;

/// A pipe that nobody reads any more.
fn closed() -> Stdio {
    let (reader, writer) = std::io::pipe().expect("a pipe");
    drop(reader);
    writer.into()
}

fn full() -> Stdio {
    let device = File::options().write(true).open("/dev/full");
    device.expect("a full device").into()
}

fn ended(mut command: Command, out: Stdio, folder: &Path) -> Output {
    let command = command.current_dir(folder).stdin(Stdio::null());
    command.stdout(out).output().expect("it starts")
}

#[test]
fn every_command_ends_quietly_or_with_one_sentence() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let of_mien = [
        "help",
        "--version",
        "run --help",
        "check-config",
        "print-config",
        "devices",
        "doctor",
        "bench --source simulated:still --frames 3",
        "run -q --source simulated:still --frames 9 --fast --csv -",
        "run -q --source simulated:still --frames 90 --fast --csv /dev/stdout",
        "send-test --help",
    ];
    let all = of_mien.map(|words| (words, mien as fn(&str) -> Command));
    let all = all.into_iter();
    #[cfg(feature = "studio")]
    let of_studio = [
        "--help",
        "--version",
        "bake --help",
        "head --out head.obj",
        "record --source simulated:still --seconds 0.1 --out session",
        "inspect session --out session.png",
        "inspect nothing",
        "completions --out share",
        "nrsfm --tracks nothing --out n.csv",
        "fit --images . --out f.csv",
        "animate --mesh nothing --csv nothing --out a.glb",
        "train --images nothing --out t.model",
        "units --data nothing",
        "evaluate --data nothing",
        "skin --data nothing --out skin",
        "bake --mesh head.obj --landmarks head.txt --out head.glb",
    ];
    #[cfg(feature = "studio")]
    let all = all.chain(of_studio.map(|words| (words, crate::common::studio as _)));
    for (words, program) in all {
        for (kind, out) in [("full", full()), ("closed", closed())] {
            let ended = ended(program(words), out, folder.path());
            let told = String::from_utf8_lossy(&ended.stderr);
            let how = ended.status;
            let place = format!("{words} to a {kind} output ended with {how:?}: {told}");
            assert!(!told.contains("panicked"), "{place}");
            let code = ended.status.code().unwrap_or_else(|| panic!("{place}"));
            assert!([0, 1, 2, 64, 141].contains(&code), "{place}");
        }
    }
}

#[test]
fn a_table_whose_reader_has_enough_is_no_failure() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let run = || mien("run -q --source simulated:still --frames 60 --fast --csv -");
    let closed = ended(run(), closed(), folder.path());
    assert_eq!((closed.status.code(), closed.stderr.len()), (Some(0), 0));
    let run = ended(run(), full(), folder.path());
    let told = String::from_utf8_lossy(&run.stderr);
    assert_eq!(
        (run.status.code(), told.lines().count()),
        (Some(1), 1),
        "{told}"
    );
    assert!(told.contains("No space left"), "{told}");
}
