//! Promise: a reload that rebuilds stages takes no memory, however often, and the figures of the run go on.

use std::fmt::Write as _;
use std::io::Write as _;
use std::path::Path;
use std::process::Stdio;
use std::time::Duration;

use crate::common::service::Service;

/// What anonymous memory may grow by with one key (.24 MB were measured; a stage leaked at every reload would cost several); and the peak beyond that of
/// a run that starts with the largest stages, where one person's exist twice for a moment (3.7 MB were measured); bytes.
const MORE: u64 = 1 << 20;
const TWICE: u64 = 9 << 19;
/// The stages that need most memory.
const LARGEST: &str = "[landmarks]\nmethod = \"paper\"";

/// Keys by what they make anew, each with two values.
const KEYS: [(&str, &str, [&str; 2]); 9] = [
    ("segment", "iterations", ["10", "11"]),
    ("pose", "min_agreement", ["0.3", "0.31"]),
    ("pose", "method", ["\"plane\"", "\"paper\""]),
    ("landmarks", "method", ["\"cascade\"", "\"paper\""]),
    ("learning", "half_life_s", ["600.0", "601.0"]),
    ("learning", "method", ["\"robust\"", "\"paper\""]),
    ("users", "most", ["4", "1"]),
    ("osc", "prefix", ["\"/face\"", "\"/other\""]),
    ("vmc", "enabled", ["false", "true"]),
];

/// Most memory so far, without the program's own pages, bytes: those of a development build are twice as many. The system may take
/// pages of files back at any time, so the largest number seen so far is subtracted.
fn peak(run: &Service, files: &mut u64) -> u64 {
    *files = bytes(run, "RssFile:").max(*files);
    bytes(run, "VmHWM:").saturating_sub(*files)
}

/// A line of `/proc/PID/status`, bytes; 0 where the system does not tell.
fn bytes(run: &Service, name: &str) -> u64 {
    let status = std::fs::read_to_string(format!("/proc/{}/status", run.child.id())).unwrap();
    let line = status.lines().find_map(|line| line.strip_prefix(name));
    let kibibytes: Option<u64> = line.and_then(|line| line.split_whitespace().next()?.parse().ok());
    kibibytes.unwrap_or(0) * 1024
}

/// Number behind a key of the status file.
fn figure(folder: &Path, key: &str) -> f64 {
    let text = std::fs::read_to_string(folder.join("status.json")).unwrap_or_default();
    let found = text.split(&format!("\"{key}\": ")).nth(1);
    let number = found.and_then(|rest| rest.split([',', '\n', '}']).next()?.parse().ok());
    number.unwrap_or(0.0)
}

#[test]
fn reloads_with_one_person_leave_memory_and_figures_as_they_were() {
    reload_with_every_key("simulated:still", 10);
}

#[test]
fn reloads_with_four_people_leave_memory_and_figures_as_they_were() {
    reload_with_every_key("simulated:four", 30);
}

/// As many reloads with each key, there and back.
fn reload_with_every_key(scene: &str, reloads: usize) {
    let mut table = String::new();
    let folder = tempfile::tempdir().unwrap();
    let status = folder.path().join("status.json");
    // A section may appear once only.
    let config = |key: &str| match key.strip_prefix("[osc]\n") {
        Some(of_osc) => format!("[status]\npath = {status:?}\n[osc]\n{of_osc}\n"),
        None => format!("{key}\n[status]\npath = {status:?}\n[osc]\n"),
    };
    // Whoever is there has been found, and learned from.
    let settled = |key: &str| {
        let _ = std::fs::remove_file(&status);
        let words = ["-q", "--source", scene];
        let (out, said, config) = (Stdio::null(), Stdio::null(), config(key));
        let run = Service::start_with(folder.path(), &config, &words, out, said);
        while figure(folder.path(), "frames") < 200.0 {
            std::thread::sleep(Duration::from_millis(200));
        }
        run
    };
    let most = peak(&settled(LARGEST), &mut 0) + TWICE;
    let run = settled("");
    let mut files = 0;
    let frames = figure(folder.path(), "frames");
    for (section, key, values) in KEYS {
        // There and back once: what is allocated at the start is resident only where it was used.
        let mut before = 0;
        for n in 0..reloads + 2 {
            if n == 2 {
                before = bytes(&run, "RssAnon:").max(1);
            }
            let changed = format!("[{section}]\n{key} = {}", values[(n + 1) % 2]);
            run.reload(folder.path(), &config(&changed));
        }
        run.reload(folder.path(), &config(""));
        let after = bytes(&run, "RssAnon:").max(1);
        let _ = writeln!(
            table,
            "{scene:<16} {section}.{key:<14} anonymous {:>6} KiB before, {:>6} after; resident at most {:>6}",
            before >> 10,
            after >> 10,
            peak(&run, &mut files) >> 10
        );
        assert!(after <= before + MORE, "{table}");
    }
    let peak = peak(&run, &mut files);
    assert!(
        peak <= most,
        "{table}{} of at most {}",
        peak >> 10,
        most >> 10
    );
    std::thread::sleep(Duration::from_millis(1500));
    assert!(figure(folder.path(), "frames") > frames, "{table}");
    assert!(figure(folder.path(), "uptime_s") > 8.0);
    // For docs/results.md; a test's own output may be closed.
    let _ = std::io::stdout().write_all(table.as_bytes());
}
