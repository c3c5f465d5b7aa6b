//! A run under a service manager: it says when it is ready, feeds the watchdog, reads its configuration again, and stops.

use std::os::unix::net::UnixDatagram;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

/// Long enough for a slow machine; only a broken run waits for it.
const PATIENCE: Duration = Duration::from_secs(300);

struct Service {
    child: Child,
    socket: UnixDatagram,
}

impl Service {
    fn start(folder: &Path, config: &str) -> Self {
        let notify = folder.join("notify");
        let socket = UnixDatagram::bind(&notify).unwrap();
        socket.set_read_timeout(Some(PATIENCE)).unwrap();
        std::fs::write(folder.join("mien.toml"), config).unwrap();
        let child = Command::new(env!("CARGO_BIN_EXE_mien"))
            .args(["run", "--source", "simulated", "--config"])
            .arg(folder.join("mien.toml"))
            .env("NOTIFY_SOCKET", &notify)
            .env("WATCHDOG_USEC", "400000")
            .env_remove("WATCHDOG_PID")
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        Self { child, socket }
    }

    /// The next message that is not of this kind.
    fn next_but(&self, skipped: &[&str]) -> String {
        let mut buffer = [0; 512];
        loop {
            let length = self.socket.recv(&mut buffer).expect("a message in time");
            let message = String::from_utf8_lossy(&buffer[..length]).into_owned();
            if !skipped.iter().any(|start| message.starts_with(start)) {
                return message;
            }
        }
    }

    fn signal(&self, name: &str) {
        let id = self.child.id().to_string();
        assert!(
            Command::new("kill")
                .args([name, &id])
                .status()
                .unwrap()
                .success()
        );
    }
}

#[test]
fn ready_alive_reloaded_and_stopped_cleanly() {
    let folder = tempfile::tempdir().unwrap();
    let status = folder.path().join("status.json");
    let config = format!("[status]\npath = {status:?}\n");
    let mut service = Service::start(folder.path(), &config);
    assert_eq!(service.next_but(&[]), "READY=1");
    assert_eq!(service.next_but(&["STATUS="]), "WATCHDOG=1");
    assert!(service.next_but(&["WATCHDOG="]).starts_with("STATUS="));
    service.signal("-HUP");
    assert_eq!(service.next_but(&["WATCHDOG=", "STATUS="]), "RELOADING=1");
    assert_eq!(service.next_but(&["WATCHDOG=", "STATUS="]), "READY=1");
    service.signal("-TERM");
    assert_eq!(service.next_but(&["WATCHDOG=", "STATUS="]), "STOPPING=1");
    assert_eq!(service.child.wait().unwrap().code(), Some(0));
}

#[test]
fn a_refused_configuration_leaves_the_run_as_it_was() {
    let folder = tempfile::tempdir().unwrap();
    let mut service = Service::start(folder.path(), "[status]\npath = \"\"\n");
    assert_eq!(service.next_but(&["STATUS="]), "READY=1");
    std::fs::write(folder.path().join("mien.toml"), "[status]\nnonsense = 1\n").unwrap();
    service.signal("-HUP");
    assert_eq!(service.next_but(&["WATCHDOG=", "STATUS="]), "RELOADING=1");
    assert_eq!(service.next_but(&["WATCHDOG=", "STATUS="]), "READY=1");
    // It still lives.
    assert_eq!(service.next_but(&["STATUS="]), "WATCHDOG=1");
    service.signal("-TERM");
    assert_eq!(service.next_but(&["WATCHDOG=", "STATUS="]), "STOPPING=1");
    assert_eq!(service.child.wait().unwrap().code(), Some(0));
}
