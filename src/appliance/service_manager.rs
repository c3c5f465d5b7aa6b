//! Notifications to the service manager: ready, alive, a status line, stopping (the datagrams of systemd's `sd_notify(3)`).
//!
//! The socket's path is in `NOTIFY_SOCKET`; a path that begins with `@` is in the abstract namespace. With a watchdog
//! (`WATCHDOG_USEC`) [`ServiceManager::alive`] triggers it four times per period, and only the loop that runs frames through
//! the pipeline calls it: the manager kills a run that hangs anywhere. Without a manager every call does nothing.
//! No allocation after construction. Limits: a lost datagram is not repeated; the next one follows soon.

use std::fmt::Write as _;
use std::os::linux::net::SocketAddrExt;
use std::os::unix::net::{SocketAddr, UnixDatagram};
use std::time::{Duration, Instant};

/// Least interval between status lines.
const STATE_PERIOD: Duration = Duration::from_secs(1);
/// Longest datagram.
const MESSAGE: usize = 256;

/// The manager of this process, if there is one.
#[derive(Debug, Default)]
pub struct ServiceManager {
    socket: Option<UnixDatagram>,
    feed_every: Option<Duration>,
    fed: Option<Instant>,
    state: heapless::String<MESSAGE>,
    stated: Option<Instant>,
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
        Self::at(path.as_encoded_bytes(), watchdog.map(Duration::from_micros)).unwrap_or_else(
            |problem| {
                tracing::warn!(
                    "cannot reach the service manager at {}: {problem}; readiness is not reported",
                    path.display()
                );
                Self::default()
            },
        )
    }

    /// The manager listening at `path`, with this watchdog period.
    ///
    /// # Errors
    /// If there is no such socket.
    pub fn at(path: &[u8], watchdog: Option<Duration>) -> std::io::Result<Self> {
        let address = match path.strip_prefix(b"@") {
            Some(name) => SocketAddr::from_abstract_name(name)?,
            None => {
                SocketAddr::from_pathname(std::path::Path::new(&*String::from_utf8_lossy(path)))?
            }
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

    /// Whether there is one.
    pub const fn is_there(&self) -> bool {
        self.socket.is_some()
    }

    /// A frame was processed, or the sensor is known to be absent: triggers the watchdog when due.
    pub fn alive(&mut self, now: Instant) {
        let due = self.feed_every.is_some_and(|every| {
            self.fed
                .is_none_or(|fed| now.saturating_duration_since(fed) >= every)
        });
        if due {
            self.fed = Some(now);
            self.say("WATCHDOG=1");
        }
    }

    /// One line for `systemctl status`; sent when it changed, at most once a second.
    pub fn state(&mut self, line: std::fmt::Arguments<'_>, now: Instant) {
        let early = self
            .stated
            .is_some_and(|stated| now.saturating_duration_since(stated) < STATE_PERIOD);
        if self.socket.is_none() || early {
            return;
        }
        let mut message = heapless::String::<MESSAGE>::new();
        // Too long a line is not sent at all.
        if write!(message, "STATUS={line}").is_ok() && message != self.state {
            self.say(&message);
            self.state = message;
            self.stated = Some(now);
        }
    }

    /// Sends a message: `READY=1` when frames are processed (or the sensor is waited for, which counts as ready), `RELOADING=1`
    /// until the next of them, `STOPPING=1` when the run ends.
    pub fn say(&self, message: &str) {
        if let Some(socket) = &self.socket {
            // Lost when the manager's queue is full; see the limits above.
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
        let manager = ServiceManager::at(format!("@{name}").as_bytes(), watchdog).unwrap();
        (socket, manager)
    }

    #[test]
    fn the_watchdog_is_fed_four_times_a_period_and_not_by_itself() {
        let (socket, mut manager) = manager(Some(Duration::from_secs(4)), "watchdog");
        let start = Instant::now();
        manager.say("READY=1");
        for frame in 0..90 {
            manager.alive(start + Duration::from_millis(frame * 33));
        }
        manager.say("STOPPING=1");
        let expected = [
            "READY=1",
            "WATCHDOG=1",
            "WATCHDOG=1",
            "WATCHDOG=1",
            "STOPPING=1",
        ];
        assert_eq!(received(&socket), expected);
    }

    #[test]
    fn a_line_of_state_is_sent_when_it_changes() {
        let (socket, mut manager) = manager(None, "state");
        let start = Instant::now();
        manager.alive(start);
        for second in 0..6 {
            let users = second / 3;
            manager.state(
                format_args!("{users} users"),
                start + Duration::from_millis(1100 * second),
            );
        }
        assert_eq!(received(&socket), ["STATUS=0 users", "STATUS=1 users"]);
    }

    #[test]
    fn a_socket_in_the_file_system_serves_and_a_missing_one_is_an_error() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("notify");
        let bytes = path.as_os_str().as_encoded_bytes();
        assert!(ServiceManager::at(bytes, None).is_err());
        let socket = UnixDatagram::bind(&path).unwrap();
        socket.set_nonblocking(true).unwrap();
        ServiceManager::at(bytes, None).unwrap().say("READY=1");
        assert_eq!(received(&socket), ["READY=1"]);
    }
}
