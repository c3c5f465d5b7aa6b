//! The UDP sockets of OSC, one per target, so that datagrams queued for one (while the system resolves an absent host's hardware
//! address) take no space from the others. They do not block: datagrams that a socket does not accept are dropped and counted.
//! Targets may be hosts, broadcast addresses (192.168.1.255) or multicast groups (239.255.91.30, within one network by default).
//! Host names are resolved on a separate thread, which retries until it succeeds and resolves again after a failed send.

use std::io::ErrorKind;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, ToSocketAddrs, UdpSocket};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::Thread;
use std::time::Duration;

use super::wire::{Datagrams, Targets};
use crate::OutputError;
use crate::limits::start_thread;

/// Local address of IPv4 sockets.
const ANY_IPV4: SocketAddr = SocketAddr::new(IpAddr::V4(Ipv4Addr::UNSPECIFIED), 0);
/// Pause between two look-ups of a name.
const LOOK_UP_PAUSE: Duration = Duration::from_secs(5);

/// Opens a socket for each of `targets` (`host:port`).
///
/// # Errors
/// If a target is unusable or no socket can be opened.
pub(crate) fn open(targets: &[String]) -> Result<Targets, OutputError> {
    let open = |target: &String| -> Result<Box<dyn Datagrams>, OutputError> {
        Ok(Box::new(Target::open(target)?))
    };
    targets.iter().map(open).collect()
}

struct Target {
    socket: UdpSocket,
    to: Destination,
}

/// Destination of a socket.
enum Destination {
    Address(SocketAddr),
    Name(Arc<Name>, Thread),
}

/// A host name's address, looked up by a thread whenever it is woken.
struct Name {
    address: Mutex<Option<SocketAddr>>,
    /// Whether a look-up is requested.
    wanted: AtomicBool,
}

impl Target {
    fn open(target: &str) -> Result<Self, OutputError> {
        let Ok(address) = target.parse() else {
            let named = target.rsplit_once(':');
            if named.is_some_and(|(host, port)| !host.is_empty() && port.parse::<u16>().is_ok()) {
                return Self::named(target, resolve);
            }
            return Err(OutputError::Target(target.to_owned()));
        };
        let any = match address {
            SocketAddr::V6(_) => SocketAddr::from((Ipv6Addr::UNSPECIFIED, 0)),
            SocketAddr::V4(_) => ANY_IPV4,
        };
        Self::bound(any, Destination::Address(address))
    }

    /// A target whose address is found by `resolve`.
    fn named(target: &str, resolve: fn(&str) -> Option<SocketAddr>) -> Result<Self, OutputError> {
        let name = Arc::new(Name {
            address: Mutex::new(None),
            wanted: AtomicBool::new(true),
        });
        let (found, target) = (Arc::downgrade(&name), target.to_owned());
        let thread = start_thread("osc-look-up", move || {
            // Ends when the output is dropped.
            while let Some(name) = found.upgrade() {
                if !name.wanted.load(Ordering::Relaxed) {
                    drop(name);
                    std::thread::park();
                    continue;
                }
                if let Some(address) = resolve(&target) {
                    *name.address() = Some(address);
                    name.wanted.store(false, Ordering::Relaxed);
                } else {
                    tracing::warn!(
                        "OSC target {target} does not resolve; retrying every {} s",
                        LOOK_UP_PAUSE.as_secs()
                    );
                }
                drop(name);
                // Also after a success, because sending may fail again at once.
                std::thread::sleep(LOOK_UP_PAUSE);
            }
        })?;
        // The socket is created before the address is known, for IPv4.
        Self::bound(ANY_IPV4, Destination::Name(name, thread.thread().clone()))
    }

    fn bound(any: SocketAddr, to: Destination) -> Result<Self, OutputError> {
        let socket = UdpSocket::bind(any).map_err(OutputError::Socket)?;
        let opened = socket.set_nonblocking(true);
        opened.map_err(OutputError::Socket)?;
        // Needed for broadcast addresses only.
        socket.set_broadcast(true).ok();
        Ok(Self { socket, to })
    }

    fn address(&self) -> Option<SocketAddr> {
        match &self.to {
            Destination::Address(address) => Some(*address),
            Destination::Name(name, _) => *name.address(),
        }
    }
}

impl Name {
    /// Locks the address; held for a copy only.
    fn address(&self) -> MutexGuard<'_, Option<SocketAddr>> {
        self.address.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Datagrams for Target {
    fn send(&mut self, datagram: &[u8]) -> bool {
        let Some(address) = self.address() else {
            return false;
        };
        let sent = self.socket.send_to(datagram, address);
        // After a failure the name may have another address; a full queue is no such failure.
        if let (Err(error), Destination::Name(name, thread)) = (&sent, &self.to)
            && error.kind() != ErrorKind::WouldBlock
            && !name.wanted.swap(true, Ordering::Relaxed)
        {
            thread.unpark();
        }
        sent.is_ok()
    }

    fn host(&self) -> Option<IpAddr> {
        Some(self.address()?.ip().to_canonical())
    }
}

impl Drop for Target {
    fn drop(&mut self) {
        if let Destination::Name(_, thread) = &self.to {
            thread.unpark();
        }
    }
}

fn resolve(target: &str) -> Option<SocketAddr> {
    target.to_socket_addrs().ok()?.find(SocketAddr::is_ipv4)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::AtomicU16;

    /// Where the name leads from the second time on.
    static PORT: AtomicU16 = AtomicU16::new(0);
    static ASKED: AtomicU16 = AtomicU16::new(0);

    fn resolve(_: &str) -> Option<SocketAddr> {
        let first = ASKED.fetch_add(1, Ordering::Relaxed) == 0;
        // To port 0 nothing can be sent.
        let port = if first {
            0
        } else {
            PORT.load(Ordering::Relaxed)
        };
        Some(SocketAddr::from(([127, 0, 0, 1], port)))
    }

    #[test]
    fn a_name_is_looked_up_anew_when_sending_fails() {
        let receiver = UdpSocket::bind("127.0.0.1:0").unwrap();
        let port = receiver.local_addr().unwrap().port();
        PORT.store(port, Ordering::Relaxed);
        let mut target = Target::named("head.invalid:9130", resolve).unwrap();
        let mut wait = |what: &str, condition: fn(&mut Target) -> bool| {
            for _ in 0..6000 {
                if condition(&mut target) {
                    return;
                }
                std::thread::sleep(Duration::from_millis(10));
            }
            panic!("{what}");
        };
        wait("it is found", |target| target.address().is_some());
        wait("it is found anew", |target| target.send(b"x"));
        let mut bytes = [0; 4];
        receiver
            .set_read_timeout(Some(Duration::from_secs(60)))
            .unwrap();
        assert_eq!(receiver.recv(&mut bytes).unwrap(), 1);
        assert_eq!(ASKED.load(Ordering::Relaxed), 2);
    }
}
