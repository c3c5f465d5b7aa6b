//! The sockets OSC goes out of, one for each target, so that what waits for one (an absent host's address is asked for on
//! the local net while the system keeps the datagram) takes no room from the others. They do not block: what one cannot
//! take is dropped and counted. A receiver that is not there changes nothing. Targets may be hosts, broadcast addresses
//! (as 192.168.1.255) or multicast groups (as 239.255.91.30; sent with a reach of one network, as the system has it). A
//! target given by name is looked up on a thread of its own, again and again until it is found.

use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr, ToSocketAddrs, UdpSocket};
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use super::wire::{Datagrams, Targets};
use crate::output::OutputError;

/// Pause between two look-ups of a name that is not found.
const LOOK_UP_PAUSE: Duration = Duration::from_secs(5);

/// Opens a socket for each of `targets` (`host:port`).
///
/// # Errors
/// If a target is unusable, or there is no socket to be had.
pub(super) fn open(targets: &[String]) -> Result<Targets, OutputError> {
    let open = |target: &String| -> Result<Box<dyn Datagrams>, OutputError> {
        Ok(Box::new(Target::open(target)?))
    };
    targets.iter().map(open).collect()
}

struct Target {
    socket: UdpSocket,
    address: Arc<OnceLock<SocketAddr>>,
}

impl Target {
    fn open(target: &str) -> Result<Self, OutputError> {
        let address = look_up(target.to_owned())?;
        let any = match address.get() {
            Some(SocketAddr::V6(_)) => SocketAddr::from((Ipv6Addr::UNSPECIFIED, 0)),
            _ => SocketAddr::from((Ipv4Addr::UNSPECIFIED, 0)),
        };
        let socket = UdpSocket::bind(any)
            .and_then(|socket| {
                socket.set_nonblocking(true)?;
                // Only for targets that are broadcast addresses; those that are not do not need it.
                socket.set_broadcast(true).ok();
                Ok(socket)
            })
            .map_err(|source| OutputError::Socket { source })?;
        Ok(Self { socket, address })
    }
}

impl Datagrams for Target {
    fn send(&mut self, datagram: &[u8]) -> bool {
        let address = self.address.get();
        address.is_some_and(|address| self.socket.send_to(datagram, address).is_ok())
    }
}

/// The address of `target`: at once if it is one, else as soon as its name is found.
fn look_up(target: String) -> Result<Arc<OnceLock<SocketAddr>>, OutputError> {
    let found = Arc::new(OnceLock::new());
    if let Ok(address) = target.parse() {
        found.get_or_init(|| address);
        return Ok(found);
    }
    let host_and_port = target
        .rsplit_once(':')
        .map(|(host, port)| (host.is_empty(), port.parse::<u16>()));
    let Some((false, Ok(_))) = host_and_port else {
        return Err(OutputError::Target { target });
    };
    let result = Arc::downgrade(&found);
    let thread = std::thread::Builder::new().name("osc-look-up".to_owned());
    thread
        .spawn(move || {
            // Ends with the output that wants to know.
            while let Some(found) = result.upgrade() {
                // The socket is made for IPv4 before the name is known.
                let address = target
                    .to_socket_addrs()
                    .ok()
                    .and_then(|mut all| all.find(SocketAddr::is_ipv4));
                if let Some(address) = address {
                    found.get_or_init(|| address);
                    return;
                }
                tracing::warn!("OSC target {target} is not found, trying again");
                drop(found);
                std::thread::sleep(LOOK_UP_PAUSE);
            }
        })
        .map_err(|source| OutputError::Thread { source })?;
    Ok(found)
}
