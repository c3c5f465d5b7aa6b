//! `mien run` under a service manager that the test plays.

use std::os::unix::net::UnixDatagram;
use std::path::Path;
use std::process::{Child, Stdio};
use std::time::Duration;

use super::mien;

/// Long enough for a slow machine; only a broken run waits for it.
pub const PATIENCE: Duration = Duration::from_secs(300);

/// `mien run` on the simulated sensor, whose service manager is the test; ended with it.
pub struct Service {
    pub child: Child,
    pub socket: UnixDatagram,
}

impl Drop for Service {
    /// A test that fails leaves no run behind.
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Service {
    pub fn start(folder: &Path, config: &str) -> Self {
        Self::start_with(folder, config, &[], Stdio::null(), Stdio::null())
    }

    pub fn start_with(
        folder: &Path,
        config: &str,
        words: &[&str],
        out: impl Into<Stdio>,
        said: impl Into<Stdio>,
    ) -> Self {
        let notify = folder.join("notify");
        let _before = std::fs::remove_file(&notify);
        let socket = UnixDatagram::bind(&notify).unwrap();
        socket.set_read_timeout(Some(PATIENCE)).unwrap();
        std::fs::write(folder.join("mien.toml"), config).unwrap();
        let child = mien("run --source simulated --config")
            .arg(folder.join("mien.toml"))
            .args(words)
            .env("NOTIFY_SOCKET", &notify)
            .env("WATCHDOG_USEC", "400000")
            .env_remove("WATCHDOG_PID")
            .stdout(out)
            .stderr(said)
            .spawn()
            .unwrap();
        Self { child, socket }
    }

    /// As [`Self::start`], and waits until it is ready.
    pub fn ready(folder: &Path, config: &str) -> Self {
        Self::start(folder, config).until_ready()
    }

    /// Waits until it is ready.
    pub fn until_ready(self) -> Self {
        assert_eq!(self.next_but(&["STATUS="]), "READY=1");
        self
    }

    /// The next message that is not of this kind.
    pub fn next_but(&self, skipped: &[&str]) -> String {
        let mut buffer = [0; 512];
        loop {
            let length = self.socket.recv(&mut buffer).expect("a message in time");
            let message = String::from_utf8_lossy(&buffer[..length]).into_owned();
            if !skipped.iter().any(|start| message.starts_with(start)) {
                return message;
            }
        }
    }

    /// Reads the configuration again, whatever comes of it.
    pub fn reload(&self, folder: &Path, config: &str) {
        std::fs::write(folder.join("mien.toml"), config).unwrap();
        self.signal("-HUP");
        // On a busy machine the socket's queue may be full, and `RELOADING=1` is lost.
        let skipped = ["WATCHDOG=", "STATUS=", "RELOADING="];
        assert_eq!(self.next_but(&skipped), "READY=1");
    }

    /// Stops it; how it ended.
    pub fn stop(&mut self) -> Option<i32> {
        self.signal("-TERM");
        assert_eq!(self.next_but(&["WATCHDOG=", "STATUS="]), "STOPPING=1");
        self.child.wait().unwrap().code()
    }

    pub fn signal(&self, name: &str) {
        // The queue is short, and nobody waits for room in it: what comes of the signal is to find some.
        self.socket.set_nonblocking(true).unwrap();
        while self.socket.recv(&mut [0; 512]).is_ok() {}
        self.socket.set_nonblocking(false).unwrap();
        super::signal(&self.child, name);
    }
}
