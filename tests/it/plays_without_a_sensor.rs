//! Promise: the commands a newcomer types first work without hardware, and tables and recordings are exact to the byte.

use std::process::{Command, Output};

use crate::common::{mien, program};

fn run(words: &str) -> Output {
    let output = mien(&format!("run {words}")).output().expect("mien starts");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{words}: {said}");
    output
}

fn text(bytes: &[u8]) -> &str {
    std::str::from_utf8(bytes).expect("UTF-8")
}

#[test]
fn a_table_on_standard_output_is_alone_there() {
    let output = run("--source simulated --fast --frames 3 --csv -");
    let lines: Vec<&str> = text(&output.stdout).lines().collect();
    assert_eq!(lines.len(), 4);
    assert!(lines[0].starts_with("frame,time_us,user,state,confidence,tx_m"));
    for (n, line) in lines[1..].iter().enumerate() {
        assert!(line.starts_with(&format!("{n},")), "{line}");
        assert_eq!(line.split(',').count(), lines[0].split(',').count());
    }
}

#[test]
fn without_a_kinect_one_line_says_so_and_the_simulated_sensor_plays() {
    let output = run("--fast --frames 40");
    let said = text(&output.stderr);
    let about: Vec<&str> = said.lines().filter(|line| line.contains("inect")).collect();
    if about.is_empty() {
        println!("skipped: a Kinect is plugged in");
        return;
    }
    assert_eq!(about.len(), 1, "{said}");
    assert!(about[0].contains("simulated sensor"), "{said}");
    // One readable line a second, with the state and the turn of the head.
    let live = text(&output.stdout);
    assert!(live.contains("0:01.0 ") && live.contains("turn"), "{live}");
}

#[test]
fn a_table_on_a_full_disk_ends_with_its_last_row_whole() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let table = folder.path().join("table.csv");
    // A file may not grow beyond 20 kB, as on a disk that is full by then.
    let limited = "trap '' XFSZ; ulimit -f 40; exec \"$0\" run --source simulated --fast --frames 300 --csv \"$1\"";
    let mut shell = Command::new("sh");
    let shell = shell.args(["-c", limited, &program()]).arg(&table);
    let output = shell.output().expect("mien starts");
    let said = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(said.contains("cannot write the CSV"), "{said}");
    let table = std::fs::read_to_string(table).expect("a table");
    let columns = |line: &str| line.split(',').count();
    let rows: Vec<&str> = table.lines().collect();
    assert!(
        rows.len() > 3 && table.ends_with('\n'),
        "{} rows",
        rows.len()
    );
    let last = rows.last().expect("a row");
    assert_eq!(columns(last), columns(rows[0]), "{last}");
}

#[cfg(feature = "studio")]
#[test]
fn a_recording_plays_like_what_was_recorded_every_time_and_a_cut_file_costs_its_frame() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let at = |name: &str| folder.path().join(name).to_str().expect("UTF-8").to_owned();
    let words = "record --source simulated --seconds 1 --out";
    let recorded = crate::common::studio(words).arg(at("session")).output();
    let recorded = recorded.expect("mien-studio starts");
    assert!(recorded.status.success(), "{}", text(&recorded.stderr));
    let table = |source: &str, name: &str| {
        let csv = at(name);
        let output = run(&format!("--source {source} --fast --frames 30 --csv {csv}"));
        let table = std::fs::read_to_string(at(name)).expect("a table");
        (table, text(&output.stderr).to_owned())
    };
    let (direct, _) = table("simulated", "direct.csv");
    for name in ["once.csv", "again.csv"] {
        assert!(table(&at("session"), name).0 == direct, "{name} differs");
    }
    assert_eq!(direct.lines().count(), 31);

    let cut = std::fs::read_dir(at("session"))
        .expect("the recording")
        .filter_map(|entry| Some(entry.ok()?.path()))
        .find(|path| path.to_string_lossy().ends_with("-20000000.pgm"))
        .expect("the eleventh depth picture");
    let bytes = std::fs::read(&cut).expect("readable");
    std::fs::write(&cut, &bytes[..1000]).expect("writable");
    let (damaged, said) = table(&at("session"), "damaged.csv");
    let about = said.lines().filter(|line| line.contains("frame 10"));
    assert_eq!(about.count(), 1, "{said}");
    assert!(!damaged.lines().any(|line| line.starts_with("10,")));
    assert_eq!(damaged.lines().count(), 30);
}

/// What a shell's words print on a terminal of 70 columns; `None` where there is no `script` to make one.
fn on_a_terminal(words: &str) -> Option<String> {
    let words = format!("stty cols 70; {words}");
    let mut script = Command::new("script");
    let script = script.args(["-qec", &words, "/dev/null"]);
    match script.stdin(std::process::Stdio::null()).output() {
        Ok(output) => Some(String::from_utf8_lossy(&output.stdout).into_owned()),
        Err(problem) => {
            println!("skipped: no terminal ({problem})");
            None
        }
    }
}

#[test]
fn a_terminal_shows_where_it_sends_one_line_that_never_wraps_and_a_summary() {
    let mien = program();
    let run = format!("{mien} run --source simulated:two --fast --frames 40");
    let Some(said) = on_a_terminal(&run) else {
        return;
    };
    let lines: Vec<&str> = said.lines().map(str::trim_end).collect();
    assert!(
        lines[0].starts_with("mien ") && lines[0].ends_with("simulated:two"),
        "{said}"
    );
    assert_eq!(lines[1], "sends to: OSC to 127.0.0.1:9130");
    assert!(lines[2].starts_with("next: "), "{said}");
    let live: Vec<&str> = said.split("\r\x1b[K").skip(1).collect();
    assert!(live.len() >= 40, "{said}");
    for line in live.iter().filter(|line| !line.contains("status.json")) {
        assert!(
            line.trim_end().len() < 70 || line.contains('\n'),
            "{line:?}"
        );
    }
    assert!(
        live.iter()
            .any(|line| line.contains("| 1 ") && line.contains("| 2 ")),
        "{said}"
    );
    let summary = lines.iter().rfind(|line| !line.is_empty());
    let summary = summary.expect("a last line");
    assert!(
        summary.starts_with("40 frames in ") && summary.contains("2 people"),
        "{said}"
    );
    let quiet = on_a_terminal(&format!("{run} -q")).expect("a terminal, as before");
    assert!(
        !quiet.contains("frames in") && !quiet.contains("\x1b[K  0:"),
        "{quiet}"
    );
}

#[test]
fn a_terminal_that_is_closed_ends_what_runs_on_it() {
    let mien = program();
    let words =
        format!("{mien} run --source simulated & sleep 2; kill -HUP $!; wait $!; echo ended $?");
    if let Some(said) = on_a_terminal(&words) {
        assert!(said.trim_end().ends_with("ended 0"), "{said}");
    }
}
