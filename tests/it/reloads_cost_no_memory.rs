//! Promise: a reload that rebuilds stages takes no memory, however often, and the figures of the run go on.

use std::fmt::Write as _;
use std::io::Write as _;
use std::os::unix::net::UnixDatagram;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use crate::common::program;

/// Reloads with each key: there and back.
const RELOADS: usize = 30;
/// What anonymous memory may grow by with one key (.2 MB were measured); and the peak beyond that of a run that starts with the
/// largest stages, where one person's exist twice for a moment (3.7 MB were measured); bytes.
const MORE: u64 = 1 << 19;
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

struct Run(Child, UnixDatagram);

impl Drop for Run {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

impl Run {
    fn start(folder: &Path, scene: &str) -> Self {
        let notify = folder.join("notify");
        let _ = std::fs::remove_file(&notify);
        let socket = UnixDatagram::bind(&notify).unwrap();
        socket
            .set_read_timeout(Some(Duration::from_secs(60)))
            .unwrap();
        let child = Command::new(program())
            .args(["run", "-q", "--source", scene, "--config"])
            .arg(folder.join("mien.toml"))
            .env("NOTIFY_SOCKET", &notify)
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let run = Self(child, socket);
        run.wait_for("READY=1");
        run
    }

    fn wait_for(&self, wanted: &str) {
        let mut buffer = [0; 512];
        while self
            .1
            .recv(&mut buffer)
            .map(|n| &buffer[..n])
            .expect("a message in time")
            != wanted.as_bytes()
        {}
    }

    fn reload(&self) {
        let id = self.0.id().to_string();
        let sent = Command::new("kill").args(["-HUP", &id]).status().unwrap();
        assert!(sent.success());
        self.wait_for("RELOADING=1");
        self.wait_for("READY=1");
    }

    /// Most memory so far, without the program's own pages: those of a development build are twice as many; bytes.
    fn peak(&self) -> u64 {
        self.bytes("VmHWM:").saturating_sub(self.bytes("RssFile:"))
    }

    /// A line of `/proc/PID/status`, bytes; 0 where the system does not tell.
    fn bytes(&self, name: &str) -> u64 {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.0.id())).unwrap();
        let line = status.lines().find_map(|line| line.strip_prefix(name));
        let kibibytes: Option<u64> =
            line.and_then(|line| line.split_whitespace().next()?.parse().ok());
        kibibytes.unwrap_or(0) * 1024
    }
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
    reload_with_every_key("simulated:still");
}

#[test]
fn reloads_with_four_people_leave_memory_and_figures_as_they_were() {
    reload_with_every_key("simulated:four");
}

fn reload_with_every_key(scene: &str) {
    let mut table = String::new();
    let folder = tempfile::tempdir().unwrap();
    let configure = |key: &str| {
        let path = folder.path().join("status.json");
        let text = format!("{key}\n[status]\npath = {path:?}\n[osc]\n");
        // One section once only.
        let text = match key.strip_prefix("[osc]\n") {
            Some(of_osc) => format!("[status]\npath = {path:?}\n[osc]\n{of_osc}\n"),
            None => text,
        };
        std::fs::write(folder.path().join("mien.toml"), text).unwrap();
    };
    // Whoever is there has been found, and learned from.
    let settled = |key: &str| {
        configure(key);
        let _ = std::fs::remove_file(folder.path().join("status.json"));
        let run = Run::start(folder.path(), scene);
        while figure(folder.path(), "frames") < 200.0 {
            std::thread::sleep(Duration::from_millis(200));
        }
        run
    };
    let most = settled(LARGEST).peak() + TWICE;
    let run = settled("");
    let frames = figure(folder.path(), "frames");
    for (section, key, values) in KEYS {
        // There and back once: what is allocated at the start is resident only where it was used.
        let mut before = 0;
        for n in 0..RELOADS + 2 {
            if n == 2 {
                before = run.bytes("RssAnon:").max(1);
            }
            configure(&format!("[{section}]\n{key} = {}", values[(n + 1) % 2]));
            run.reload();
        }
        configure("");
        run.reload();
        let after = run.bytes("RssAnon:").max(1);
        let _ = writeln!(
            table,
            "{scene:<16} {section}.{key:<14} anonymous {:>6} KiB before, {:>6} after; resident at most {:>6}",
            before >> 10,
            after >> 10,
            run.peak() >> 10
        );
        assert!(after <= before + MORE, "{table}");
    }
    assert!(run.peak() <= most, "{table}at most {}", most >> 10);
    std::thread::sleep(Duration::from_millis(1500));
    assert!(figure(folder.path(), "frames") > frames, "{table}");
    assert!(figure(folder.path(), "uptime_s") > 8.0);
    // For docs/results.md; a test's own output may be closed.
    let _ = std::io::stdout().write_all(table.as_bytes());
}
