//! Notifications to the service manager: ready, alive, a status line, stopping (the datagrams of systemd's `sd_notify(3)`).
//!
//! The socket's path is in `NOTIFY_SOCKET`; a path that begins with `@` is in the abstract namespace. With a watchdog
//! (`WATCHDOG_USEC`) [`ServiceManager::feed_watchdog`] triggers it four times per period. Only the loop over frames calls it, so
//! that the manager kills a run that hangs anywhere. Without a manager every call does nothing.
//! No allocation after construction. Limits: a lost datagram is not repeated; the next one follows soon.

use std::fmt::Write as _;
use std::os::linux::net::SocketAddrExt;
use std::os::unix::net::{SocketAddr, UnixDatagram};
use std::time::{Duration, Instant};

/// Least interval between status lines.
const STATUS_PERIOD: Duration = Duration::from_secs(1);
/// Longest status datagram, bytes.
const MESSAGE: usize = 256;

/// Time from an event to `now`; for ever if there was none.
fn since(event: Option<Instant>, now: Instant) -> Duration {
    event.map_or(Duration::MAX, |event| now.saturating_duration_since(event))
}

/// The manager of this process, if there is one.
#[derive(Debug, Default)]
pub struct ServiceManager {
    socket: Option<UnixDatagram>,
    feed_every: Option<Duration>,
    last_fed: Option<Instant>,
    status: heapless::String<MESSAGE>,
    status_sent: Option<Instant>,
}

impl ServiceManager {
    /// The manager named by the environment; without one, or if it is unreachable, nothing is sent.
    pub fn from_environment() -> Self {
        let Some(path) = std::env::var_os("NOTIFY_SOCKET").filter(|path| !path.is_empty()) else {
            return Self::default();
        };
        let number = |name: &str| std::env::var(name).ok().and_then(|text| text.parse().ok());
        // The variables pass to children: the watchdog is only for the process it names.
        let mine = number("WATCHDOG_PID").is_none_or(|pid| pid == u64::from(std::process::id()));
        let watchdog = number("WATCHDOG_USEC").filter(|_| mine);
        let connected = Self::connect(path.as_encoded_bytes(), watchdog.map(Duration::from_micros));
        let connected = connected.inspect_err(|problem| {
            let path = path.display();
            tracing::warn!(
                "cannot reach the service manager at {path}: {problem}; readiness is not reported"
            );
        });
        connected.unwrap_or_default()
    }

    /// The manager listening at `path`, with this watchdog period.
    ///
    /// # Errors
    /// If there is no such socket.
    pub fn connect(path: &[u8], watchdog: Option<Duration>) -> std::io::Result<Self> {
        let address = match path.strip_prefix(b"@") {
            Some(name) => SocketAddr::from_abstract_name(name)?,
            None => SocketAddr::from_pathname(&*String::from_utf8_lossy(path))?,
        };
        let socket = UnixDatagram::unbound()?;
        socket.connect_addr(&address)?;
        // A manager that does not read must not stop the frames.
        socket.set_nonblocking(true)?;
        Ok(Self {
            socket: Some(socket),
            feed_every: watchdog.map(|period| period / 4),
            ..Self::default()
        })
    }

    /// Whether there is a manager.
    pub const fn is_connected(&self) -> bool {
        self.socket.is_some()
    }

    /// Triggers the watchdog when due; to be called after every frame, or wait for the sensor.
    pub fn feed_watchdog(&mut self, now: Instant) {
        let passed = since(self.last_fed, now);
        let due = self.feed_every.is_some_and(|every| passed >= every);
        if due {
            self.last_fed = Some(now);
            self.notify("WATCHDOG=1");
        }
    }

    /// Sets the line of `systemctl status`; sent if changed, at most once a second.
    pub fn set_status(&mut self, line: std::fmt::Arguments<'_>, now: Instant) {
        if self.socket.is_none() || since(self.status_sent, now) < STATUS_PERIOD {
            return;
        }
        let mut message = heapless::String::<MESSAGE>::new();
        // A line that is too long is not sent.
        if write!(message, "STATUS={line}").is_ok() && message != self.status {
            self.notify(&message);
            self.status = message;
            self.status_sent = Some(now);
        }
    }

    /// Sends a message: `READY=1` when frames are processed (or the sensor is waited for, which counts as ready), `RELOADING=1`
    /// until the next of them, `STOPPING=1` when the run ends.
    pub fn notify(&self, message: &str) {
        if let Some(socket) = &self.socket {
            // Lost if the manager's queue is full.
            let _ = socket.send(message.as_bytes());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn received(socket: &UnixDatagram) -> Vec<String> {
        let mut buffer = [0; 512];
        let mut all = Vec::new();
        while let Ok(length) = socket.recv(&mut buffer) {
            all.push(String::from_utf8_lossy(&buffer[..length]).into_owned());
        }
        all
    }

    fn manager(watchdog: Option<Duration>, name: &str) -> (UnixDatagram, ServiceManager) {
        let name = format!("mien-test-{name}-{}", std::process::id());
        let address = SocketAddr::from_abstract_name(&name).unwrap();
        let socket = UnixDatagram::bind_addr(&address).unwrap();
        socket.set_nonblocking(true).unwrap();
        let manager = ServiceManager::connect(format!("@{name}").as_bytes(), watchdog).unwrap();
        (socket, manager)
    }

    #[test]
    fn the_watchdog_is_fed_four_times_a_period_and_not_by_itself() {
        let (socket, mut manager) = manager(Some(Duration::from_secs(4)), "watchdog");
        let start = Instant::now();
        manager.notify("READY=1");
        for frame in 0..90 {
            manager.feed_watchdog(start + Duration::from_millis(frame * 33));
        }
        manager.notify("STOPPING=1");
        let expected = "READY=1 WATCHDOG=1 WATCHDOG=1 WATCHDOG=1 STOPPING=1";
        assert_eq!(received(&socket).join(" "), expected);
    }

    #[test]
    fn a_status_line_is_sent_when_it_changes() {
        let (socket, mut manager) = manager(None, "state");
        let start = Instant::now();
        manager.feed_watchdog(start);
        for second in 0..6 {
            let users = second / 3;
            let at = start + Duration::from_millis(1100 * second);
            manager.set_status(format_args!("{users} users"), at);
        }
        assert_eq!(received(&socket), ["STATUS=0 users", "STATUS=1 users"]);
    }

    #[test]
    fn a_socket_in_the_file_system_serves_and_a_missing_one_is_an_error() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("notify");
        let bytes = path.as_os_str().as_encoded_bytes();
        assert!(ServiceManager::connect(bytes, None).is_err());
        let socket = UnixDatagram::bind(&path).unwrap();
        socket.set_nonblocking(true).unwrap();
        let manager = ServiceManager::connect(bytes, None).unwrap();
        manager.notify("READY=1");
        assert_eq!(received(&socket), ["READY=1"]);
    }
}
