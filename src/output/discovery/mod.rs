//! mDNS and DNS-SD (RFC 6762, RFC 6763): announces the box's services, without a daemon, or beside one (avahi) on the same
//! port of the same host. It sends no weights: it announces the outputs that do.
//!
//! | service | port | when |
//! | --- | --- | --- |
//! | `_osc._udp` | the command port | `[osc]` accepts commands |
//! | `_http._tcp` | the page, or else WebSocket, `path=/` | `[page]` or `[websocket]` is enabled |
//!
//! Instances are named `mien NAME`, the host `mien-NAME.local`, so that nothing conflicts with a daemon's own names. The name is
//! probed three times before it is used; if it is in use, `-2`, `-3`, … is appended, up to fifteen names; a network that
//! refuses them all is asked for the first again at growing intervals (RFC 6762, 8.1 and 9). Everything is then announced twice,
//! sent in reply to queries (except known answers), and withdrawn at the end. The address announced is the one on the
//! querier's network; whoever is on none of ours is not heard. Memory: two datagrams. Limits: IPv4; only networks whose
//! interfaces exist at start-up or a minute later.

mod message;
mod responder;
mod zone;

use super::worker::Worker;
use super::{Output, OutputError, Report, Tally, identity};
pub use zone::Service;
use zone::Zone;

/// Announces and answers.
pub struct Discovery(Worker);

impl Discovery {
    /// Starts announcing. `name` is the box's.
    ///
    /// # Errors
    /// If no thread can be started; not if there is no network yet.
    pub fn new(name: &str, services: Vec<Service>) -> Result<Self, OutputError> {
        let zone = Zone::new(&identity::name(name), services);
        let work = move |shared: std::sync::Arc<_>, bell| responder::run(zone, &shared, bell);
        Ok(Self(Worker::start("discovery", work)?))
    }
}

impl Output for Discovery {
    fn send(&mut self, _: &Report) -> Result<(), OutputError> {
        Ok(())
    }

    fn tally(&self) -> Tally {
        self.0.tally()
    }
}

/// A datagram as it comes from the network, for `tests/fuzz`.
#[cfg(fuzzing)]
pub fn fuzz(bytes: &[u8]) {
    let service = |kind, port, text| Service {
        kind,
        transport: "_udp",
        port,
        text,
    };
    let services = vec![service("_osc", 9131, ""), service("_http", 9133, "path=/")];
    let (zone, here) = (Zone::new("hall", services), std::net::Ipv4Addr::LOCALHOST);
    if let Some(heard) = message::Message::read(bytes) {
        for legacy in [false, true] {
            assert!(zone.answer(&heard, here, legacy).bytes().len() <= message::LARGEST);
        }
        zone.is_taken(&heard, |address| address == here);
    }
}

#[cfg(test)]
mod tests;
